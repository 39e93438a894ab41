"""Habits that importers have and the standard allows, or almost, on native FMUs."""

from pathlib import Path

import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave

from fmus.generate import builder
from tests.importers.importers import loaded_by_fmpy
from tests.shared_builds import KINDS, Fmus

pytestmark = pytest.mark.importers


def outputs_after(slave: FMU2Slave, name: str, inputs_before_setup: bool) -> list[float]:
    """Outputs after ten steps with inputs that are not their start values, set before or after the setup."""
    block = builder.load_block(name)
    references = [v.value_reference for v in block.of_causality("input")]
    values = [0.3] * len(references)
    if inputs_before_setup:
        slave.setReal(references, values)
    slave.setupExperiment(startTime=0.0)
    if not inputs_before_setup:
        slave.setReal(references, values)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    for i in range(10):
        slave.doStep(i * block.step_size, block.step_size)
    outputs = slave.getReal([v.value_reference for v in block.of_causality("output")])
    slave.terminate()
    slave.freeInstance()
    return outputs


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize(
    "folder", ["a space", "a#b", "a+b", "a%20b", "[a](b){c}", "Tiefe-äøß", "水深", "a'b&c;d", "."]
)
def test_it_runs_from_a_folder_of_any_name(built: Fmus, tmp_path: Path, name: str, folder: str) -> None:
    plain = outputs_after(loaded_by_fmpy(built[name], tmp_path / "plain"), name, False)
    odd = outputs_after(loaded_by_fmpy(built[name], tmp_path / "odd" / folder), name, False)
    assert odd == plain


@pytest.mark.parametrize("name", KINDS)
def test_inputs_set_before_the_experiment_is_set_up_count(built: Fmus, tmp_path: Path, name: str) -> None:
    before = outputs_after(loaded_by_fmpy(built[name], tmp_path / "one"), name, True)
    after = outputs_after(loaded_by_fmpy(built[name], tmp_path / "two"), name, False)
    np.testing.assert_array_equal(before, after)


@pytest.mark.parametrize("name", KINDS)
def test_two_copies_of_one_library_in_one_process_keep_apart(built: Fmus, tmp_path: Path, name: str) -> None:
    """As an importer has them that extracts an FMU once for each instance."""
    block = builder.load_block(name)
    one, other = (
        loaded_by_fmpy(built[name], tmp_path / "one"),
        loaded_by_fmpy(built[name], tmp_path / "other"),
    )
    parameter = next(v for v in block.variables if v.name == "internal_step")
    one.setReal([parameter.value_reference], [0.25 * float(parameter.start)])
    assert one.getReal([parameter.value_reference]) != other.getReal([parameter.value_reference])
    assert other.getReal([parameter.value_reference]) == [parameter.start]
    one.freeInstance()
    assert outputs_after(other, name, False) == outputs_after(
        loaded_by_fmpy(built[name], tmp_path / "alone"), name, False
    )

"""The FMU of the python flavour, through FMPy, does what the block does."""

import math
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest
from fmpy.fmi1 import FMICallException

from fmus.generate import builder, python
from fmus.generate.python import source_closure
from fmus.registry import Flavour
from tests.shared_builds import Fmus, one_of_a_kind


@pytest.mark.parametrize("name", one_of_a_kind(builder.block_names()))
def test_the_trace_equals_the_block_stepped_directly(
    python_built: Fmus, load: Any, driver: Any, name: str
) -> None:
    """Bit for bit: the FMU runs the same functions on the same numbers."""
    fmu = load(python_built[name]).begin()
    block = driver(builder.load_block(name)).begin()
    outputs = [v.name for v in block.instance.block.of_causality("output")]
    inputs = [v.name for v in block.instance.block.of_causality("input") if v.minimum is None]
    for i in range(100):
        for k, variable in enumerate(inputs):
            fmu[variable] = block[variable] = math.cos(0.1 * i * (k + 1))
        fmu.slave.doStep(i * 0.02, 0.02)
        block.instance.do_step(i * 0.02, 0.02)
        assert [fmu[variable] for variable in outputs] == [block[variable] for variable in outputs]


def test_the_bytes_of_another_fmu_are_refused(python_built: Fmus, load: Any) -> None:
    plant, other = load(python_built["RovDepthPlant"]).begin(), load(python_built["ExamplePlant"]).begin()
    data = other.slave.serializeFMUstate(other.slave.getFMUstate())
    plant.slave.setFMUstate(plant.slave.deSerializeFMUstate(data))
    assert "expected" in plant.log[-1]
    with pytest.raises(FMICallException):
        plant.slave.doStep(0.0, 0.02)


def test_a_failing_step_is_logged_and_discarded_and_the_instance_lives(python_built: Fmus, load: Any) -> None:
    plant = load(python_built["ExamplePlant"]).begin()
    plant["omega"] = 1e300
    plant["control"] = 1e300
    with pytest.raises(FMICallException, match="discard"):
        plant.slave.doStep(0.0, 1.0)
    assert "not finite any more" in plant.log[-1]
    plant["omega"], plant["control"] = 1.0, 0.0
    plant.slave.doStep(0.0, 1.0)
    assert plant["output"] == 0.0


def test_a_refused_value_is_logged_and_steps_are_discarded_until_it_is_right(
    python_built: Fmus, load: Any
) -> None:
    plant = load(python_built["RovDepthPlant"]).begin()
    plant["inertia"] = -1.0
    assert plant.log == ["inertia = -1.0: expected 0.1 to 1e6 kg"]
    with pytest.raises(FMICallException, match="discard"):
        plant.slave.doStep(0.0, 0.02)
    assert "inertia = -1.0" in plant.log[-1]
    plant["inertia"] = 6.0
    plant.slave.doStep(0.0, 0.02)


def test_a_call_that_nothing_can_put_right_costs_one_step(python_built: Fmus, load: Any) -> None:
    plant = load(python_built["ExamplePlant"]).begin()
    for refused, words in (
        (lambda: plant.__setitem__("output", 1.0), "output: cannot be set, its causality is output"),
        (lambda: plant.__setitem__("internal_step", 1.0), "internal_step: is fixed"),
        (lambda: plant.slave.setReal([99], [1.0]), "value reference 99: expected 0.."),
    ):
        refused()
        assert words in plant.log[-1]
        with pytest.raises(FMICallException, match="discard"):
            plant.slave.doStep(0.0, 0.01)
    plant.slave.doStep(0.0, 0.01)


def test_a_getter_of_the_wrong_type_is_an_error_in_the_log(python_built: Fmus, load: Any) -> None:
    plant = load(python_built["ExamplePlant"]).begin()
    assert plant.slave.getInteger([plant.references["output"]]) == [0]
    assert plant.log[-1] == "output is Real: expected Integer or Enumeration"
    plant.slave.setBoolean([plant.references["control"]], [True])
    assert plant.log[-1] == "control is Real: expected Boolean"


def test_a_value_reference_that_is_none_reads_as_no_number(python_built: Fmus, load: Any) -> None:
    """The binary has no way to return the error that FMI wants here."""
    plant = load(python_built["ExamplePlant"]).begin()
    assert math.isnan(plant.slave.getReal([99])[0])
    assert plant.log[-1] == "value reference 99: expected 0..18 of ExamplePlant"


def test_no_step_goes_beyond_the_stop_time_of_the_setup(python_built: Fmus, load: Any) -> None:
    """Discarded: an error is what FMI wants, which the binary cannot return."""
    plant = load(python_built["ExamplePlant"])
    plant.slave.setupExperiment(startTime=0.0, stopTime=0.3)
    plant.slave.enterInitializationMode()
    plant.slave.exitInitializationMode()
    for i in range(3):
        plant.slave.doStep(i * 0.1, 0.1)
    state = plant.slave.getFMUstate()
    with pytest.raises(FMICallException, match="discard"):
        plant.slave.doStep(0.3, 0.1)
    assert plant.log[-1] == "step to 0.4 s: expected at most the stop time 0.3 s"
    plant.slave.setFMUstate(state)
    with pytest.raises(FMICallException, match="discard"):
        plant.slave.doStep(0.3, 0.1)


def test_a_percent_sign_in_a_message_is_escaped(python_built: Fmus, load: Any) -> None:
    """FMI's logger takes a printf format: an unescaped %n would write to memory."""
    plant = load(python_built["ExamplePlant"]).begin()
    plant.slave.setFMUstate(plant.slave.deSerializeFMUstate(b'{"format": "%s%n", "fmu": "%s"}'))
    assert "%%s%%n" in plant.log[-1]


def test_two_versions_of_an_fmu_do_not_see_each_other(
    python_built: Fmus, load: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A plant built from changed sources, that feels twice the control, beside the original."""
    old, new = "p.omega * inputs.control", "2.0 * inputs.control"

    def changed(module: str) -> dict[str, str]:
        return {name: source.replace(old, new) for name, source in source_closure(module).items()}

    path = python_built["ExamplePlant"]
    monkeypatch.setattr(python, "source_closure", changed)
    another = builder.build_block("ExamplePlant", tmp_path, Flavour.PYTHON)
    assert another.read_bytes() != path.read_bytes()
    original, other = load(path).begin(), load(another).begin()
    for fmu in (original, other):
        fmu["control"] = 1.0
        fmu.slave.doStep(0.0, 0.001)
    assert other["state[2]"] == pytest.approx(2.0 * original["state[2]"], rel=1e-2)


def test_loading_leaves_the_import_path_as_it_was(python_built: Fmus, load: Any) -> None:
    before = list(sys.path)
    load(python_built["RovDepthPlant"])
    assert sys.path == before


@pytest.mark.slow
def test_many_instances_one_after_another(python_built: Fmus, load: Any) -> None:
    """PythonFMU alone crashes at the second: it drops a reference that it does not own.

    In Windows one of some hundred hangs or crashes, as its binary waits for a thread when it is unloaded.
    """
    for _ in range(20):
        fmu = load(python_built["ExamplePlant"]).begin()
        fmu.slave.doStep(0.0, 0.01)
        fmu.free()
    module = zipfile.ZipFile(python_built["ExamplePlant"]).read("resources/slavemodule.txt").decode()
    assert sys.getrefcount(sys.modules[module].__dict__) < 20

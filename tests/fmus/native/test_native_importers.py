"""Importers differ: in URIs, logging, and in how many FMUs they load."""

import ctypes
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import pytest
from fmpy.fmi2 import FMU2Slave, defaultCallbacks, fmi2CoSimulation

from fmus.build import builder
from fmus.build import native as native_flavour
from fmus.errors import ExportError
from fmus.files import write_archive
from tests.shared_builds import Fmus, with_libraries


def slave_of(path: Path, folder: Path, **changes: str) -> FMU2Slave:

    description: Any = fmpy.read_model_description(str(path))
    fmpy.extract(str(path), folder)
    options = {"guid": description.guid, "instanceName": "it", **changes}
    return FMU2Slave(unzipDirectory=str(folder), modelIdentifier=description.modelName, **options)


@pytest.mark.parametrize(
    "uri",
    [
        None,
        b"file:///tmp/a/resources",
        b"file:/tmp/a/resources",
        b"file://localhost/tmp/a/resources",
        b"FILE:///C:/Program%20Files/%C3%A4/resources",
        b"file:///tmp/a%23b+c%25d/resources/",
        b"/tmp/not a uri/resources",
        b"",
    ],
)
def test_every_form_of_resource_location_is_as_good(built: Fmus, tmp_path: Path, uri: bytes | None) -> None:
    """The model needs no file, so that it can not fail for the importer's way of writing a URI."""
    slave = slave_of(built["ExamplePlant"], tmp_path)
    make = slave.dll.fmi2Instantiate
    make.restype = ctypes.c_void_p
    component = make(b"it", fmi2CoSimulation, slave.guid.encode(), uri, ctypes.byref(defaultCallbacks), 0, 0)
    assert component
    slave.dll.fmi2FreeInstance(ctypes.c_void_p(component))


def test_errors_are_always_logged_and_discards_in_debug_mode(built: Fmus, load: Any) -> None:
    quiet = load(built["ExamplePlant"], logging=False).begin()
    assert quiet.status("setReal", [0, 9], [0.1, math.inf]) == "error"
    assert len(quiet.log) == 1
    quiet.slave.reset()
    assert quiet.begin().status("setReal", [9], [math.inf]) == "discard"
    assert len(quiet.log) == 1


def test_only_enabled_categories_are_logged(built: Fmus, load: Any) -> None:
    fmu = load(built["ExamplePlant"]).begin()
    fmu.slave.setDebugLogging(True, ["logStatusError"])
    assert fmu.status("setReal", [9], [math.inf]) == "discard"
    assert fmu.log == []
    fmu.slave.setDebugLogging(True, ["logStatusDiscard", "logStatusWarning"])
    assert fmu.status("setReal", [9], [math.inf]) == "discard"
    assert fmu.status("setReal", [16], [0.0]) == "error"
    assert len(fmu.log) == 1


def test_two_versions_in_one_process_do_not_see_each_other(built: Fmus, load: Any, tmp_path: Path) -> None:
    """A plant that feels twice the control, beside the original."""
    block = builder.load_block("ExamplePlant")
    derivative: Any = block.derivative

    def twice(t: float, x: Any, u: Any, p: Any, c: Any) -> Any:
        return derivative(t, x, replace(u, control=2.0 * u.control), p, c)

    changed = replace(block, derivative=twice)
    _, members = native_flavour.content(changed)
    path = write_archive(tmp_path / "changed" / "ExamplePlant.fmu", with_libraries(changed.name, members))
    fmus = load(built["ExamplePlant"]).begin(), load(path).begin()
    for fmu in fmus:
        fmu["control"] = 1.0
        fmu.slave.doStep(0.0, 0.001)
    assert fmus[1]["state[2]"] == pytest.approx(2.0 * fmus[0]["state[2]"], rel=1e-12)


def test_a_block_with_an_if_on_a_value_is_refused_with_the_way_out() -> None:
    block = builder.load_block("ExamplePlant")

    def branching(t: float, x: Any, p: Any, c: Any) -> Any:
        return block.output(t, x if x.x[0] > 0.0 else block.state(), p, c)

    with pytest.raises(ExportError, match=r"'ExamplePlant' cannot be traced: .*use fmus.numerics.where"):
        native_flavour.content(replace(block, output=branching))

"""The native FMU through FMPy: the numbers of the block, any URI, several FMUs of one name in a process."""

import ctypes
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy.fmi2 import defaultCallbacks, fmi2CoSimulation, fmi2LastSuccessfulTime, fmi2Terminated

from fmus.files import write_archive
from fmus.generate import builder
from fmus.generate.archive import native_members
from fmus.generate.trace import trace
from tests.shared_builds import Fmus, one_of_a_kind, with_libraries


@pytest.mark.parametrize("name", one_of_a_kind(builder.block_names()))
def test_the_trace_equals_the_block_stepped_in_python(built: Fmus, load: Any, driver: Any, name: str) -> None:
    """Operations are the same and none is contracted. What may differ is the last bit of a constant that
    CasADi inverted (x / 6 as x * (1 / 6)), or of an elementary function; 1e-12 is thousands of these, of
    the largest value: what comes near zero is a difference of such values."""
    fmu = load(built[name]).begin()
    block = driver(builder.load_block(name)).begin()
    outputs = [v.name for v in block.instance.block.of_causality("output")]
    inputs = [v.name for v in block.instance.block.of_causality("input") if v.minimum is None]
    compiled, expected = [], []
    for i in range(200):
        for k, variable in enumerate(inputs):
            fmu[variable] = block[variable] = math.cos(0.1 * i * (k + 1))
        fmu.slave.doStep(i * 0.02, 0.02)
        block.instance.do_step(i * 0.02, 0.02)
        compiled.append([fmu[variable] for variable in outputs])
        expected.append([block[variable] for variable in outputs])
    error, largest = np.abs(np.subtract(compiled, expected)).max(axis=0), np.abs(expected).max(axis=0)
    assert np.all(error <= 1e-12 * largest + 1e-15), dict(zip(outputs, error / largest, strict=True))


def test_any_communication_step_size_lands_on_its_point(built: Fmus, load: Any, driver: Any) -> None:
    """As the block does: internal steps of equal length, and the last one ends there."""
    fmu = load(built["ExamplePlant"]).begin()
    block = driver(builder.load_block("ExamplePlant")).begin()
    fmu["control"] = block["control"] = 1.0
    t = 0.0
    for h in (0.0013, 1e-6, 0.25, 1.0 / 3.0):
        fmu.slave.doStep(t, h)
        block.instance.do_step(t, h)
        t = block.instance.time
        assert fmu["output"] == pytest.approx(block["output"], rel=1e-13)
    assert fmu.slave.getRealStatus(fmi2LastSuccessfulTime) == t
    assert fmu.slave.getBooleanStatus(fmi2Terminated) == 0


def test_every_form_of_resource_location_is_as_good(built: Fmus, load: Any) -> None:
    """The model needs no file, so that it can not fail for the importer's way of writing a URI."""
    slave = load(built["ExamplePlant"]).slave
    make, guid = slave.dll.fmi2Instantiate, slave.guid.encode()
    make.restype = ctypes.c_void_p
    for uri in (
        *(None, b"", b"/tmp/not a uri/resources"),
        *(b"file:///tmp/a/resources", b"file:/tmp/a/resources", b"file://localhost/tmp/a/resources"),
        *(b"FILE:///C:/Program%20Files/%C3%A4/resources", b"file:///tmp/a%23b+c%25d/resources/"),
    ):
        component = make(b"it", fmi2CoSimulation, guid, uri, ctypes.byref(defaultCallbacks), 0, 0)
        assert component, uri
        slave.dll.fmi2FreeInstance(ctypes.c_void_p(component))


@pytest.mark.slow
def test_two_versions_in_one_process_do_not_see_each_other(built: Fmus, load: Any, tmp_path: Path) -> None:
    """A plant that feels twice the control, beside the original."""
    block = builder.load_block("ExamplePlant")
    derivative: Any = block.derivative

    def twice(t: float, x: Any, u: Any, p: Any, c: Any) -> Any:
        return derivative(t, x, replace(u, control=2.0 * u.control), p, c)

    _, members = native_members(trace(replace(block, derivative=twice)))
    path = write_archive(tmp_path / "changed" / "ExamplePlant.fmu", with_libraries(block.name, members))
    fmus = load(built["ExamplePlant"]).begin(), load(path).begin()
    for fmu in fmus:
        fmu["control"] = 1.0
        fmu.slave.doStep(0.0, 0.001)
    assert fmus[1]["state[2]"] == pytest.approx(2.0 * fmus[0]["state[2]"], rel=1e-12)

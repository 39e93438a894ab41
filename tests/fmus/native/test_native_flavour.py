"""The native FMU, through FMPy: the numbers of the block, and their derivatives."""

import math
from typing import Any

import numpy as np
import pytest
from fmpy.fmi2 import fmi2LastSuccessfulTime, fmi2Terminated

from fmus.build import builder
from tests.shared_builds import Fmus

NAMES = builder.block_names()


@pytest.mark.parametrize("name", NAMES)
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


@pytest.mark.parametrize("name", NAMES)
def test_directional_derivatives_of_the_initialisation_are_its_slopes(
    built: Fmus, load: Any, name: str
) -> None:
    """Against central differences, whose error is some 1e-6 of the slope at a relative step of 1e-5."""
    block, fmu = builder.load_block(name), load(built[name])
    fmu.slave.setupExperiment(startTime=1.0)  # away from the corners of ramps
    fmu.slave.enterInitializationMode()
    real = [v for v in block.variables if v.type == "Real"]
    knowns = [v for v in real if v.settable]
    unknowns = [v.value_reference for v in real if not v.settable]
    for v in knowns:
        if v.causality == "input" and v.maximum is None:
            fmu[v.name] = 0.3  # away from the corners of |x|
    for known in knowns:
        step = 1e-5 * max(abs(fmu[known.name]), 1e-2)
        moved = [fmu[known.name] + step, fmu[known.name] - step]
        if (
            any(known.refuse(value) for value in moved)
            or "samp" in known.name
            or known.name == "sensor_noise"
        ):
            continue
        along = fmu.slave.getDirectionalDerivative(unknowns, [known.value_reference], [1.0])
        start, slopes = fmu[known.name], []
        for value in moved:
            fmu[known.name] = value
            slopes.append(np.array(fmu.slave.getReal(unknowns)))
        fmu[known.name] = start
        difference = (slopes[0] - slopes[1]) / (2.0 * step)
        assert along == pytest.approx(difference, rel=1e-5, abs=1e-5), known.name


def test_in_step_mode_outputs_depend_on_parameters_but_not_on_inputs(built: Fmus, load: Any) -> None:
    fmu = load(built["ExamplePlant"]).begin()
    fmu["control"] = 1.0
    fmu.slave.doStep(0.0, 0.5)
    output, control, gain = (fmu.references[n] for n in ("output", "control", "output_vector[1]"))
    derivative = fmu.slave.getDirectionalDerivative([output], [control, gain], [5.0, 2.0])
    assert derivative == [2.0 * fmu["state[1]"]]  # y = C x


def test_inputs_with_a_derivative_are_followed_within_the_step(built: Fmus, load: Any) -> None:
    """x'' = u with u = t from rest: x'(1) = 1/2, by the middles of internal steps."""
    fmu = load(built["ExamplePlant"])
    for name in ("state_matrix[2,1]", "state_matrix[2,2]", "theta[1]", "theta[2]"):
        fmu[name] = 0.0
    fmu.begin()
    control = fmu.references["control"]
    fmu.slave.setRealInputDerivatives([control], [1], [1.0])
    fmu.slave.doStep(0.0, 1.0)
    assert fmu["state[2]"] == pytest.approx(0.5, rel=1e-12)
    fmu.slave.doStep(1.0, 1.0)  # a derivative holds for one step; the input itself is still 0
    assert fmu["state[2]"] == pytest.approx(0.5, rel=1e-12)
    fmu.slave.setRealInputDerivatives([control], [2], [1.0])
    assert fmu.log[-1].endswith("control: order 2 is left out: expected 1")


def test_an_extrapolated_input_stays_within_its_range(built: Fmus, load: Any) -> None:
    """An efficiency that falls by 10 per second is 0 from 0.1 s on, never negative."""
    falling, dead = load(built["RovDepthPlant"]), load(built["RovDepthPlant"])
    forces = []
    for fmu in (falling, dead):
        fmu.slave.setBoolean([fmu.references["thruster_ideal"]], [True])
        fmu.begin()
        fmu["voltage[1]"] = 4.0
        fmu["thruster_efficiency[1]"] = 0.0 if fmu is dead else 1.0
        if fmu is falling:
            fmu.slave.setRealInputDerivatives([fmu.references["thruster_efficiency[1]"]], [1], [-10.0])
        fmu.slave.doStep(0.0, 1.0)
        forces.append(fmu["thruster_force[1]"])
    assert forces == [0.0, 0.0]

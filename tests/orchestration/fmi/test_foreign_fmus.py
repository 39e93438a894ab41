"""The test FMUs are what they are taken for: compliant, exact, and strict with who calls them."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave
from scipy.integrate import solve_ivp

from fmus.compliance.examine import examine
from tests import foreign_fmus
from tests.foreign_fmus import Misdeed

Build = Callable[..., Path]
EVERYTHING = {
    "interpolates_inputs": True,
    "output_derivative_order": 1,
    "saves_state": True,
    "serialises_state": True,
}
TWO_BY_TWO: dict[str, Any] = {"a": -0.7, "b": (1.0, -2.0), "c": (1.0, 0.5), "d": ((0.0, 0.3), (2.0, 0.0))}


def findings(path: Path) -> dict[str, Any]:
    return {r.rule.name: r.messages for r in examine(path, timeout=10) if r.messages}


@pytest.mark.parametrize(
    "options", [{}, EVERYTHING, {"varies_step_size": False}, TWO_BY_TWO | {"passes_discrete": True}]
)
def test_linear_fmus_break_no_rule(linear: Build, options: dict[str, Any]) -> None:
    assert findings(linear(**options)) == {}


def test_functions_and_rogues_that_do_nothing_wrong_break_no_rule(function: Build, rogue: Build) -> None:
    assert findings(function("cos(u)")) == findings(rogue(saves_state=True)) == {}


def test_a_stair_breaks_no_rule(stair: Build) -> None:
    assert findings(stair(saves_state=True)) == {}


def test_misdeeds_have_the_same_numbers_in_c() -> None:
    text = (Path(foreign_fmus.__file__).parent / "foreign_c" / "rogue.c").read_text()
    (items,) = re.findall(r"enum \{ /\* the items.*?\};", text, re.DOTALL)
    names = re.findall(r"^    ([A-Z_]+)", items, re.MULTILINE)
    assert [name.removesuffix("_ERROR") for name in names] == [each.name for each in Misdeed]


class Stepped:
    """An FMU through FMPy, variables by name."""

    def __init__(self, path: Path, folder: Path) -> None:
        description = fmpy.read_model_description(str(path))
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        fmpy.extract(str(path), str(folder))
        identifier = description.coSimulation.modelIdentifier  # type: ignore[union-attr]
        self.slave: Any = FMU2Slave(
            guid=description.guid, unzipDirectory=str(folder), modelIdentifier=identifier, instanceName="x"
        )
        self.slave.instantiate()
        self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()

    def __getitem__(self, name: str) -> float:
        return self.slave.getReal([self.references[name]])[0]

    def __setitem__(self, name: str, value: float) -> None:
        self.slave.setReal([self.references[name]], [value])


@pytest.mark.parametrize(("a", "h"), [(-0.7, 0.8), (-0.7, 0.1), (0.0, 0.8)])
def test_a_linear_fmu_is_exact_for_inputs_on_a_slope(
    linear: Build, tmp_path: Path, a: float, h: float
) -> None:
    """Against SciPy with a tolerance of 1e-12; feedthrough takes the input at the end of the step."""
    it = Stepped(linear(**TWO_BY_TWO | {"a": a}, **EVERYTHING), tmp_path)
    u, rate = np.array([0.4, -1.0]), np.array([3.0, 0.5])
    it["u[1]"], it["u[2]"] = u
    b, c, d = (np.array(TWO_BY_TWO[name]) for name in "bcd")

    def after(start: float, rate: np.ndarray) -> float:
        """The state a step after the given one."""
        solved = solve_ivp(lambda t, x: a * x + b @ (u + rate * t), (0, h), [start], rtol=1e-12, atol=1e-12)
        return solved.y[0, -1]

    assert [it["y[1]"], it["y[2]"]] == pytest.approx(c * 1.0 + d @ u, rel=1e-15)
    it.slave.exitInitializationMode()
    references = [it.references["u[1]"], it.references["u[2]"]]
    it.slave.setRealInputDerivatives(references, [1, 1], list(rate))
    it.slave.doStep(0.0, h)
    x, end = after(1.0, rate), u + rate * h
    assert [it["y[1]"], it["y[2]"]] == pytest.approx(c * x + d @ end, abs=1e-11)
    slope = c * (a * x + b @ end) + d @ rate
    outputs = [it.references["y[1]"], it.references["y[2]"]]
    assert it.slave.getRealOutputDerivatives(outputs, [1, 1]) == pytest.approx(slope, abs=1e-11)
    it.slave.doStep(h, h)  # the slope held for one step alone
    assert it["y[1]"] == pytest.approx(c[0] * after(x, 0.0 * rate) + d[0] @ u, abs=1e-11)
    it.slave.terminate()
    it.slave.freeInstance()


@pytest.mark.parametrize(
    "call",
    [
        lambda it: it.slave.setRealInputDerivatives([it.references["u[1]"]], [1], [1.0]),
        lambda it: it.slave.getRealOutputDerivatives([it.references["y[1]"]], [1]),
        lambda it: it.slave.getFMUState(),
        lambda it: it.slave.doStep(0.1, 0.1),
        lambda it: (it.slave.doStep(0.0, 0.1), it.slave.doStep(0.1, 0.2)),
    ],
)
def test_what_is_not_claimed_is_an_error(linear: Build, tmp_path: Path, call: Callable) -> None:
    it = Stepped(linear(varies_step_size=False), tmp_path)
    it.slave.exitInitializationMode()
    with pytest.raises(FMICallException) as caught:
        call(it)
    assert caught.value.status == 3
    it.slave.freeInstance()


def test_a_discarded_step_leaves_the_part_that_succeeded(rogue: Build, tmp_path: Path) -> None:
    it = Stepped(rogue(saves_state=True), tmp_path)
    it.slave.setInteger([it.references["misdeed"]], [Misdeed.DISCARD])
    it["longest_step"], it["u"] = 0.25, 2.0
    it.slave.exitInitializationMode()
    before = it.slave.getFMUState()
    with pytest.raises(FMICallException) as caught:
        it.slave.doStep(0.0, 1.0)
    assert caught.value.status == 2
    assert it.slave.getRealStatus(2) == 0.25
    assert it["y"] == 0.5
    it.slave.setFMUState(before)
    it.slave.doStep(0.0, 0.25)
    assert it["y"] == 0.5
    it.slave.freeFMUState(before)
    it.slave.freeInstance()

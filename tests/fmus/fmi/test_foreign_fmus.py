"""The test FMUs are what they are taken for: compliant, exact, and strict with who calls them."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from scipy.integrate import solve_ivp

from fmus.compliance.examine import examine
from tests import foreign_fmus
from tests.foreign_fmus import Misdeed
from tests.shared_builds import Build

EVERYTHING = {
    "interpolates_inputs": True,
    "output_derivative_order": 1,
    "saves_state": True,
    "serialises_state": True,
}
TWO_BY_TWO: dict[str, Any] = {"a": -0.7, "b": (1.0, -2.0), "c": (1.0, 0.5), "d": ((0.0, 0.3), (2.0, 0.0))}
PERMISSIVE = {"wrong-references-are-refused"}
"""Rules below an error that these FMUs break: they accept derivatives of what does not exist."""


def findings(path: Path) -> dict[str, Any]:
    """Rule -> messages; without the deviations and the advice that are expected."""
    return {
        result.rule.name: result.messages
        for result in examine(path, timeout=10)
        if result.messages and not (result.outcome != "error" and result.rule.name in PERMISSIVE)
    }


@pytest.mark.slow
def test_they_break_no_rule(linear: Build, function: Build, rogue: Build, stair: Build) -> None:
    lags = EVERYTHING, TWO_BY_TWO | {"passes_discrete": True}, {}, {"varies_step_size": False}
    able = (rogue(saves_state=True), stair(saves_state=True), function("cos(u)"))
    for path in (*(linear(**options) for options in lags), *able):
        assert findings(path) == {}, path


def test_misdeeds_have_the_same_numbers_in_c() -> None:
    text = (Path(foreign_fmus.__file__).parent / "foreign_c" / "rogue.c").read_text()
    (items,) = re.findall(r"enum \{ /\* the items.*?\};", text, re.DOTALL)
    names = re.findall(r"^    ([A-Z_]+)", items, re.MULTILINE)
    assert [name.removesuffix("_ERROR") for name in names] == [misdeed.name for misdeed in Misdeed]


@pytest.mark.parametrize(("a", "h"), [(-0.7, 0.8), (-0.7, 0.1), (0.0, 0.8)])
def test_a_linear_fmu_is_exact_for_inputs_on_a_slope(linear: Build, load: Any, a: float, h: float) -> None:
    """Against SciPy with a tolerance of 1e-12; feedthrough takes the input at the end of the step."""
    stepped = load(linear(**TWO_BY_TWO | {"a": a}, **EVERYTHING)).initialize()
    u, rate = np.array([0.4, -1.0]), np.array([3.0, 0.5])
    stepped["u[1]"], stepped["u[2]"] = u
    b, c, d = (np.array(TWO_BY_TWO[name]) for name in "bcd")

    def after(start: float, rate: np.ndarray) -> float:
        """The state a step after the given one."""
        solved = solve_ivp(lambda t, x: a * x + b @ (u + rate * t), (0, h), [start], rtol=1e-12, atol=1e-12)
        return solved.y[0, -1]

    assert [stepped["y[1]"], stepped["y[2]"]] == pytest.approx(c * 1.0 + d @ u, rel=1e-15)
    stepped.slave.exitInitializationMode()
    references = [stepped.references["u[1]"], stepped.references["u[2]"]]
    stepped.slave.setRealInputDerivatives(references, [1, 1], list(rate))
    stepped.slave.doStep(0.0, h)
    x, end = after(1.0, rate), u + rate * h
    assert [stepped["y[1]"], stepped["y[2]"]] == pytest.approx(c * x + d @ end, abs=1e-11)
    slope = c * (a * x + b @ end) + d @ rate
    outputs = [stepped.references["y[1]"], stepped.references["y[2]"]]
    assert stepped.slave.getRealOutputDerivatives(outputs, [1, 1]) == pytest.approx(slope, abs=1e-11)
    stepped.slave.doStep(h, h)  # the slope held for one step alone
    assert stepped["y[1]"] == pytest.approx(c[0] * after(x, 0.0 * rate) + d[0] @ u, abs=1e-11)


@pytest.mark.parametrize(
    "call",
    [
        lambda stepped: stepped.slave.setRealInputDerivatives([stepped.references["u[1]"]], [1], [1.0]),
        lambda stepped: stepped.slave.getRealOutputDerivatives([stepped.references["y[1]"]], [1]),
        lambda stepped: stepped.slave.getFMUState(),
        lambda stepped: stepped.slave.doStep(0.1, 0.1),
        lambda stepped: (stepped.slave.doStep(0.0, 0.1), stepped.slave.doStep(0.1, 0.2)),
    ],
)
def test_what_is_not_claimed_is_an_error(linear: Build, load: Any, call: Callable) -> None:
    stepped = load(linear(varies_step_size=False)).begin()
    with pytest.raises(FMICallException) as caught:
        call(stepped)
    assert caught.value.status == 3


def test_a_discarded_step_leaves_the_part_that_succeeded(rogue: Build, load: Any) -> None:
    stepped = load(rogue(saves_state=True)).initialize()
    stepped.slave.setInteger([stepped.references["misdeed"]], [Misdeed.DISCARD])
    stepped["longest_step"], stepped["u"] = 0.25, 2.0
    stepped.slave.exitInitializationMode()
    before = stepped.slave.getFMUState()
    with pytest.raises(FMICallException) as caught:
        stepped.slave.doStep(0.0, 1.0)
    assert caught.value.status == 2
    assert stepped.slave.getRealStatus(2) == 0.25
    assert stepped["y"] == 0.5
    stepped.slave.setFMUState(before)
    stepped.slave.doStep(0.0, 0.25)
    assert stepped["y"] == 0.5
    stepped.slave.freeFMUState(before)

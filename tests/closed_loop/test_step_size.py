"""Below a stated step the example converges to the continuous system, in y, in the estimates and in u.

The reference is constant, so that the fast loop oscillates at a constant frequency, 2113 rad/s for r = 25 and
33,800 rad/s for r = 400. The continuous figures come from a program of its own: the equations as they stand,
classical Runge-Kutta at 1 us (at 2 us they agree to six digits).
"""

import math
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from orchestration.run import simulate
from orchestration.scenarios import scenario

DURATION = 4.0
STEPS = (1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5)
ESTIMATE, ERROR = "theta_hat[2]", "prediction_error[2]"
CONVERGING = STEPS[2:]  # 2113 rad/s turn by less than half a radian in a step
THEORY = Path(__file__).parents[2] / "docs" / "explanation" / "theory.md"


@dataclass(frozen=True)
class Figures:
    """y(4 s), mean of theta_hat[2] over the last 2 s, total variation of u over every step and every ms."""

    y: float
    theta: float
    variation: float
    variation_per_ms: float
    prediction_error: float  # largest of the second state


CONTINUOUS = {
    25.0: Figures(26.28870, -0.41206, 14510.97, 12883.85, 0.05260),
    100.0: Figures(105.15501, -0.55782, 61219.10, 15057.03, 0.05293),
    400.0: Figures(420.62012, -0.57936, 245986.0, 16249.76, 0.05308),
}


@cache
def co_simulated(r: float, h: float, algorithm: str = "jacobi") -> Figures:
    """The plain law with a constant reference, through the FMUs."""
    chosen = scenario.load(
        scenario.find("example-l1"),
        {
            "experiment": {"step_size": h, "stop_time": DURATION, "algorithm": algorithm},
            "parameters": {"controller.inputs_at_step_end": algorithm == "gauss-seidel"},
            "signals": {"controller.reference": {"kind": "cosine", "amplitude": r, "angular_frequency": 0.0}},
            "metrics": {"lag": False, "rmse": False},
            "record": ["plant.output", *(f"controller.{n}" for n in ("control", ESTIMATE, ERROR))],
        },
    )
    run = simulate(chosen.system, chosen.experiment)
    u = run["controller.control"]
    return Figures(
        y=float(run["plant.output"][-1]),
        theta=float(run[f"controller.{ESTIMATE}"][run.time >= 0.5 * DURATION].mean()),
        variation=float(np.abs(np.diff(u)).sum()),
        variation_per_ms=float(np.abs(np.diff(u[:: round(1e-3 / h)])).sum()),
        prediction_error=float(np.abs(run[f"controller.{ERROR}"]).max()),
    )


@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel"])
@pytest.mark.parametrize("figure", ["y", "theta", "variation"])
def test_the_error_falls_with_the_first_power_of_the_step(
    scenario_fmus: None, figure: str, algorithm: str
) -> None:
    exact = getattr(CONTINUOUS[25.0], figure)
    errors = [abs(getattr(co_simulated(25.0, h, algorithm), figure) - exact) for h in CONVERGING]
    orders = [
        math.log(coarse / fine) / math.log(h / finer)
        for (coarse, fine), (h, finer) in zip(pairwise(errors), pairwise(CONVERGING), strict=True)
    ]
    assert orders == pytest.approx([1.0] * len(orders), abs=0.15)  # terms of second order at half a radian
    assert errors[-1] < 0.07 * abs(exact)


@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel"])
@pytest.mark.parametrize("h", [1e-3, 2e-4])
@pytest.mark.parametrize("r", [25.0, 100.0, 400.0])
def test_a_step_that_does_not_resolve_the_fast_loop_neither_excites_nor_damps_it(
    scenario_fmus: None, r: float, h: float, algorithm: str
) -> None:
    """Up to 34 rad in a step. Sampled every millisecond, u varies as in the continuous system."""
    exact, sampled = CONTINUOUS[r], co_simulated(r, h, algorithm)
    assert sampled.variation_per_ms == pytest.approx(exact.variation_per_ms, rel=0.25)
    assert sampled.y == pytest.approx(exact.y, rel=0.003)


@pytest.mark.parametrize("h", [1e-3, 2e-5])
@pytest.mark.parametrize("r", [25.0, 100.0, 400.0])
def test_the_prediction_error_does_not_grow_with_the_step_of_the_reference(
    scenario_fmus: None, r: float, h: float
) -> None:
    """The transient bound of fast adaptation: |x_tilde| <= sqrt(theta_max / (lambda_min(P) Gamma))."""
    # its peak lies between two points
    assert co_simulated(r, h).prediction_error == pytest.approx(CONTINUOUS[r].prediction_error, rel=0.01)


def test_the_theory_page_shows_these_figures(scenario_fmus: None) -> None:
    text = THEORY.read_text(encoding="utf-8")
    rows = [row(f"{1e3 * h:g} ms", co_simulated(25.0, h)) for h in STEPS]
    missing = [line for line in [*rows, row("continuous", CONTINUOUS[25.0])] if line not in text]
    assert not missing, "expected in docs/explanation/theory.md:\n" + "\n".join(missing)


def row(label: str, figures: Figures) -> str:
    return f"| {label} | {figures.y:.3f} | {figures.theta:.3f} | {figures.variation:.3g} |"

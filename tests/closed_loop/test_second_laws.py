"""The loop of each other depth controller against a second program of its law, at stated gains.

Both exchange in the same order, so that they differ by how a law goes on within a step alone: not at all for
PID and the sliding modes, by the integration of its observer for ADRC (1e-4 of the RMSE, where a reading is
rounded the other way), and for MRAC by the explicit step of its estimates (0.3 %).
"""

import math
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from orchestration import simulate
from orchestration.scenarios import scenario
from orchestration.scenarios.scenario import Scenario
from tests.closed_loop.same_experiment import SMOOTH, component_values, slope
from tests.closed_loop.second_laws import Adrc, HeldLaw, Mrac, Pid, SlidingMode, SuperTwisting
from tests.closed_loop.second_loop import Case, run
from tests.shared_builds import Fmus

STEP = 0.02  # s
GAINS: Mapping[str, tuple[type[HeldLaw], Mapping[str, float]]] = {
    "PidDepthController": (Pid, {"kp": 16.5, "ki": 5.5, "kd": 14.0, "beta": 1.0}),
    "MracDepthController": (Mrac, {"depth_gain": 5.5, "rate_gain": 8.5, "estimate_gain": 30.0}),
    "SlidingModeDepthController": (
        SlidingMode,
        {"error_bandwidth": 1.0, "switching_gain": 4.0, "boundary_layer": 0.5},
    ),
    "SuperTwistingDepthController": (
        SuperTwisting,
        {"error_bandwidth": 1.0, "root_gain": 1.5, "twisting_gain": 0.22, "smoothing": 0.02},
    ),
    "AdrcDepthController": (Adrc, {"control_bandwidth": 1.0, "observer_bandwidth": 4.0}),
}
POSITION_ALONE = {"controller.depth_reference_rate": 0.0, "controller.depth_reference_acceleration": 0.0}
ROUNDED = {"plant.sensor_noise": 0.0}  # to the sensor's 2 mm
IDEAL = {**SMOOTH, "plant.sensor_ideal": True}
NO_OBSERVER = {"observer_period": 0.04, "observer_alpha": 0.0, "observer_beta": 0.0}  # of ours: ADRC


class Figures(NamedTuple):
    """RMSE [m] of the run; settling time [s] to 5 % of 0.8 m, before the reference leaves it at 140 s."""

    rmse: float
    settling_time: float


def figures(time: np.ndarray, depth: np.ndarray, reference: np.ndarray) -> Figures:
    outside = time[(time <= 140.0) & ~(abs(depth - 0.8) <= 0.04)]
    return Figures(math.sqrt(np.mean((depth - reference) ** 2)), float(outside[-1]))


def loop_of(fmu: Path, settings: Mapping[str, Any], stop: float) -> Scenario:
    """The paper's trajectory until `stop`."""
    shipped = scenario.find("nominal-extended")
    changes = {
        "experiment": {"stop_time": stop},
        "metrics": dict.fromkeys(scenario.load(shipped).metrics, False),
    }
    return scenario.load(shipped, changes, settings={"controller": str(fmu), **settings})


def both_figures(
    fmu: Path, settings: Mapping[str, Any], stop: float = 310.0, rate: Callable[[float], float] = slope
) -> tuple[Figures, Figures]:
    """Of the FMUs, and of the second program."""
    law, gains = GAINS[fmu.stem]
    stated = {f"controller.{name}": value for name, value in gains.items()}
    loaded = loop_of(fmu, {**stated, **settings}, stop)
    own = simulate(loaded.system, loaded.experiment)
    values = component_values(loaded)
    case = Case(
        plant=values["plant"],
        law={**NO_OBSERVER, **values["controller"], **gains},
        ideal="plant.sensor_ideal" in settings,
        reference=cache(loaded.experiment.signals["controller.depth_reference"]),  # asked for more than once
        force=lambda t: 0.0,
        duration=stop,
    )
    second = run(case, STEP, law(case, STEP, rate))
    ours = figures(own.time, own["plant.depth"], own["controller.depth_reference"])
    return ours, figures(second["time"], second["depth"], second["reference"])


def check(ours: Figures, theirs: Figures, name: str) -> None:
    is_explicit = name == "MracDepthController"
    assert ours.rmse == pytest.approx(theirs.rmse, rel=5e-3 if is_explicit else 5e-4)
    assert ours.settling_time == pytest.approx(theirs.settling_time, abs=0.05)


@pytest.mark.parametrize("name", GAINS)
def test_a_second_program_descends_and_settles_alike(built: Fmus, name: str) -> None:
    """With sensor and observer."""
    assert built["RovDepthPlant"].is_file()
    check(*both_figures(built[name], SMOOTH, stop=60.0), name)


@pytest.mark.slow
@pytest.mark.parametrize("name", GAINS)
def test_a_second_program_gives_the_figures_of_the_paper_trajectory(built: Fmus, name: str) -> None:
    """By the readings of the sensor, by true depth and rate, and by the reference without its rate."""
    is_adrc = name == "AdrcDepthController"
    ideal = IDEAL if is_adrc else {**IDEAL, "controller.velocity_source": "measured"}
    check(*both_figures(built[name], ROUNDED), name)
    check(*both_figures(built[name], ideal), name)
    check(*both_figures(built[name], SMOOTH | POSITION_ALONE, rate=lambda t: 0.0), name)

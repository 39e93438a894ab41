"""The loop of each other depth controller against a second program of its law, at stated gains.

Both exchange in the same order, so that they differ by how a law goes on within a step alone: not at all for
PID and the sliding modes, by the integration of its observer for ADRC (1e-4 of the RMSE, where a reading is
rounded the other way), and for MRAC by the explicit step of its estimates (0.3 %).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestration import simulate
from orchestration.scenarios import scenario
from orchestration.scenarios.scenario import Scenario
from tests.closed_loop.same_experiment import SMOOTH, figures
from tests.closed_loop.second_laws import LAWS
from tests.closed_loop.second_loop import Case, Law, continuous, run
from tests.closed_loop.second_program import Equations, LawStep, law_of
from tests.closed_loop.shipped_case import shipped_case
from tests.shared_builds import Fmus

STEP = 0.02  # s
L1 = "L1DepthController"
GAINS: Mapping[str, Mapping[str, float]] = {
    "PidDepthController": {"kp": 16.5, "ki": 5.5, "kd": 14.0, "beta": 1.0},
    "MracDepthController": {"depth_gain": 5.5, "rate_gain": 8.5, "estimate_gain": 30.0},
    "SlidingModeDepthController": {"error_bandwidth": 1.0, "switching_gain": 4.0, "boundary_layer": 0.5},
    "SuperTwistingDepthController": {
        "error_bandwidth": 1.0, "root_gain": 1.5, "twisting_gain": 0.22, "smoothing": 0.02,
    },
    "AdrcDepthController": {"control_bandwidth": 1.0, "observer_bandwidth": 4.0},
}  # fmt: skip
POSITION_ALONE = {"controller.depth_reference_rate": 0.0, "controller.depth_reference_acceleration": 0.0}
ROUNDED = {"plant.sensor_noise": 0.0}  # to the sensor's 2 mm
IDEAL = {**SMOOTH, "plant.sensor_ideal": True}
FAST = {"controller.proportional_gain": 8.0, "controller.integral_gain": 1.0}
L1_FORMS: Mapping[str, Mapping[str, Any]] = {
    "pi": FAST,
    "feedforward inside": {**FAST, "controller.reference_feedforward": "inside"},
    "feedforward outside": {**FAST, "controller.reference_feedforward": "outside"},
    "piecewise constant": {**FAST, "controller.adaptation_law": "piecewise_constant"},
    "omega_hat": {
        **FAST,
        "controller.input_gain_uncertainty": 0.3,
        "controller.input_gain_regressor": "adaptive_control_and_extension",
    },
}
ADRC = "AdrcDepthController"
TWO_SPEEDS = {"controller.observer_bandwidth": 6.0, "controller.disturbance_ratio": 0.2}


def loop_of(fmu: Path, settings: Mapping[str, Any], **layer: Any) -> Scenario:
    """The paper's trajectory by the stated gains."""
    shipped = scenario.find("nominal-extended")
    changes = {"metrics": dict.fromkeys(scenario.load(shipped).metrics, False), **layer}
    stated = {f"controller.{name}": value for name, value in GAINS.get(fmu.stem, {}).items()}
    return scenario.load(shipped, changes, settings={"controller": str(fmu), **stated, **settings})


def depths(loaded: Scenario, law: Callable[[Case, float], Law], case: Case) -> tuple[np.ndarray, ...]:
    """Time, depth of the FMUs and of the second program, and reference."""
    own = simulate(loaded.system, loaded.experiment)
    second = run(case, STEP, law(case, STEP))
    return own.time, own["plant.depth"], second["depth"], own["controller.depth_reference"]


def check(fmu: Path, settings: Mapping[str, Any]) -> None:
    loaded = loop_of(fmu, settings)
    case = shipped_case(loaded)
    if settings.items() >= POSITION_ALONE.items():
        case = replace(case, reference_rate=lambda t: 0.0)
    time, own, second, reference = depths(loaded, LAWS[fmu.stem], case)
    ours, theirs = figures(time, own, reference), figures(time, second, reference)
    is_explicit = fmu.stem == "MracDepthController"
    assert ours[0] == pytest.approx(theirs[0], rel=5e-3 if is_explicit else 5e-4)
    assert ours[1] == pytest.approx(theirs[1], abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_a_second_program_gives_the_figures_of_the_paper_trajectory(built: Fmus, name: str) -> None:
    """By the readings of the sensor, by true depth and rate, and by the reference without its rate."""
    assert built["RovDepthPlant"].is_file()
    is_adrc = name == ADRC
    ideal = IDEAL if is_adrc else {**IDEAL, "controller.velocity_source": "measured"}
    check(built[name], ROUNDED)
    check(built[name], ideal)
    check(built[name], SMOOTH | POSITION_ALONE)


@pytest.mark.slow
def test_a_second_program_gives_the_figures_of_an_observer_with_two_speeds(built: Fmus) -> None:
    assert built["RovDepthPlant"].is_file()
    for settings in (ROUNDED, IDEAL):
        check(built[ADRC], {**settings, **TWO_SPEEDS})


@pytest.mark.slow
@pytest.mark.parametrize("name", [*LAWS, *L1_FORMS, "two speeds"])
def test_a_second_program_saturates_alike_and_follows_an_accelerated_reference(
    built: Fmus, name: str
) -> None:
    """From the surface to 1 m, where r swings by 0.2 m, by thrusters of 1.5 N: each law saturates in a tenth
    of the time at least.

    The depths differ by 24 um at most; by 1 mm of MRAC, by the explicit step of its estimates.
    """
    assert built["RovDepthPlant"].is_file()
    forms = {**L1_FORMS, "two speeds": TWO_SPEEDS}
    fmu = built[name if name in LAWS else L1 if name in L1_FORMS else ADRC]
    volts = {f"plant.thruster_voltage_limit[{i}]": 3.0 for i in (1, 2)} | {"controller.voltage_limit": 3.0}
    wave = {"kind": "sine", "offset": 1.0, "amplitude": 0.2, "frequency": 0.08}
    signals = {
        "controller.depth_reference": wave,
        "controller.depth_reference_rate": {"kind": "derivative", "of": "controller.depth_reference"},
        "controller.depth_reference_acceleration": {
            "kind": "derivative", "of": "controller.depth_reference", "order": 2,
        },
    }  # fmt: skip
    layer = {"signals": signals, "experiment": {"stop_time": 60.0}}
    loaded = loop_of(fmu, {**SMOOTH, **volts, **forms.get(name, {})}, **layer)
    given = loaded.experiment.signals
    rates = [given[f"controller.depth_reference_{name}"] for name in ("rate", "acceleration")]
    case = replace(shipped_case(loaded), reference_rate=rates[0], reference_acceleration=rates[1])

    def of_l1(case: Any, step: float) -> Law:
        return law_of(case, step, LawStep.BETWEEN_MEASUREMENTS)

    _, own, second, reference = depths(loaded, LAWS.get(fmu.stem, of_l1), case)
    ours, theirs = (math.sqrt(np.mean((depth - reference) ** 2)) for depth in (own, second))
    assert ours == pytest.approx(theirs, rel=5e-4)
    apart = 2e-3 if name == "MracDepthController" else 5e-5
    np.testing.assert_allclose(own, second, rtol=0.0, atol=apart)


@pytest.mark.parametrize(
    ("name", "algorithm"), [*((name, "jacobi") for name in LAWS), (L1, "jacobi"), (L1, "gauss-seidel")]
)
def test_the_loop_tends_to_the_continuous_one_with_first_order(
    built: Fmus, name: str, algorithm: str
) -> None:
    """Inputs are held over a communication step: first order, whatever the law's own step."""
    assert built["RovDepthPlant"].is_file()
    start, speed = 0.5, 0.02  # m, m/s of the ramp
    ramp = {"kind": "ramps", "points": [[0.0, start], [100.0, start + 100.0 * speed]]}
    ideal = IDEAL if name == "AdrcDepthController" else {**IDEAL, "controller.velocity_source": "measured"}
    errors = list[float]()
    for step in (0.02, 0.01):
        steps = {"plant.internal_step": step, "controller.internal_step": step, "plant.initial_depth": start}
        layer = {
            "signals": {"controller.depth_reference": ramp},
            "experiment": {"stop_time": 20.0, "step_size": step, "algorithm": algorithm},
        }
        loaded = loop_of(built[name], {**ideal, **steps}, **layer)
        case = replace(shipped_case(loaded), reference_rate=lambda t: speed)
        own = simulate(loaded.system, loaded.experiment)
        every = round(0.5 / step)
        law = Equations(case) if name == L1 else LAWS[name](case, step)
        exact = continuous(case, own.time[::every], law)[:, 0]
        errors.append(np.abs(own["plant.depth"][::every] - exact).max())
    assert errors[1] < 2e-3  # m, the sensor's resolution
    # second-order terms are about h times the loop's 4 rad/s = 4 %
    assert math.log2(errors[0] / errors[1]) == pytest.approx(1.0, abs=0.15)

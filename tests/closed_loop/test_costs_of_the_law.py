"""What choices of the law cost, as docs/explanation/theory.md and docs/fidelity.md state it, run again."""

from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controller_fmu.l1 import depth_controller, law, lowpass
from fmus.generate import builder
from orchestration.results.metrics import evaluate
from orchestration.results.recording import Recording
from orchestration.run import Simulator
from orchestration.scenarios import scenario

DOCS = Path(__file__).parents[2] / "docs"
THEORY = (DOCS / "explanation" / "theory.md").read_text(encoding="utf-8")
FIDELITY = (DOCS / "fidelity.md").read_text(encoding="utf-8")
PAIR = ("l1", "extended")


@pytest.fixture
def no_anti_windup(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The FMU of the depth controller whose filter and integral go on in a saturation."""
    monkeypatch.setattr(lowpass, "widens", lambda saturation_error, change: False)
    monkeypatch.setattr(
        law, "integrate_error", lambda h, integral, error, saturation_error: integral + h * error
    )
    return builder.build_block(depth_controller.BLOCK, tmp_path)


def run(name: str, parameters: dict[str, Any], **others: Any) -> tuple[Recording, dict[str, float]]:
    """The recording of a shipped scenario with other parameters, and its metrics."""
    chosen = scenario.load(scenario.find(name), {"parameters": parameters, **others})
    with Simulator(chosen.system) as simulator:
        recording = simulator.run(chosen.experiment)
    return recording, evaluate(recording, chosen.metrics)


def rmse_pair(parameters: dict[str, Any], **others: Any) -> str:
    """The RMSE of plain and extended L1 as the table shows it."""
    return ", ".join(f"{run(f'nominal-{name}', parameters, **others)[1]['rmse']:.2f} cm" for name in PAIR)


def test_the_cost_of_an_uncertain_input_gain_is_documented(scenario_fmus: None) -> None:
    """omega_hat that learns from u_a alone, or from u_a + u_p, against omega that is held."""
    learning = {"controller.input_gain_uncertainty": 0.3}
    from_both = learning | {"controller.input_gain_regressor": "adaptive_control_and_extension"}
    runs = (run("nominal-extended", parameters) for parameters in (learning, from_both, {}))
    costs = [f"{values['rmse']:.2f} cm" for _, values in runs]
    assert f"| nominal, extended | {' | '.join(costs)} |" in THEORY


def test_the_filter_causes_a_fifth_of_the_lag_on_a_ramp_and_the_reference_model_the_rest() -> None:
    p = depth_controller.Parameters()
    of_model = (p.model_damping + p.rate_feedback_gain) / p.depth_feedback_gain
    of_filter = 1 / p.filter_bandwidth
    assert of_filter / (of_model + of_filter) == pytest.approx(1 / 5, abs=0.02)
    sentence = (
        f"lags by `(D_z + k_m2) / k_m1 = {of_model:.1f} s`, and the filter adds `1 / w = {of_filter:.1f} s`, "
        f"a fifth of the {of_model + of_filter:.1f} s"
    )
    assert sentence in THEORY


IDEAL = {"plant.sensor_ideal": True, "controller.velocity_source": "measured"}
LIMITS = {
    "12 V": {"controller.voltage_limit": 12.0},
    "2.8 V": {"controller.voltage_limit": 2.8},
    "2.6 V": {"controller.voltage_limit": 2.6},
    "2.6 V, ideal sensor and velocity": {"controller.voltage_limit": 2.6, **IDEAL},
}


@pytest.mark.slow
def test_the_cost_of_anti_windup_at_marginal_saturation_is_documented(
    scenario_fmus: None, no_anti_windup: Path
) -> None:
    for limit, parameters in LIMITS.items():
        without = rmse_pair(parameters, components={"controller": str(no_anti_windup)})
        line = f"| {limit} | {rmse_pair(parameters)} | {without} |"
        assert line in THEORY, line


@pytest.mark.slow
@pytest.mark.parametrize("gain", [10, 30, 100, 300, 1000, 1e4, 1e5])
def test_the_adaptation_gain_of_the_vehicle_is_chosen_by_these_figures(
    scenario_fmus: None, gain: float
) -> None:
    parameters = {"controller.adaptation_gain": gain}
    runs = [run(f"nominal-{name}", parameters) for name in PAIR]
    buoyancy = [run(f"buoyancy-{name}", parameters)[1]["rmse"] for name in PAIR]
    extended = runs[1][0]
    sigma = extended["controller.sigma_hat"]
    held = sigma[(extended.time >= 100.0) & (extended.time <= 140.0)]
    cells = [
        f"{gain:g}" if gain < 1e4 else f"1e{round(np.log10(gain))}",
        ", ".join(f"{values['settling_time']:.1f}" for _, values in runs),
        ", ".join(f"{values['rmse']:.2f}" for _, values in runs),
        ", ".join(f"{value:.2f}" for value in buoyancy),
        ", ".join(f"{values['total_variation']:.0f}" for _, values in runs),
        f"{round(held.std(), 3):.2g}; {np.abs(sigma).max():.2g}",
        ", ".join(str(delay_before_the_first_loss(name, parameters)) for name in PAIR),
    ]
    line = f"| {' | '.join(cells)} |"
    assert line in FIDELITY, line


def delay_before_the_first_loss(name: str, parameters: dict[str, Any]) -> int:
    """The last delay [ms] of the depth sensor, of 0, 20, ..., before one that moves the depth by 3 mm."""
    return next(delay for delay in count(0, 20) if not is_quiet(name, parameters, delay + 20))


def is_quiet(name: str, parameters: dict[str, Any], delay: int) -> bool:
    others = {"experiment": {"stop_time": 140.0}, "metrics": {"holding_thrust": False}}
    recording, _ = run(f"nominal-{name}", {**parameters, "plant.sensor_delay": 1e-3 * delay}, **others)
    return bool(recording["plant.depth"][recording.time >= 100.0].std() < 0.003)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "floor", "stated"),
    [("l1", 1.0, "2.14e4"), ("extended", 1.0, "2.52e4"), ("extended", 1e-9, "2.62e4")],
)
def test_the_total_variation_converges_to_that_of_its_floor(
    scenario_fmus: None, name: str, floor: float, stated: str
) -> None:
    """At a fiftieth of the shipped step, 0.17 rad of the fast loop; the error is of first order in it."""
    variation = {"function": "total_variation", "signal": "controller.control", "every": 1e-3}
    _, values = run(
        f"example-{name}",
        {"controller.threshold_floor": floor},
        experiment={"step_size": 2e-5},
        record=["controller.control"],
        metrics={"lag": False, "rmse": False, "total_variation": variation},
    )
    assert f"| {stated} |" in FIDELITY
    assert values["total_variation"] == pytest.approx(float(stated), rel=0.02)

"""Communication steps longer than the controller's internal step, as the page for importers has them."""

import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestration.errors import ScenarioWarning
from orchestration.run import simulate
from orchestration.scenarios import scenario
from orchestration.scenarios.run_files import check_steps
from orchestration.scenarios.scenario import Scenario
from tests.shared_builds import Fmus

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "importing" / "README.md"
NAME = "nominal-extended"


def stepped(step: float, **values: float) -> Scenario:
    settings = {f"controller.{name}": value for name, value in values.items()}
    return scenario.load(scenario.find(NAME), {"experiment": {"step_size": step}}, settings=settings)


def rmse(chosen: Scenario) -> float:
    recording = simulate(chosen.system, chosen.experiment)
    return float(np.sqrt(np.mean((recording["plant.depth"] - recording["controller.depth_reference"]) ** 2)))


def warnings_of(chosen: Scenario) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ScenarioWarning)
        check_steps(chosen.prepared)
    return [str(warning.message) for warning in caught]


def test_the_page_says_what_a_longer_step_costs(scenario_fmus: None) -> None:
    """At 0.04 s with the internal step that it asks for, and at 0.1 s, which the observer does not take."""
    text = PAGE.read_text(encoding="utf-8")
    assert re.search(r"up to 0.04 s \(its `observer_period`\), set `internal_step` to the same value", text)
    usual = rmse(stepped(0.02))
    assert rmse(stepped(0.04, internal_step=0.04)) == pytest.approx(usual, rel=0.01)
    assert "at 0.1 s the error stays within 1 %" in text
    assert rmse(stepped(0.1)) == pytest.approx(usual, rel=0.01)
    assert "An `observer_period` of 0.1 s doubles the error" in text
    assert rmse(stepped(0.1, internal_step=0.1, observer_period=0.1)) > 2.0 * usual


@pytest.mark.parametrize(
    ("step", "values", "advice"),
    [
        (0.02, {}, ""),
        (0.04, {"internal_step": 0.04}, ""),
        (0.03, {}, "internal_step = 0.02 s, or 0.03 s with an internal_step of 0.03 s"),
        (0.1, {}, "internal_step = 0.02 s, or 0.04 s with an internal_step of 0.04 s"),
    ],
)
def test_a_run_warns_of_a_step_longer_than_the_internal_step_of_a_controller(
    scenario_fmus: None, step: float, values: dict[str, Any], advice: str
) -> None:
    """The vehicle has an internal step too, which only divides the step."""
    messages = warnings_of(stepped(step, **values))
    assert len(messages) == bool(advice)
    assert "".join(messages).endswith(advice)
    assert all(
        m.startswith(f"controller: communication step of {step} s: expected at most ") for m in messages
    )


@pytest.mark.slow
def test_a_run_does_not_warn_of_a_law_that_takes_no_control_as_delivered(
    scenario_fmus: None, built: Fmus
) -> None:
    layer, settings = {"experiment": {"step_size": 0.1}}, {"controller": str(built["PidDepthController"])}
    assert warnings_of(scenario.load(scenario.find(NAME), layer, settings=settings)) == []

"""Units of metrics follow from what they measure."""

import pytest

from orchestration.results.metric_units import metric_unit
from orchestration.results.metrics import FUNCTIONS

UNITS = {"plant.depth": "m", "plant.force": "N", "plant.ratio": "1", "plant.unknown": ""}


@pytest.mark.parametrize(
    ("call", "unit"),
    [
        ({"function": "settling_time", "signal": "plant.depth"}, "s"),
        ({"function": "shift_lag", "signal": "plant.depth"}, "s"),
        ({"function": "phase_lag", "signal": "plant.depth"}, "s"),
        ({"function": "overshoot", "signal": "plant.depth"}, "%"),
        ({"function": "mean", "signal": "plant.force"}, "N"),
        ({"function": "total_variation", "signal": "plant.ratio"}, "1"),
        ({"function": "rmse", "signal": "plant.depth"}, "m"),
        ({"function": "rmse", "signal": "plant.depth", "scale": 100.0}, "0.01 m"),
        ({"function": "rmse", "signal": "plant.depth", "scale": 0.0}, ""),
        ({"function": "effort", "signal": "plant.force"}, "N s"),
        ({"function": "effort", "signal": "plant.ratio"}, "s"),
        ({"function": "effort", "signal": "plant.unknown"}, ""),
        ({"function": "mean", "signal": "plant.unknown"}, ""),
        ({"function": "mean", "signal": "never.heard.of"}, ""),
    ],
)
def test_a_unit_follows_from_the_function_and_its_signal(call: dict, unit: str) -> None:
    assert metric_unit(call, UNITS) == unit


@pytest.mark.parametrize("function", FUNCTIONS)
def test_every_function_that_a_scenario_can_name_has_a_unit(function: str) -> None:
    assert metric_unit({"function": function, "signal": "plant.depth"}, UNITS)

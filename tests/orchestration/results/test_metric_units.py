"""Units of metrics follow from what they measure."""

import pytest

from orchestration.results.metric_units import metric_unit, with_units
from orchestration.results.metrics import FUNCTIONS

UNITS = {
    "plant.depth": "m",
    "plant.force": "N",
    "plant.speed": "m/s",
    "plant.ratio": "1",
    "plant.unknown": "",
}


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
        ({"function": "rmse", "signal": "plant.depth", "scale": 100.0, "unit": "cm"}, "cm"),
        ({"function": "rmse", "signal": "plant.depth", "scale": 0.0}, ""),
        ({"function": "mean", "signal": "plant.unknown", "unit": "V"}, "V"),
        ({"function": "effort", "signal": "plant.force"}, "N.s"),
        ({"function": "effort", "signal": "plant.speed"}, "(m/s).s"),
        ({"function": "iae", "signal": "plant.force"}, "N.s"),
        ({"function": "ise", "signal": "plant.force"}, "N2.s"),
        ({"function": "ise", "signal": "plant.speed"}, "(m/s)2.s"),
        ({"function": "itae", "signal": "plant.force"}, "N.s2"),
        ({"function": "peak", "signal": "plant.force"}, "N"),
        ({"function": "energy_residual", "signal": "plant.force", "flow": "plant.speed"}, "N.(m/s).s"),
        ({"function": "energy_residual", "signal": "plant.force", "flow": "plant.unknown"}, ""),
        ({"function": "time_below", "signal": "plant.force"}, "s"),
        ({"function": "time_above", "signal": "plant.force"}, "s"),
        ({"function": "duty_cycle", "signal": "plant.force"}, "%"),
        ({"function": "maximum", "signal": "plant.force"}, "N"),
        ({"function": "minimum", "signal": "plant.depth", "scale": 100.0}, "0.01 m"),
        ({"function": "effort", "signal": "plant.ratio"}, "s"),
        ({"function": "effort", "signal": "plant.unknown"}, ""),
        ({"function": "mean", "signal": "plant.unknown"}, ""),
        ({"function": "mean", "signal": "never.heard.of"}, ""),
    ],
)
def test_a_unit_follows_from_the_function_and_its_signal(call: dict, unit: str) -> None:
    assert metric_unit(call, UNITS) == unit


def test_a_file_has_a_unit_beside_every_value() -> None:
    assert with_units({"lag": 1.5, "score": 2.0}, {"lag": "s"}) == {
        "lag": {"value": 1.5, "unit": "s"},
        "score": {"value": 2.0, "unit": ""},
    }


@pytest.mark.parametrize("function", FUNCTIONS)
def test_every_function_that_a_scenario_can_name_has_a_unit(function: str) -> None:
    assert metric_unit({"function": function, "signal": "plant.depth"}, UNITS)

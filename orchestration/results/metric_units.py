"""Units of metrics, as a scenario gives them or derived from functions and signals, and tables of results."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

FIXED_UNITS = {
    "settling_time": "s",
    "recovery_time": "s",
    "shift_lag": "s",
    "phase_lag": "s",
    "time_below": "s",
    "time_above": "s",
    "duty_cycle": "%",
    "overshoot": "%",
}
"""Function -> its unit, whatever the signal is measured in."""
_UNIT_OF_THE_SIGNAL = ("rmse", "peak_error", "std", "mean", "peak", "maximum", "minimum", "total_variation")
_INTEGRALS = {"effort": (1, 1), "iae": (1, 1), "ise": (2, 1), "itae": (1, 2)}
"""Function -> powers of the signal and of time in it."""

_ABSENT = {
    "settling_time": "not settled",
    "recovery_time": "not recovered",
    "shift_lag": "no lag found",
    "phase_lag": "no oscillation",
    "time_below": "never above",
    "duty_cycle": "no time passes",
}

MetricDocument = dict[str, dict[str, float | str | None]]
"""Metric -> {"value": number, "unit": text}, as in the JSON files of runs; null: it did not happen."""


def metric_units(
    declared: Mapping[str, Mapping[str, Any]], signal_units: Mapping[str, str]
) -> dict[str, str]:
    """Returns the unit of each metric that a scenario declares, "" where it is not known."""
    return {name: metric_unit(call, signal_units) for name, call in declared.items()}


def metric_unit(call: Mapping[str, Any], signal_units: Mapping[str, str]) -> str:
    """Returns the unit of a metric, "" where it is not known.

    call: the metric as the scenario declares it; signal_units: by the names of the signals.
    A scaled metric without a declared unit has a scaled unit: 100 times an RMSE in m is in 0.01 m.
    """
    function, scale = call.get("function"), call.get("scale", 1.0)
    signal_unit = signal_units.get(call.get("signal", ""), "")
    if function in FIXED_UNITS:
        return FIXED_UNITS[function]
    if call.get("unit"):
        return call["unit"]
    if function == "energy_residual":
        return _energy_unit(signal_unit, signal_units.get(call["flow"], "") if "flow" in call else "1")
    if function in _INTEGRALS:
        return _integral_unit(signal_unit, *_INTEGRALS[function])
    if function not in _UNIT_OF_THE_SIGNAL or not signal_unit or scale == 0.0:
        return ""
    return signal_unit if scale == 1.0 else f"{1.0 / scale:g} {signal_unit}"


def _energy_unit(effort: str, flow: str) -> str:
    """Returns the unit of the integral of a product over time: N and m/s -> N.(m/s).s."""
    if not (effort and flow):
        return ""
    factors = [f"({unit})" if "/" in unit else unit for unit in (effort, flow) if unit != "1"]
    return ".".join([*factors, "s"])


def _integral_unit(unit: str, power: int, time_power: int) -> str:
    """Returns the unit of an integral over time as FMI writes units: N -> N.s, m squared -> m2.s."""
    seconds = f"s{time_power}" if time_power > 1 else "s"
    if unit in ("", "1"):
        return seconds if unit else ""
    if "/" in unit or (power > 1 and not unit.isalpha()):
        unit = f"({unit})"
    return f"{unit}{power}.{seconds}" if power > 1 else f"{unit}.{seconds}"


def with_units(
    values: Mapping[str, float], units: Mapping[str, str], absent: float | None = None
) -> MetricDocument:
    """Returns each metric as a value with its unit, for a file; absent: the value of what did not happen."""
    return {
        name: {"value": absent if math.isnan(value) else value, "unit": units.get(name, "")}
        for name, value in values.items()
    }


def shown(value: float, call: Mapping[str, Any], digits: str = ".5g") -> str:
    """Returns a metric in a table: its digits, or what did not happen. call: as the scenario declares it."""
    return (
        format(value, digits)
        if not math.isnan(value)
        else _ABSENT.get(call.get("function", ""), "not a number")
    )


def metrics_table(
    title: str,
    metrics: Mapping[str, float],
    units: Mapping[str, str],
    declared: Mapping[str, Mapping[str, Any]],
) -> str:
    """Returns the metrics of one run; units, and what the scenario declares: by the names of the metrics."""
    return values_table(
        title, "Metric", {name: shown(value, declared[name]) for name, value in metrics.items()}, units
    )


def values_table(title: str, heading: str, values: Mapping[str, object], units: Mapping[str, str]) -> str:
    """Returns named values with their units in a column of their own."""
    rows = [(name, str(value), units.get(name, "")) for name, value in values.items()]
    return _table(title, (heading, "Value", "Unit"), rows)


def error_table(errors: Mapping[str, Mapping[str, float | None]], units: Mapping[str, str]) -> str:
    """Returns the estimated errors of exchanging, as the provenance of a recording has them."""
    rows = []
    for name, error in errors.items():
        values = ("not known" if value is None else f"{value:.2g}" for value in error.values())
        rows.append((name, *values, units.get(name, "")))
    return _table("Estimated error", ("Signal", "Largest", "At the end", "Unit"), rows)


def statistics_table(statistics: Mapping[str, Any]) -> str:
    """Returns the wall time of a run, as the provenance of a recording has it, with the real-time factor."""
    rows = []
    for phase, wall_s in statistics["phases_s"].items():
        rows.append((phase, "", f"{1e3 * wall_s:.3f}", "", ""))
        if phase != "stepping":
            continue
        for name, fmu in statistics["fmus"].items():
            each = f"{1e6 * fmu['wall_s'] / fmu['steps']:.3g}" if fmu["steps"] else ""
            rows.append((f"  {name}", str(fmu["steps"]), f"{1e3 * fmu['wall_s']:.3f}", each, ""))
        if "rest_of_loop_s" in statistics:
            rows.append(("  rest of the loop", "", f"{1e3 * statistics['rest_of_loop_s']:.3f}", "", ""))
    factor = float(f"{statistics['real_time_factor']:.3g}")
    title = f"Wall time: stepping takes {statistics['simulated_s']:g} s at {factor:g} times real time"
    return _table(title, ("Phase", "Steps", "Time [ms]", "Each [us]", ""), rows)


def _table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Returns lines of columns; all columns except the first and the last are numbers, aligned right."""
    # Rich, which draws the other tables, takes longer to import than a run takes
    widths = [max(map(len, column)) for column in zip(headings, *rows, strict=True)]
    lines = []
    for name, *numbers, unit in (headings, *rows):
        ends = (f"{number:>{width}}" for number, width in zip(numbers, widths[1:-1], strict=True))
        lines.append("  ".join((f"{name:<{widths[0]}}", *ends, unit)).rstrip())
    return "\n".join((title, *lines))

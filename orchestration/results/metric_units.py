"""Units of metrics, derived from what a scenario says of them and from the units of its signals."""

from collections.abc import Mapping
from typing import Any

_SECONDS = ("settling_time", "shift_lag", "phase_lag")
_AS_THE_SIGNAL = ("rmse", "mean", "total_variation")


def metric_unit(call: Mapping[str, Any], units: Mapping[str, str]) -> str:
    """The unit of a metric, "" where it is not known.

    call: the metric as the scenario declares it; units: of the signals, by name.
    A scaled metric has a scaled unit: 100 times an RMSE in m is in 0.01 m.
    """
    function, signal = call.get("function"), units.get(call.get("signal", ""), "")
    if function in _SECONDS:
        return "s"
    if function == "overshoot":
        return "%"
    if function == "effort":
        return f"{signal} s" if signal not in ("", "1") else "s" if signal else ""
    scale = call.get("scale", 1.0)
    if function not in _AS_THE_SIGNAL or not signal or scale == 0.0:
        return ""
    return signal if scale == 1.0 else f"{1.0 / scale:g} {signal}"

"""Which entries of a layer fit the FMUs that replace those of its components; `replaced.py` says why."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from fmus.fmi.model_description import ScalarVariable
from orchestration.errors import SystemDefinitionError
from orchestration.results.metrics import SIGNALS
from orchestration.scenarios.layers import Data, Layer, source_of, with_events
from orchestration.scenarios.replaced import Replacement
from orchestration.system.prepared_run import has_start_value
from orchestration.system.system import Port
from orchestration.system.values import fmi_value

_SETTABLE = ("parameter", "input")
_ANY = ()


def without_misfits(layers: Sequence[Layer], replaced: Mapping[str, Replacement]) -> list[Layer]:
    """The layers without inherited entries that do not fit, which `Replacement.dropped` then names."""
    fitted = []
    for index, layer in enumerate(layers):
        above = {name: r for name, r in replaced.items() if r.layer > index}
        fitted.append(replace(layer, data=_Fitting(above).layer(layer.data)) if above else layer)
    return fitted


class _Fitting:
    """Leaves of a layer what fits the FMUs that replace its components."""

    def __init__(self, replaced: Mapping[str, Replacement]) -> None:
        self._replaced = replaced

    def layer(self, data: Data) -> Data:
        result = dict(data)
        for table, causalities in (("parameters", _ANY), ("inputs", ("input",))):
            result |= self._table(data, table, causalities, is_value=True)
        result |= self._table(data, "signals", ("input",))
        if "vary" in data.get("sweep", {}):
            result["sweep"] = data["sweep"] | self._table(data["sweep"], "vary", _SETTABLE)
        result |= self._list(data, "connections", self._connection)
        result |= self._list(data, "record", lambda name: self._fits("records", name, name, _ANY))
        result |= self._list(
            data, "faults", lambda fault: self._fits("faults", fault["input"], fault["input"], ("input",))
        )
        if "events" in data:
            result["events"] = with_events(
                data["events"], lambda name, value: self._fits("events", name, name, _SETTABLE, value)
            )
        if "step_sizes" in data:
            result["step_sizes"] = {n: h for n, h in data["step_sizes"].items() if self._has_component(n)}
        if "metrics" in data:
            result["metrics"] = {n: m for n, m in data["metrics"].items() if self._metric(n, m)}
        return result

    def _table(self, data: Data, table: str, causalities: Sequence[str], is_value: bool = False) -> Data:
        fitting = {
            name: value
            for name, value in data.get(table, {}).items()
            if self._fits(table, name, name, causalities, value if is_value else None)
        }
        return {table: fitting} if table in data else {}

    def _list(self, data: Data, key: str, fits: Callable[[Any], bool]) -> Data:
        entries = data.get(key)
        if isinstance(entries, dict):
            as_item = (lambda k, v: [source_of(v), k]) if key == "connections" else lambda k, v: k
            return {key: {k: v for k, v in entries.items() if v is False or fits(as_item(k, v))}}
        return {} if entries is None else {key: [entry for entry in entries if fits(entry)]}

    def _connection(self, connection: Sequence[Any]) -> bool:
        source, target, *_ = connection
        shown = f"{source} -> {target}"
        return self._fits("connections", shown, source, ("output",)) and self._fits(
            "connections", shown, target, ("input",)
        )

    def _has_component(self, component: str) -> bool:
        """Whether a component with a step size of its own is left."""
        replacement = self._replaced.get(component)
        if replacement and not replacement.fmu:
            replacement.dropped.setdefault("step_sizes", []).append(component)
            return False
        return True

    def _metric(self, name: str, metric: Any) -> bool:
        signals = [metric.get(key, "") for key in SIGNALS] if metric else []
        return all(self._fits("metrics", name, signal, _ANY) for signal in signals)

    def _fits(self, kind: str, shown: str, name: str, causalities: Sequence[str], value: Any = None) -> bool:
        component, _, variable = name.partition(".")
        replacement = self._replaced.get(component)
        if replacement is None:
            return True
        port = replacement.ports.get(variable)
        if port and _has_part(port.variable, kind) and _takes(port, causalities, value):
            if kind == "parameters":
                replacement.kept[name] = value
            return True
        names = replacement.dropped.setdefault(kind, [])
        if shown not in names:
            names.append(shown)
        return False


def _has_part(variable: ScalarVariable, kind: str) -> bool:
    """Whether a variable can be set before a run, or during it, if that kind of entry does so."""
    if kind == "parameters":
        return has_start_value(variable)
    return kind != "events" or variable.variability != "fixed"


def _takes(port: Port, causalities: Sequence[str], value: Any) -> bool:
    """Whether a variable has one of the causalities, if any are given, and takes the value if given."""
    if causalities and port.variable.causality not in causalities:
        return False
    try:
        return value is None or value is False or fmi_value(port, value) is not None
    except SystemDefinitionError:
        return False

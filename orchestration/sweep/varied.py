"""The table `[sweep]` of a scenario file: the values that a sweep varies, their distributions or grids."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, TypeAdapter

from fmus.errors import nearest, number_text, range_text
from fmus.fmi.description import start_value
from fmus.fmi.variable_types import FmiValue
from orchestration.errors import OrchestrationError, ScenarioError
from orchestration.scenarios.changes import EXPERIMENT_SETTINGS, table_of_value
from orchestration.scenarios.file_tables import At, OneOf, Table, Value, checked, table_of
from orchestration.sweep.distributions import FROM_THE_FMU, FUNCTIONS, UNBOUNDED, distribution
from orchestration.system.experiment import Algorithm, Experiment
from orchestration.system.quantities import Conversion, conversion, in_unit_of
from orchestration.system.signals import Constant
from orchestration.system.system import CheckedSystem, Port
from orchestration.system.values import fmi_value, items, value_range

_PURPOSE = "sweep"


@dataclass(frozen=True)
class SweepTarget:
    """A target of a sweep: a name that it may vary.

    table: of a scenario file, which gives it; type: in FMI 2.0; an enumeration's items are texts
    permitted: its range; base_value: without a sweep; port: None for a setting of the experiment
    """

    name: str
    table: str
    unit: str
    type: str
    permitted: tuple[float, float]
    base_value: FmiValue
    port: Port | None

    def checked(self, value: FmiValue) -> FmiValue:
        """Returns the value as the table of results holds it; SystemDefinitionError if it cannot be set."""
        if self.port is None:
            return self._setting(value)
        number = fmi_value(self.port, value)
        if self.type == "Real":
            return float(number)
        if self.port.variable.type == "Enumeration":
            return next((name for name, item in items(self.port).items() if item == number), str(number))
        return number

    def change(self, unit: str, relative: bool) -> Conversion:
        """Returns the change from the unit of an entry, or from shares of the base value, to the unit."""
        if not relative:
            return in_unit_of(self.port.variable, unit) if self.port else conversion(unit, self.unit)
        if unit:
            raise ScenarioError(f"relative, and unit = {unit!r}: expected one of them")
        if self.type != "Real" or self.base_value == 0.0:
            raise ScenarioError(
                f"relative: expected a Real that is not 0, got {self.type} {self.base_value!r}"
            )
        return Conversion(float(self.base_value))

    def within(self, value: float) -> float:
        """Returns the value, moved into the range if rounding has carried it out."""
        return min(max(value, self.permitted[0]), self.permitted[1])

    def _setting(self, value: FmiValue) -> FmiValue:
        if self.type == "String":
            known = [str(algorithm) for algorithm in Algorithm]
            if value not in known:
                raise ScenarioError(f"{self.name} = {value!r}: {nearest(str(value), known)}")
            return value
        low, high = self.permitted
        if isinstance(value, (int, float)) and not isinstance(value, bool) and low < value < high:
            return float(value)
        raise ScenarioError(f"{self.name} = {value!r}: expected more than {low:g} s")


def target(name: str, checked: CheckedSystem, experiment: Experiment) -> SweepTarget:
    """Returns the target of that name; an unknown one offers the nearest."""
    if name in EXPERIMENT_SETTINGS:
        key = name.partition(".")[2]
        kind = "Real" if EXPERIMENT_SETTINGS[name] else "String"
        least = experiment.start_time if key == "stop_time" else 0.0
        base_value = getattr(experiment, key)
        return SweepTarget(
            name, "experiment", EXPERIMENT_SETTINGS[name], kind, (least, math.inf), base_value, None
        )
    if name.startswith("experiment.") and "experiment" not in checked.components:
        raise ScenarioError(
            f"{_PURPOSE}: the experiment has no {name!r} to vary; {nearest(name, EXPERIMENT_SETTINGS)}"
        )
    port = checked.port(name, _PURPOSE)
    causality = port.variable.causality
    if causality not in ("parameter", "input"):
        raise ScenarioError(f"{_PURPOSE}: {name}: expected a parameter or an input, got {causality}")
    signal = experiment.signals.get(name)
    if causality == "input" and name not in experiment.inputs and not isinstance(signal, Constant):
        is_driven = signal or any(target.name == name for _, target in checked.connections)
        got = "is driven by a connection or signal" if is_driven else "has no value, nothing drives it"
        raise ScenarioError(f"{_PURPOSE}: {name} {got}: expected a constant input, with a value in [inputs]")
    given: dict[str, Any] = {**experiment.inputs, **experiment.parameters}
    base_value = signal.value if isinstance(signal, Constant) else given.get(name, start_value(port.variable))
    return SweepTarget(
        name=name,
        table=table_of_value(name, experiment),
        unit=port.variable.unit or "",
        type="String" if port.variable.type == "Enumeration" else port.variable.type,
        permitted=value_range(port),
        base_value=base_value,
        port=port,
    )


_OPTIONAL: Any = Field(default=None)
_RELATIVE: dict[str, Any] = {"relative": (bool, False), "unit": (str, "")}
_TRUNCATE: dict[str, Any] = {"truncate": (bool, False)}


class GridTable(Table):
    """A table of a grid."""

    relative: bool = False
    """The values are factors of the variable's own value."""
    unit: str = ""
    """Unit of the values; by default the unit of the variable."""


class ValuesTable(GridTable):
    """A table of the values of a grid."""

    values: Annotated[list[Value], Field(min_length=1)]


class LinspaceTable(GridTable):
    """A table of the equally spaced values of a grid."""

    linspace: Annotated[list[float], Field(min_length=3, max_length=3)]
    """The first value, the last value and their number."""


VARIED = OneOf(
    "distribution",
    {
        name: table_of(
            "distribution",
            name,
            function,
            without=["low", "high"] if name == FROM_THE_FMU else (),
            types={"values": list[Value]},
            also=_RELATIVE | (_TRUNCATE if name in UNBOUNDED else {}),
        )
        for name, function in FUNCTIONS.items()
    },
    droppable=True,
    keyless={"values": ValuesTable, "linspace": LinspaceTable},
)


class SweepTable(Table):
    """A table of a sweep: many runs of the scenario, with other values in each."""

    samples: Annotated[int, Field(ge=1)] = 1
    """Draws, at each point of the grids if there are any."""
    seed: Annotated[int, Field(ge=0)] = 0
    timeout: Annotated[float, Field(gt=0.0)] = _OPTIONAL
    """Seconds that a sample may take; without end by default."""
    vary: Annotated[dict[str, Annotated[Table | Literal[False], VARIED]], Field(min_length=1)]
    """ "component.variable", "experiment.step_size" -> distribution or grid; false drops that entry."""


_SWEEP = TypeAdapter(SweepTable)


def sweep_table(declared: object, at: At) -> SweepTable:
    """Returns the table `[sweep]` as its type; ScenarioError if it is wrong."""
    if not declared:
        raise ScenarioError(f'{at(())}: expected a table [sweep.vary."component.variable"], got none')
    return checked(_SWEEP, declared, at)


MOST_VALUES = 10_000_000  # of a sweep: more would neither fit into memory nor end


@dataclass(frozen=True)
class Varied:
    """A varied name: `draw` maps numbers in [0, 1) to values, one a sample; `grid` lists values."""

    target: SweepTarget
    grid: tuple[FmiValue, ...] = ()
    draw: Callable[[Sequence[float]], list[FmiValue]] | None = None


def varied(target: SweepTarget, declared: Table, where: str) -> Varied:
    """Checks an entry against the range and type of its target and returns what it declares.

    Raises ScenarioError, which begins with `where`.
    """
    try:
        if isinstance(declared, ValuesTable):
            return _grid(target, declared.values, target.change(declared.unit, declared.relative))
        if isinstance(declared, LinspaceTable):
            values = _linspace(declared.linspace)
            return _grid(target, values, target.change(declared.unit, declared.relative))
        arguments = declared.given()
        name = arguments.pop("distribution")
        change = target.change(arguments.pop("unit", ""), arguments.pop("relative", False))
        return _drawn(target, name, arguments, change, arguments.pop("truncate", False))
    except OrchestrationError as error:
        raise ScenarioError(f"{where}: {error}") from error


def _grid(target: SweepTarget, values: Sequence[FmiValue], change: Conversion) -> Varied:
    _check_numbers(values, change)
    return Varied(target, grid=tuple(target.checked(change(value)) for value in values))


def _check_numbers(values: Sequence[FmiValue], change: Conversion) -> None:
    if change != Conversion() and any(isinstance(value, str) for value in values):
        raise ScenarioError(f"values = {values!r}: expected numbers beside relative or unit")


def _linspace(declared: list[float]) -> list[float]:
    first, last, count = declared
    if count != int(count) or not 2 <= count <= MOST_VALUES:
        raise ScenarioError(
            f"linspace = {declared!r}: expected [first, last, how many], 2 to {MOST_VALUES} of them"
        )
    return np.linspace(first, last, int(count)).tolist()


def _drawn(
    target: SweepTarget, name: str, arguments: dict[str, Any], change: Conversion, truncate: bool
) -> Varied:
    _check_numbers(arguments.get("values", []), change)
    low, high = sorted(map(change.inverse, target.permitted))
    law = distribution(name, arguments, (low, high), truncate)
    if law.reach[0] < low or law.reach[1] > high:
        raise ScenarioError(
            f"it reaches {' to '.join(map(number_text, law.reach))}, permitted is {range_text(low, high)}: "
            "expected low and high within that, or truncate = true"
        )

    def draw(uniforms: Sequence[float]) -> list[FmiValue]:
        values = law.quantile(uniforms)
        changed = values if change == Conversion() else [target.within(change(value)) for value in values]
        return [target.checked(value) for value in changed]

    draw(law.probes)
    return Varied(target, draw=draw)

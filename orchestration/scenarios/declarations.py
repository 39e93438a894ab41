"""Tables of a scenario file that declare a signal or a fault -> the signal or the fault.

A signal of kind `table` may name a CSV file. Its values stand in the resolved scenario, which is one file.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import TypeAdapter

from fmus.errors import FmuLoadError
from orchestration.errors import ScenarioError, ScenarioWarning, SystemDefinitionError, about
from orchestration.scenarios.data_file import read_data_file
from orchestration.scenarios.file_format import FAULT, SIGNAL
from orchestration.scenarios.file_tables import Table, checked
from orchestration.system import faults
from orchestration.system.faults import Fault
from orchestration.system.quantities import in_unit_of
from orchestration.system.signal_derivatives import KINDS
from orchestration.system.signals import Signal
from orchestration.system.system import Port
from orchestration.system.values import is_discrete, items, possible_values

_SIGNAL_TABLE = TypeAdapter(Annotated[Table, SIGNAL])
_FAULT_TABLE = TypeAdapter(Annotated[Table, FAULT])


def with_faulted_constants(data: dict[str, Any]) -> dict[str, Any]:
    """Returns the data with a constant signal in place of each constant number that a fault acts on."""
    faulted = {fault["input"] for fault in data.get("faults", [])}
    moved = {n: v for n, v in data["inputs"].items() if n in faulted and type(v) in (int, float)}
    signals = {name: {"kind": "constant", "value": value} for name, value in moved.items()}
    constants = {name: value for name, value in data["inputs"].items() if name not in moved}
    return {**data, "inputs": constants, "signals": {**data["signals"], **signals}} if moved else data


def signals_of(tables: Mapping[str, Any]) -> dict[str, Signal]:
    """Returns the signals that the tables of their inputs declare."""
    signals: dict[str, Signal] = {}
    for name, declaration in tables.items():
        with about(("signals", name, "file"), ("signals", name)):
            signals[name] = signal(declaration, f'signals."{name}"')
    return signals


def faults_of(tables: Sequence[object]) -> tuple[Fault, ...]:
    """Returns the faults that tables declare."""
    made: list[Fault] = []
    for i, declaration in enumerate(tables):
        with about(("faults", i)):
            made.append(fault(declaration, f"faults[{i}]"))
    return tuple(made)


def signal(declaration: object, where: str) -> Signal:
    """Returns the signal that a table declares by its `kind` and the arguments of that kind.

    Raises ScenarioError, which begins with `where`.
    """
    arguments = checked(_SIGNAL_TABLE, declaration, where).given()
    # the variable is not known here: `as_input_takes` converts units
    arguments.pop("unit", None)
    try:
        return KINDS[arguments.pop("kind")](**arguments)
    except ScenarioError as error:
        raise ScenarioError(f"{where}: {error}") from error


def fault(declaration: object, where: str) -> Fault:
    """Returns the fault that a table declares by `input`, `kind`, `start`, `end` and the kind's arguments.

    Raises ScenarioError, which begins with `where`.
    """
    arguments = checked(_FAULT_TABLE, declaration, where).given()
    kind, target = arguments.pop("kind"), arguments.pop("input")
    window = {name: arguments.pop(name) for name in ("start", "end") if name in arguments}
    try:
        return Fault(target, faults.KINDS[kind](**arguments), **window)
    except SystemDefinitionError as error:
        raise ScenarioError(f"{where}: {error}") from error


def as_input_takes(
    name: str, declared: Mapping[str, Any], port: Callable[[str], Port | None]
) -> Mapping[str, Any]:
    """Returns the declaration of a signal; of a table with numbers alone, held if the input is discrete.

    port: returns the input of a name
    Raises ScenarioError for a file that is no table of the input's values.
    """
    if declared["kind"] != "table":
        return declared
    names: Mapping[Any, float] = {}
    table = {key: value for key, value in declared.items() if key not in ("file", "column", "unit")}
    unit, own, places = declared.get("unit", ""), None, ()
    with suppress(FmuLoadError):
        # an input whose FMU is not built yet is checked when it runs
        if own := port(name):
            names = {"false": 0, "true": 1} if own.variable.type == "Boolean" else items(own)
            table |= {"hold": True} if is_discrete(own) else {}
    try:
        if not declared.get("file"):
            given = [str(x).lower() if isinstance(x, bool) else x for x in declared.get("values", ())]
            if other := [x for x in given if isinstance(x, str) and x not in names]:
                known = f" or one of {', '.join(names)}" * bool(names)
                raise ScenarioError(f"table: expected numbers{known}, got {other[0]!r} among the values")
            table |= {"values": [names.get(x, x) for x in given]}
        elif table.keys() & {"times", "values"}:
            raise ScenarioError("file, and times or values: expected one of them")
        else:
            columns = _columns(Path(declared["file"]), declared.get("column", ""), names)
            unit, places = _one_unit(unit, columns.pop("unit")), columns.pop("places")
            table |= columns
        if unit and (own := own or port(name)):
            change = in_unit_of(own.variable, unit)
            table["values"] = [change(x) if isinstance(x, int | float) else x for x in table["values"]]
        if own:
            _check_values(own, table.get("values", ()), places)
    except (ScenarioError, SystemDefinitionError) as error:
        keys = ("signals", name)
        raise ScenarioError(f'signals."{name}": {error}', (*keys, "file"), keys) from error
    return table


def check_overlap(signals: Mapping[str, Any], start: float, stop: float) -> None:
    """Warns (ScenarioWarning) of tables whose times are all before the run, or all after it."""
    spans = {name: signal["times"] for name, signal in signals.items() if len(signal.get("times", ())) > 1}
    apart = [name for name, times in spans.items() if times[-1] < start or times[0] > stop]
    if apart:
        listing = ", ".join(f"{name} {spans[name][0]:g}..{spans[name][-1]:g} s" for name in apart)
        message = f"tables that do not overlap the run, {start:g}..{stop:g} s, keep one value: {listing}"
        warnings.warn(message, ScenarioWarning, stacklevel=3)


def _check_values(port: Port, values: Sequence[object], places: Sequence[str]) -> None:
    """Raises ScenarioError for a number that an input cannot have; places: of the values in a file."""
    numbers = [x for x in values if isinstance(x, int | float)]
    if len(numbers) == len(values):
        expected, is_possible = possible_values(port, np.array(numbers, float))
        for i in np.flatnonzero(~is_possible)[:1]:
            where = places[i] if places else f"values[{i}]"
            raise ScenarioError(f"{where}: {numbers[i]:.9g}: expected {expected}")


def _one_unit(unit: str, of_title: str) -> str:
    """Returns the unit that a table or the title of its column states."""
    if unit and of_title and unit != of_title:
        raise ScenarioError(f"unit = {unit!r} and a column in {of_title}: expected one of them")
    return of_title or unit


def _columns(path: Path, name: str, names: Mapping[str, float]) -> dict[str, Any]:
    """Returns times [s], values, unit and lines of a column of a CSV file, by default the second."""
    file = read_data_file(path)
    if name and not file.titles:
        raise ScenarioError(f"{file.start}: column = {name!r}: expected a first line of titles")
    if not file.titles and file.rows and (count := len(file.rows[0][1])) > 2:
        raise ScenarioError(
            f"{file.start}: {count} columns without titles: expected time and value; cells that have decimal "
            "commas are separated by ; and a first line of titles lets column choose one"
        )
    times = file.times()
    if not (index := file.index(name) if name else 1):
        raise ScenarioError(
            f"{file.start}: column = {name!r}: expected another one than the first, the times"
        )
    values = file.numbers(index, names=names)[:, 0]
    return {
        "times": times.tolist(),
        "values": values.tolist(),
        "unit": file.units[index] if index < len(file.units) else "",  # a file of no rows may have one title
        "places": [f"{path}:{line}" for line, _ in file.rows],
    }

"""Tables of a scenario file that declare a signal or a fault -> the signal or the fault.

A signal of kind `table` may name a CSV file. It is read where the scenario is, so that this becomes one file.
"""

from pathlib import Path
from typing import Annotated, Any

from pydantic import TypeAdapter

from orchestration.errors import ScenarioError, SystemDefinitionError
from orchestration.scenarios.data_file import read_data_file
from orchestration.scenarios.file_format import FAULT, SIGNAL
from orchestration.scenarios.file_tables import At, Table, checked
from orchestration.scenarios.toml_file import KeyPath
from orchestration.system import faults
from orchestration.system.faults import Fault
from orchestration.system.quantities import stated
from orchestration.system.signal_derivatives import KINDS
from orchestration.system.signals import Signal

_SIGNAL_TABLE = TypeAdapter(Annotated[Table, SIGNAL])
_FAULT_TABLE = TypeAdapter(Annotated[Table, FAULT])


def signal(declaration: object, where: str) -> Signal:
    """Returns the signal that a table declares by its `kind` and the arguments of that kind.

    Raises ScenarioError, which begins with `where`.
    """
    arguments = checked(_SIGNAL_TABLE, declaration, where).given()
    arguments.pop("unit", None)  # of a variable that is not known
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


def with_file_values(signals: dict[str, Any], folder: Path, at: At, keys: KeyPath) -> dict[str, Any]:
    """Returns the signals with the times and values of each `file` in its place.

    folder: that the files are relative to
    at, keys: where the table of signals stands; begins the ScenarioError about a file
    """
    result = dict(signals)
    for name, declared in signals.items():
        given = dict(declared) if isinstance(declared, dict) else {}
        where = f'{at((*keys, name, "file" if given.get("file") else "unit"))}: signals."{name}"'
        if given.get("unit"):
            given["unit"] = stated(given["unit"], f"{where}: ")
        if given.get("file"):
            file, column = folder / given.pop("file"), given.pop("column", "")
            if given.keys() & {"times", "values"}:
                raise ScenarioError(f"{where}: file, and times or values: expected one of them")
            given |= _columns(file, column, where)
        result[name] = given or declared
    return result


def _columns(path: Path, name: str, where: str) -> dict[str, Any]:
    """Returns times [s], values and their unit, if any, of a column of a CSV file, by default the second."""
    try:
        file = read_data_file(path)
        if name and not file.titles:
            raise ScenarioError(f"{path}:1: column = {name!r}: expected a first line of titles")
        index = file.index(name) if name else 1
        times, values = file.numbers(0, index).T
        columns: dict[str, Any] = {
            "times": file.conversion(0, "s")(times).tolist(),
            "values": values.tolist(),
        }
        unit = file.units[index] if file.units else ""
        return columns | ({"unit": stated(unit, f"{where}: {path}:1: ")} if unit else {})
    except ScenarioError as error:
        raise ScenarioError(f"{where}: {error}") from error

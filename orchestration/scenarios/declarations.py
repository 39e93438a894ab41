"""Tables of a scenario file that declare a signal or a fault -> the signal or the fault."""

from typing import Annotated

from pydantic import TypeAdapter

from orchestration.errors import ScenarioError, SystemDefinitionError
from orchestration.scenarios.file_format import FAULT, SIGNAL
from orchestration.scenarios.file_tables import Table, checked
from orchestration.system import faults
from orchestration.system.faults import Fault
from orchestration.system.signal_derivatives import KINDS
from orchestration.system.signals import Signal

_SIGNAL_TABLE = TypeAdapter(Annotated[Table, SIGNAL])
_FAULT_TABLE = TypeAdapter(Annotated[Table, FAULT])


def signal(declaration: object, where: str) -> Signal:
    """Returns the signal that a table declares by its `kind` and the arguments of that kind.

    Raises ScenarioError, which begins with `where`.
    """
    arguments = checked(_SIGNAL_TABLE, declaration, where).given()
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

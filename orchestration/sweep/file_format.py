"""What the table `[sweep]` of a scenario file contains."""

from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter

from orchestration.errors import ScenarioError
from orchestration.scenarios.file_tables import OneOf, Table, Value, checked, table_of
from orchestration.sweep.distributions import FROM_THE_FMU, FUNCTIONS, UNBOUNDED

_OPTIONAL: Any = Field(default=None)
_RELATIVE: dict[str, Any] = {"relative": (bool, False)}
_TRUNCATE: dict[str, Any] = {"truncate": (bool, False)}


class ValuesTable(Table):
    """A grid: every one of these values."""

    values: Annotated[list[Value], Field(min_length=1)]
    relative: bool = False
    """The values are factors of the variable's own value."""


class LinspaceTable(Table):
    """A grid: equally spaced values."""

    linspace: Annotated[list[float], Field(min_length=3, max_length=3)]
    """[first, last, how many]"""
    relative: bool = False
    """The values are factors of the variable's own value."""


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
    """Many runs of the scenario, with other values in each."""

    samples: Annotated[int, Field(ge=1)] = 1
    """Draws, at each point of the grids if there are any."""
    seed: Annotated[int, Field(ge=0)] = 0
    timeout: Annotated[float, Field(gt=0.0)] = _OPTIONAL
    """Seconds that a sample may take; without end by default."""
    vary: Annotated[dict[str, Annotated[Table | Literal[False], VARIED]], Field(min_length=1)]
    """ "component.variable", "experiment.step_size" -> distribution or grid; false drops that of the base."""


_SWEEP = TypeAdapter(SweepTable)


def sweep_table(declared: object, where: str) -> SweepTable:
    """The table `[sweep]` as its type; ScenarioError says what is wrong with it."""
    if not declared:
        raise ScenarioError(f'{where}: expected a table [sweep.vary."component.variable"], got none')
    return checked(_SWEEP, declared, where)

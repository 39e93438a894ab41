"""The format of scenario files as types; the schema that editors use is derived from them."""
# ruff: noqa: RUF012  (Pydantic copies defaults)

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Strict, Tag

from orchestration.results import metrics
from orchestration.results.metric_units import FIXED_UNITS
from orchestration.scenarios.file_tables import OneOf, Table, Value, table_of
from orchestration.system import faults
from orchestration.system.experiment import Algorithm, Initialisation
from orchestration.system.open_inputs import OpenInputs
from orchestration.system.signal_derivatives import KINDS

Pair = Annotated[list[float], Field(min_length=2, max_length=2)]


class TransformationTable(Table):
    """Transformation of a connection: factor * output + offset."""

    factor: float = 1.0
    offset: float = 0.0


class SourceTable(TransformationTable):
    """An output, and its transformation."""

    source: str
    """ "component.output" """


_KINDS = {dict: "table", bool: "false"}
LIST_OR_TABLE = Discriminator(lambda value: "table" if isinstance(value, dict) else "list")
_Ends = Annotated[list[str], Field(min_length=2, max_length=2), Tag("ends")]
_Transformed = Annotated[tuple[str, str, TransformationTable], Strict(False), Tag("transformed")]
Connection = Annotated[
    _Ends | _Transformed,
    Discriminator(lambda value: "transformed" if isinstance(value, list) and len(value) == 3 else "ends"),
]
Source = Annotated[
    Annotated[str, Tag("text")]
    | Annotated[Literal[False], Tag("false")]
    | Annotated[SourceTable, Tag("table")],
    Discriminator(lambda value: _KINDS.get(type(value), "text")),
]
# `Experiment` has the default: it is stated once
_OPTIONAL: Any = Field(default=None)

# a file whose values stand for times and values, and their unit
_CSV: Any = {"file": (str, ""), "column": (str, ""), "unit": (str, "")}
_TABLE: Any = {"also": _CSV, "types": {"values": list[Value]}}  # of the variable's type
SIGNAL = OneOf(
    "kind",
    {
        kind: table_of("kind", kind, made, **(_TABLE if kind == "table" else {}))
        for kind, made in KINDS.items()
    },
    droppable=True,
)
FAULT = OneOf(
    "kind",
    {
        kind: table_of("kind", kind, faults.Fault, effect, without=["effect"])
        for kind, effect in faults.KINDS.items()
    },
)
METRIC = OneOf(
    "function",
    {
        name: table_of(
            "function",
            name,
            function,
            without=["recording"],
            types={"window": Pair},
            also={} if name in FIXED_UNITS else {"unit": (str, "")},
        )
        for name, function in metrics.FUNCTIONS.items()
    },
    droppable=True,
)


class ExperimentTable(Table):
    """When the run starts and stops, and how components exchange values."""

    start_time: float = _OPTIONAL
    """Start [s]; 0 by default."""
    stop_time: float
    """End of the run [s]."""
    step_size: float
    """Communication step size [s]."""
    algorithm: Annotated[Algorithm, Strict(False)] = _OPTIONAL
    """Order in which components step and exchange; jacobi by default."""
    extrapolation: int = _OPTIONAL
    """Order, 0 or 1, in which inputs are carried on between communication points."""
    tolerance: float = _OPTIONAL
    """Largest error by exchanging values at points, relative to max(|value|, nominal); varies the step."""
    fmu_tolerance: float = _OPTIONAL
    """Relative tolerance of the solvers in the FMUs; by default their own."""
    initialisation: Annotated[Initialisation, Strict(False)] = _OPTIONAL
    """How loops of initial values are solved."""
    open_inputs: Annotated[OpenInputs, Strict(False)] = _OPTIONAL
    """Inputs that nothing drives are an error, or keep the start values of their FMUs; error by default."""
    error_estimate: bool = _OPTIONAL
    """Whether a second run at twice the step follows, and estimates the error of exchanging at steps."""


class EventTable(Table):
    """Variables that are set at a time."""

    time: float
    """When [s]."""
    set: dict[str, Value]
    """ "component.variable" -> value."""


class ComponentTable(Table):
    """An FMU in the place of a base's FMU, whose variables may have other names."""

    fmu: str = ""
    """As without a table; by default the FMU of the base."""
    names: dict[str, str] = {}
    """Variable of the base or its interface -> variable of the FMU; "" for one that it has not."""


Named = Annotated[
    Annotated[str, Tag("text")]
    | Annotated[Literal[False], Tag("false")]
    | Annotated[ComponentTable, Tag("table")],
    Discriminator(lambda value: _KINDS.get(type(value), "text")),
]


class ConditionsTable(Table):
    """Conditions under which a source drives an input."""

    where: str = ""
    """A variable that has to be there."""
    without: str = ""
    """A variable that must not be there."""
    unless: dict[str, Value] = {}
    """Parameter -> value with which the source is not taken."""


class JoinTable(ConditionsTable):
    """An output that drives an input."""

    source: str
    """ "component.output" """


class DerivativeTable(ConditionsTable):
    """The derivative of an input's signal that drives another input."""

    derivative_of: str
    """ "component.input" """
    order: int = 1
    """Of the derivative, 1 or 2."""


def _kind_of_join(value: object) -> str:
    if not isinstance(value, dict):
        return "value"
    return "derivative" if "derivative_of" in value else "table"


Join = Annotated[
    Annotated[Value, Tag("value")]
    | Annotated[JoinTable, Tag("table")]
    | Annotated[DerivativeTable, Tag("derivative")],
    Discriminator(_kind_of_join),
]


class InterfaceTable(Table):
    """Ports by which components are joined, "component.variable" each."""

    required: list[list[str]] = []
    """Lists of alternatives, of which an FMU in the place of another needs one."""
    optional: list[str] = []
    """Variables that such an FMU may lack: what names them is then left out without a warning."""
    instead: dict[str, str] = {}
    """Variable -> the one that stands for it in an FMU that lacks it."""
    between: dict[str, str] = {}
    """Component that is there if an input needs its output -> name of an installed block."""
    inputs: dict[str, list[Join]] = {}
    """Input that nothing else drives -> its sources, of which it takes the first that is there."""


class ScenarioFile(Table):
    """A scenario of l1-depth: components, connections, an experiment, and what is measured."""

    title: str = ""
    """Title in results and figures; by default the name of the file."""
    base: str = ""
    """A shipped scenario, or a file relative to this one: what this file does not give is taken from it."""
    parameter_files: list[str] = []
    """Files of parameters with their provenance, relative to this one."""
    components: dict[str, Named]
    """Component -> name of an installed block, or path of an .fmu relative to this file; false removes it."""
    connections: Annotated[
        Annotated[list[Connection], Tag("list")] | Annotated[dict[str, Source], Tag("table")],
        LIST_OR_TABLE,
    ] = []
    """["component.output", "component.input"] each, in place of the connections of the base; or a table that
    changes some: "component.input" -> "component.output", { source, factor, offset } or false."""
    experiment: ExperimentTable
    step_sizes: dict[str, float] = {}
    """Component -> its own step size [s], a multiple of the communication step size."""
    parameters: dict[str, Value] = {}
    """ "component.variable" -> value; false removes the base's value, unless the parameter is Boolean."""
    inputs: dict[str, Value] = {}
    """ "component.variable" -> constant value; false removes the base's value, as for parameters."""
    signals: dict[str, Annotated[Table, SIGNAL]] = {}
    """ "component.variable" -> a function of time; false removes the base's signal."""
    events: list[EventTable] = []
    faults: list[Annotated[Table, FAULT]] = []
    """Faults on connected inputs; several on one input act in their order."""
    record: Annotated[
        Annotated[list[str], Tag("list")] | Annotated[dict[str, bool], Tag("table")], LIST_OR_TABLE
    ] = []
    """ "component.variable" of each recorded signal, in place of the base's list; by default all outputs and
    signals; or a table that changes the list: "component.variable" -> true or false."""
    metrics: dict[str, Annotated[Table | Literal[False], METRIC]] = {}
    """Name -> function and its arguments; false drops a metric of the base."""
    interface: InterfaceTable = InterfaceTable()
    """Ports by which components are joined, and which another FMU in a component's place may lack."""
    sweep: dict[str, Any] = {}
    """Many runs with other values."""


class Parameter(Table, extra="allow"):
    """A value with its provenance."""

    value: Value
    unit: str = ""
    """Unit of the value, which is converted to the unit of the variable, if this has one."""
    source: str = ""
    """Where the value is from."""


class ParameterFile(Table, extra="allow"):
    """Parameters with their provenance, to be named by `parameter_files` of a scenario."""

    parameters: dict[str, Parameter] = {}
    """ "component.variable" -> value and provenance."""

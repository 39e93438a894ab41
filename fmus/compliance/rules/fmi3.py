"""Rules of the description that FMI 3.0 alone has: arrays, clocks, aliases. FMI 3.0.2, 2.4 and 4.4."""

import math
from collections.abc import Iterator
from typing import Any

from fmus.compliance import actions as do
from fmus.compliance.fmu_file import CO_SIMULATION, MODEL_EXCHANGE, FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rows import add_rows, anything, elements, row
from fmus.compliance.rule import NotApplicableError, NotJudgedError, Stage, behaviour_rule
from fmus.compliance.script import Reply
from fmus.compliance.traces.generator import traces
from fmus.compliance.variable import Variable, Variable3, integer, is_true, number
from fmus.fmi.binding import EARLY_RETURN, EVENT_MODE, EXAMINED

_PERIODIC = ("constant", "fixed", "tunable")
_WITH = {"shiftCounter": "intervalCounter", "intervalCounter": "resolution"}  # attributes of clocks
_TIMES = "intervalDecimal", "shiftDecimal", "intervalCounter", "shiftCounter", "resolution"
_SIZES = (  # causality and variability of the sizes of dimensions
    *(("structuralParameter", "fixed"), ("structuralParameter", "tunable")),
    *(("output", "constant"), ("local", "constant")),
)
_ICON = "terminalsAndIcons/icon"
_LISTS = """(
    UnitDefinitions/Unit | UnitDefinitions/Unit/DisplayUnit | TypeDefinitions/* | TypeDefinitions/*/Item
    | LogCategories/Category | ModelVariables/* | ModelVariables/*/Alias
)[normalize-space(@name) = '']"""


def _stating(attribute: str) -> Any:
    """Returns the subjects of a row: the variables that state an attribute."""
    return lambda fmu: [v for v in fmu.variables if attribute in v.attributes]


def _of_kind(kind: str) -> Any:
    return lambda fmu: [v for v in fmu.variables if v.kind == kind]


def _dimensions(fmu: FmuFile) -> Iterator[tuple[Variable, Any]]:
    """Yields each dimension with its variable."""
    for v in fmu.variables:
        yield from ((v, dimension) for dimension in v.element.iterfind("Dimension"))


def _size_variable(dimension: Any, fmu: FmuFile) -> Variable | None:
    return fmu.by_key.get(integer(dimension.get("valueReference")))


def _wrong_size(subject: tuple[Variable, Any], fmu: FmuFile) -> str:
    """Returns why a dimension has no size, if so."""
    _, dimension = subject
    start, reference = dimension.get("start"), dimension.get("valueReference")
    if (start is None) == (reference is None):
        return f"start {start} and valueReference {reference}: expected one of them"
    if start is not None:
        return "" if integer(start) else f"size {start}: expected 1 at least"
    v = _size_variable(dimension, fmu)
    if not v or v.kind != "UInt64" or (v.causality, v.variability) not in _SIZES:
        name = f"{v.name} ({v.kind}, {v.causality}, {v.variability})" if v else f"value reference {reference}"
        return f"size {name}: expected a UInt64 that is a structural parameter or constant"
    return "" if integer(v.start) else f"size {v.name} with start {v.start}: expected 1 at least"


def _wrong_count(v: Variable, fmu: FmuFile) -> str:
    """Returns the number of start values and the expected one, if they differ."""
    listed = v.element.findall("Dimension")
    # `dimensions` reports a dimension without size
    if len(v.starts) == 1 or any(_wrong_size((v, dimension), fmu) for dimension in listed):
        return ""
    stated = ((_size_variable(d, fmu), d.get("start")) for d in listed)
    count = math.prod(integer(of.start if of else text) or 0 for of, text in stated)
    expected = f"1 or {count}" if count > 1 else "1"
    return "" if len(v.starts) == count else f"{len(v.starts)} start values: expected {expected}"


def _clock_problem(clock: Variable, _: FmuFile) -> str:
    """Returns the attribute of a clock that is missing, or that is wrong or left over."""
    times = {name: x for name in _TIMES if (x := clock.number(name)) is not None}
    if clock.get("intervalVariability") not in _PERIODIC:
        return f"{', '.join(times)}, and is not periodic: expected none" if times else ""
    if "intervalCounter" in times and not is_true(clock.get("supportsFraction")):
        return "intervalCounter: expected supportsFraction too"
    if "intervalDecimal" not in times:
        return "no intervalDecimal: expected one, as it is periodic"
    missing = (
        f"{one}: expected {other} too" for one, other in _WITH.items() if one in times and other not in times
    )
    wrong = (f"{name} {x:g}" for name, x in times.items() if x < 0 or (x == 0 and "shift" not in name))
    return next(missing, "") or next((f"{text}: expected more" for text in wrong), "")


def _no_clocks(v: Variable3, fmu: FmuFile) -> str:
    """Returns the references of a clocked variable that lead to no Clock."""
    clocks = {r for r, known in fmu.by_key.items() if known.kind == "Clock"}
    return ", ".join(str(reference) for reference in v.references("clocks") if reference not in clocks)


def _previous_problem(v: Variable, fmu: FmuFile) -> str:
    """Returns what is wrong with a variable that names its previous value, or with that."""
    if "clocks" not in v.attributes or v.variability != "discrete" or v.kind == "Clock":
        return f"it is {v.variability} {v.kind}: expected a discrete clocked variable"
    of = fmu.by_key.get(integer(v.attributes["previous"]))
    if of is None or of is v:
        return f"{v.attributes['previous']}: expected the value reference of another variable"
    count = [x.attributes.get("previous") for x in fmu.variables].count(v.attributes["previous"])
    if count > 1:
        return f"{of.name} is the previous value of {count} variables: expected a variable for each"
    is_fit = of.kind == v.kind and of.variability == "discrete" and of.causality != "input"
    return "" if is_fit else f"{of.name} is {of.variability} {of.kind} ({of.causality}): expected another one"


def _flag_problem(interface: Any, fmu: FmuFile) -> str:
    """Returns a flag that is missing beside another, or with clocks."""
    early, updates = "canReturnEarlyAfterIntermediateUpdate", "providesIntermediateUpdate"
    if is_true(interface.get(early)) and not is_true(interface.get(updates)):
        return f"{early}: expected {updates} too"
    needs_events = any(v.kind == "Clock" for v in fmu.variables) and not is_true(
        interface.get("hasEventMode")
    )
    return "clocks: expected hasEventMode" if needs_events else ""


def _display_unit_problem(alias: Any, fmu: FmuFile) -> str:
    """Returns the display units of the unit of an alias, if its own is not among them."""
    of = next(v for v in fmu.variables if v.element is alias.getparent())
    unit = fmu.units.get(of.get("unit") or "")
    known = [] if unit is None else [element.get("name") for element in unit.iterfind("DisplayUnit")]
    return "" if alias.get("displayUnit") in known else ", ".join(map(str, known)) or "none"


add_rows(__name__, Stage.DESCRIPTION, rows=(
    row("names-of-lists", elements(_LISTS),
        (anything, "line {subject.sourceline}: {subject.tag} has the name {name!r}: expected one")),
    row("inverse-has-no-offset", elements("UnitDefinitions/Unit/DisplayUnit"),
        (lambda unit, _: is_true(unit.get("inverse")) and number(unit.get("offset")),
         "display unit {name!r} is inverse and has the offset {value:g}: expected 0")),
    row("display-units-of-aliases", elements("ModelVariables/*/Alias[@displayUnit]"),
        (_display_unit_problem, "alias {name!r}: displayUnit {displayUnit!r}: expected {value}")),
    row("value-references-are-unique",
        lambda fmu: [v for v in fmu.variables if fmu.by_key.get(v.reference) is not v],
        (lambda v, fmu: v.reference is not None and fmu.by_key[v.reference].name,
         "{name} has the value reference of {value}, {reference}: expected another")),
    row("independent-variable-is-given",
        elements("ModelVariables[not(*/@causality[normalize-space() = 'independent'])]"),
        (anything, "no variable is independent: expected one")),
    row("dimensions", _dimensions, (_wrong_size, "{subject[0].name}: {value}")),
    row("start-values-fill-the-array", lambda fmu: [v for v in fmu.variables if v.starts],
        (_wrong_count, "{name}: {value}")),
    row("structural-parameters",
        lambda fmu: [v for v in fmu.variables if v.causality == "structuralParameter"],
        (lambda v, _: v.element.find("Dimension") is not None,
         "{name} is a structural parameter and has a Dimension: expected a scalar")),
    row("clocks", _of_kind("Clock"),
        (lambda v, _: v.causality not in ("input", "output", "local") or v.variability != "discrete",
         "{name} is {causality} and {variability}: expected a discrete input, output or local Clock")),
    row("clock-intervals", _of_kind("Clock"), (_clock_problem, "{name} has {value}")),
    row("clocked-variables", _stating("clocks"),
        (_no_clocks, "{name}: clocks lists {value}: expected value references of Clocks"),
        (lambda v, _: not v.references("clocks"), "{name}: clocks is empty: expected a value reference"),
        (lambda v, _: v.variability not in ("discrete", "tunable"),
         "{name} is clocked and {variability}: expected discrete or tunable")),
    row("previous-values", _stating("previous"), (_previous_problem, "{name}, previous: {value}")),
    row("clocked-states", lambda fmu: fmu.unknowns["ClockedStates"],
        (lambda unknown, _: unknown.variable.index and (
            not {"clocks", "previous"} <= unknown.variable.attributes.keys()
            or unknown.variable.variability != "discrete" or unknown.variable.kind == "Clock"),
         "{where}: expected a discrete clocked variable with the attribute previous")),
    row("event-indicators", lambda fmu: fmu.unknowns["EventIndicators"],
        (lambda u, _: u.variable.index
         and (u.variable.base_kind, u.variable.variability) != ("Real", "continuous"),
         "{where} is {variable.variability} {variable.kind}: expected a continuous Float64 or Float32"),
        (lambda u, _: u.variable.index and u.variable.causality not in ("local", "output"),
         "{where} is {variable.causality}: expected local or output")),
    row("intermediate-variables",
        lambda fmu: [v for v in fmu.variables if is_true(v.attributes.get("intermediateUpdate"))],
        (lambda v, _: v.variability != "continuous" or v.kind == "Clock",
         "{name} is {variability} {kind} and has intermediateUpdate: expected a continuous variable")),
    row("svg-has-a-png", lambda fmu: fmu.paths & {f"{_ICON}.svg"},
        (lambda _, fmu: f"{_ICON}.png" not in fmu.paths, f"{{subject}}: expected {_ICON}.png too")),
    row("co-simulation-flags", elements(CO_SIMULATION), (_flag_problem, "{subject.tag} has {value}")),
))  # fmt: skip


@behaviour_rule("")
def clocks_have_partitions(probe: Probe) -> None:
    """Clocks are not judged."""
    if probe.fmu.has_clocks:
        raise NotJudgedError("clocks are not judged")
    raise NotApplicableError("there are no clocks")


@behaviour_rule("", interface=CO_SIMULATION)
def steps_with_events(probe: Probe) -> None:
    """Random runs succeed with event mode, where the FMU has it, early return and intermediate updates: each
    is in the step, and events come to an end.
    """
    mode = EVENT_MODE if probe.fmu.claims("hasEventMode") else 0
    for trace in traces(probe):
        for uses in dict.fromkeys((mode, mode | EARLY_RETURN)):
            probe.script(*trace.whole(), logging=True, uses=EXAMINED | uses).play()


def _counts(probe: Probe) -> list[Reply]:
    """Returns replies with the numbers of states and of event indicators, at first and in event mode."""
    ask = [do.call("count", f"fmi2GetNumberOf{what}") for what in ("ContinuousStates", "EventIndicators")]
    script = do.played(probe, [*ask, do.begin, *ask], logging=True)
    return [reply for reply in script.replies if reply.function.startswith("fmi2GetNumberOf") and reply.ok]


add_rows(__name__, Stage.BEHAVIOUR, interface=MODEL_EXCHANGE, rows=(
    row("counts-are-as-described", _counts,
        (lambda reply, probe: reply.value != (n := probe.fmu.vector_length(reply.function)) and f"{n}",
         "{function} gives {subject.value}: expected {value}, as in the description")),
))  # fmt: skip

"""Rules of variables one by one: causality, start values, derivatives. FMI 2.0.5, 2.2.7."""

from collections.abc import Iterator

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rule import Stage, rule
from fmus.compliance.variable import INITIAL, Variable, integer

_CLAUSE = "2.2.7 Definition of Model Variables (ModelVariables)"
_NAMED = ("parameter", "calculatedParameter", "input", "output", "local", "independent")


@rule(_CLAUSE, Stage.DESCRIPTION)
def causality_and_variability(fmu: FmuFile) -> Iterator[str]:
    """Causality and variability are one of the pairs that FMI allows."""
    for v in fmu.variables:
        if not v.is_legal_pair and v.causality in _NAMED:
            legal = " or ".join(variability for causality, variability in INITIAL if causality == v.causality)
            yield f"{v.name}: causality {v.causality} with variability {v.variability}: expected {legal}"


@rule(_CLAUSE, Stage.DESCRIPTION)
def continuous_is_real(fmu: FmuFile) -> Iterator[str]:
    """Only a Real is continuous, which is the default."""
    for v in fmu.variables:
        is_continuous = v.is_legal_pair and v.variability == "continuous" and v.causality != "independent"
        if is_continuous and v.kind not in ("Real", ""):
            stated = "stated" if "variability" in v.attributes else "the default"
            yield f"{v.name} is {v.kind} and continuous ({stated}): expected another variability"


@rule(_CLAUSE, Stage.DESCRIPTION)
def initial_is_legal(fmu: FmuFile) -> Iterator[str]:
    """`initial` is what causality and variability allow."""
    for v in fmu.variables:
        stated = v.attributes.get("initial")
        if stated is not None and v.is_legal_pair:
            allowed = INITIAL[v.causality, v.variability]
            if stated not in allowed:
                what = f"{v.causality}, {v.variability}"
                yield f"{v.name} ({what}): initial {stated}: expected {' or '.join(allowed) or 'none'}"


@rule(_CLAUSE, Stage.DESCRIPTION)
def start_is_given(fmu: FmuFile) -> Iterator[str]:
    """Inputs and variables with initial exact or approx have a start value, no others."""
    for v in fmu.variables:
        allowed = INITIAL.get((v.causality, v.variability))
        if allowed is None or not v.kind:
            continue  # a rule of its own tells it
        initial = v.initial if v.initial in allowed else (allowed or ("",))[0]
        needed = v.causality == "input" or initial in ("exact", "approx")
        what = f"{v.name} ({v.causality}, {v.variability}, initial {initial or 'none'})"
        if needed and v.start is None:
            yield f"{what}: expected a start value"
        elif not needed and v.start is not None:
            yield f"{what} has start {v.start!r}: expected none"


@rule(_CLAUSE, Stage.DESCRIPTION)
def one_independent_variable(fmu: FmuFile) -> Iterator[str]:
    """At most one variable is independent; it is a Real."""
    independent: list[Variable] = [v for v in fmu.variables if v.causality == "independent"]
    if len(independent) > 1:
        yield f"{', '.join(v.name for v in independent)} are independent: expected one at most"
    for v in independent:
        if v.kind not in ("Real", ""):
            yield f"{v.name} is independent and {v.kind}: expected Real"


@rule(_CLAUSE, Stage.DESCRIPTION)
def time_is_independent(fmu: FmuFile) -> Iterator[str]:
    """Without an independent variable no other is called time, as FMI calls the one that is implied."""
    names = {v.name: v.causality for v in fmu.variables}
    if "time" in names and "independent" not in names.values():
        yield f"time is {names['time']} and no variable is independent: expected another name"


@rule(_CLAUSE, Stage.DESCRIPTION)
def set_once_is_of_inputs(fmu: FmuFile) -> Iterator[str]:
    """canHandleMultipleSetPerTimeInstant is stated for inputs of FMUs for model exchange alone."""
    for v in fmu.variables:
        if "canHandleMultipleSetPerTimeInstant" in v.attributes:
            if "ModelExchange" not in fmu.interfaces:
                yield f"{v.name} has canHandleMultipleSetPerTimeInstant: expected none without ModelExchange"
            elif v.causality != "input":
                yield f"{v.name} ({v.causality}) has canHandleMultipleSetPerTimeInstant: expected an input"


@rule(_CLAUSE, Stage.DESCRIPTION)
def reinit_is_of_states(fmu: FmuFile) -> Iterator[str]:
    """reinit is stated for continuous-time states of FMUs for model exchange alone."""
    for v in fmu.variables:
        if "reinit" in v.typed:
            if "ModelExchange" not in fmu.interfaces:
                yield f"{v.name} has reinit: expected none without ModelExchange"
            elif v.index not in fmu.states:
                yield f"{v.name} has reinit: expected a continuous-time state"


@rule(_CLAUSE, Stage.DESCRIPTION)
def derivative_is_of_a_variable(fmu: FmuFile) -> Iterator[str]:
    """The attribute derivative is the index of another variable, both Real, in Derivatives continuous."""
    for v in fmu.variables:
        if "derivative" not in v.typed:
            continue
        index = integer(v.typed["derivative"])
        if index is None or not 1 <= index <= len(fmu.variables) or index == v.index:
            yield f"{v.name}: derivative {v.typed['derivative']}: expected another variable's index"
            continue
        other = fmu.variables[index - 1]
        for variable in (v, other):
            if variable.kind != "Real":
                what = f"{variable.name} ({variable.kind})"
                yield f"{v.name}, derivative of {other.name}: {what}: expected Real"
            elif v.index in fmu.state_derivatives:
                yield from _not_continuous(v, other, variable)


@rule("advice: a discrete variable has no derivative", Stage.DESCRIPTION)
def derivative_is_continuous(fmu: FmuFile) -> Iterator[str]:
    """A derivative that Derivatives does not list, and its variable, are continuous."""
    for v in fmu.variables:
        index = integer(v.typed.get("derivative"))
        if index is None or not 1 <= index <= len(fmu.variables) or v.index in fmu.state_derivatives:
            continue
        other = fmu.variables[index - 1]
        for variable in (v, other):
            if variable.kind == "Real":
                yield from _not_continuous(v, other, variable)


def _not_continuous(derivative: Variable, of: Variable, variable: Variable) -> Iterator[str]:
    if variable.variability != "continuous":
        what = f"{variable.name} ({variable.variability})"
        yield f"{derivative.name}, derivative of {of.name}: {what}: expected continuous"


@rule(_CLAUSE, Stage.DESCRIPTION)
def states_are_local_or_outputs(fmu: FmuFile) -> Iterator[str]:
    """A continuous-time state is a local variable or an output."""
    for v in (fmu.variables[index - 1] for index in sorted(fmu.states)):
        if v.causality not in ("local", "output"):
            yield f"{v.name} is a continuous-time state and {v.causality}: expected local or output"

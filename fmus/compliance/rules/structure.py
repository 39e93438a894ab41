"""Rules of dependencies and lists of unknowns: FMI 2.0.5, 2.2.8 Definition of the Model Structure."""

import itertools
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rule import Stage, repeated, rule
from fmus.compliance.variable import Variable, integer

_CLAUSE = "2.2.8 Definition of the Model Structure (ModelStructure)"
_SECTIONS = ("Outputs", "Derivatives", "InitialUnknowns")
_FACTORS = {"constant", "fixed", "tunable", "discrete"}
_COMPUTED = ("approx", "calculated")


def _indices(fmu: FmuFile, section: str) -> list[int]:
    return [index for index, _ in fmu.unknowns(section) if index is not None]


def _listed(fmu: FmuFile, indices: set[int]) -> str:
    return ", ".join(f"{fmu.variables[index - 1].name} ({index})" for index in sorted(indices))


def _derivatives_are_ignored(fmu: FmuFile) -> bool:
    """Derivatives without directional derivatives mean nothing in an FMU for co-simulation alone."""
    return set(fmu.interfaces) == {"CoSimulation"} and not fmu.claims("providesDirectionalDerivative")


@rule(_CLAUSE, Stage.DESCRIPTION)
def structure_indices(fmu: FmuFile) -> Iterator[str]:
    """Each Unknown is the index of a variable, once in its section."""
    for section in _SECTIONS:
        for index, element in fmu.unknowns(section):
            if index is None:
                yield f"{section}: index {element.get('index')}: expected 1..{len(fmu.variables)}"
        for index, count in repeated(_indices(fmu, section)).items():
            yield f"{section} lists {_listed(fmu, {index})} {count} times: expected once"


@rule(_CLAUSE, Stage.DESCRIPTION)
def outputs_are_listed(fmu: FmuFile) -> Iterator[str]:
    """Outputs lists exactly the variables of causality output."""
    got, expected = set(_indices(fmu, "Outputs")), {v.index for v in fmu.variables if v.causality == "output"}
    yield from _difference(fmu, "Outputs", got, expected, expected)


def _difference(
    fmu: FmuFile, section: str, got: set[int], expected: set[int], allowed: set[int]
) -> Iterator[str]:
    if expected - got:
        yield f"{section} lacks {_listed(fmu, expected - got)}"
    if got - allowed:
        yield f"{section} lists {_listed(fmu, got - allowed)}: expected it not to"


@rule(_CLAUSE, Stage.DESCRIPTION)
def derivatives_are_marked(fmu: FmuFile) -> Iterator[str]:
    """Variables that Derivatives lists have the attribute derivative, each of a state of its own."""
    for index in _indices(fmu, "Derivatives"):
        v = fmu.variables[index - 1]
        if "derivative" not in v.typed:
            yield f"Derivatives lists {v.name} ({index}): expected a variable with the attribute derivative"
    for state, count in repeated(fmu.state_derivatives.values()).items():
        if len(set(_indices(fmu, "Derivatives"))) == len(_indices(fmu, "Derivatives")):
            yield f"Derivatives lists {count} derivatives of {_listed(fmu, {state})}: expected one"


def no_model_exchange(fmu: FmuFile) -> str:
    return "" if "ModelExchange" in fmu.interfaces else "it has no interface for model exchange"


@rule(_CLAUSE, Stage.DESCRIPTION, condition=no_model_exchange)
def derivatives_are_there(fmu: FmuFile) -> Iterator[str]:
    """For model exchange there are Derivatives if a variable with initial exact has a derivative."""
    for derivative, state in _unlisted_derivatives(fmu):
        if fmu.root.find("ModelStructure/Derivatives") is None and state.initial == "exact":
            yield f"no Derivatives: expected {derivative.name} there, the derivative of {state.name}"


@rule(_CLAUSE, Stage.DESCRIPTION, condition=no_model_exchange)
def state_derivatives_are_listed(fmu: FmuFile) -> Iterator[str]:
    """For model exchange, Derivatives lists the derivatives of local variables, which may be states."""
    for derivative, state in _unlisted_derivatives(fmu):
        if state.causality == "local":
            yield f"Derivatives lacks {derivative.name} ({derivative.index}), the derivative of {state.name}"


def _unlisted_derivatives(fmu: FmuFile) -> Iterator[tuple[Variable, Variable]]:
    """Yields (derivative that Derivatives lacks, its variable): no state, nor its alias, nor a derivative."""
    listed = set(_indices(fmu, "Derivatives"))
    states = {(v.base_kind, v.reference) for v in (fmu.variables[i - 1] for i in fmu.states | listed)}
    for v in fmu.variables:
        index = integer(v.typed.get("derivative"))
        if index is None or not 1 <= index <= len(fmu.variables) or v.index in listed or index == v.index:
            continue
        state = fmu.variables[index - 1]
        is_possible = state.causality in ("local", "output") and state.variability == "continuous"
        if is_possible and (state.base_kind, state.reference) not in states:
            yield v, state


@rule(_CLAUSE, Stage.DESCRIPTION)
def initial_unknowns_are_complete(fmu: FmuFile) -> Iterator[str]:
    """InitialUnknowns lists outputs, states and their derivatives with initial approx or calculated, and all
    calculated parameters; no others."""
    expected = {
        v.index
        for v in fmu.variables
        if v.causality == "calculatedParameter" or (v.causality == "output" and v.initial in _COMPUTED)
    }
    of_states = {
        index
        for index in fmu.states | set(fmu.state_derivatives)
        if fmu.variables[index - 1].initial in _COMPUTED
    }
    unclear = {v.index for v in fmu.variables if v.causality == "output" and not v.is_legal_pair}
    allowed = expected | of_states | unclear
    if not _derivatives_are_ignored(fmu):
        expected |= of_states
    yield from _difference(fmu, "InitialUnknowns", set(_indices(fmu, "InitialUnknowns")), expected, allowed)


@rule(_CLAUSE, Stage.DESCRIPTION)
def initial_unknowns_ascend(fmu: FmuFile) -> Iterator[str]:
    """InitialUnknowns are in ascending order of their indices."""
    for before, after in itertools.pairwise(_indices(fmu, "InitialUnknowns")):
        if after < before:
            yield f"InitialUnknowns: {after} follows {before}: expected ascending indices"


_Dependencies = tuple[str, str, Variable | None, list[str], Any]


@lru_cache(maxsize=1)
def _dependencies(fmu: FmuFile) -> tuple[_Dependencies, ...]:
    """Returns (section, text that names the unknown, unknown, its dependencies, element)."""
    return tuple(_of_unknowns(fmu))


def _of_unknowns(fmu: FmuFile) -> Iterator[_Dependencies]:
    for section in _SECTIONS:
        for index, element in fmu.unknowns(section):
            unknown = fmu.variables[index - 1] if index is not None else None
            where = f"{section}, unknown {unknown.name if unknown else ''} ({element.get('index')})"
            yield section, where, unknown, element.get("dependencies", "").split(), element


@rule(_CLAUSE, Stage.DESCRIPTION)
def dependencies_are_indices(fmu: FmuFile) -> Iterator[str]:
    """Dependencies are indices of variables, each once."""
    for _, where, _, listed, _ in _dependencies(fmu):
        for text in listed:
            index = integer(text)
            if index is not None and not 1 <= index <= len(fmu.variables):
                yield f"{where}: dependency {text}: expected 1..{len(fmu.variables)}"
        for text, count in repeated(listed).items():
            yield f"{where}: dependency {text} is listed {count} times: expected once"


@rule(_CLAUSE, Stage.DESCRIPTION)
def dependencies_ascend(fmu: FmuFile) -> Iterator[str]:
    """Dependencies are in ascending order."""
    for _, where, _, listed, _ in _dependencies(fmu):
        indices = [index for index in map(integer, listed) if index is not None]
        for before, after in itertools.pairwise(indices):
            if after < before:
                yield f"{where}: dependency {after} follows {before}: expected ascending indices"


@rule(_CLAUSE, Stage.DESCRIPTION)
def dependencies_are_known(fmu: FmuFile) -> Iterator[str]:
    """Outputs and Derivatives depend on inputs, continuous-time states and the independent variable;
    InitialUnknowns on inputs, the independent variable and what has initial exact."""
    for known, where, expected in _knowns(fmu):
        if known.causality not in _PARAMETERS or expected == _AT_START:
            yield f"{where} depends on {known.name} ({known.causality}): expected {expected}"


@rule(_CLAUSE, Stage.DESCRIPTION)
def dependencies_on_parameters(fmu: FmuFile) -> Iterator[str]:
    """Outputs and Derivatives name no parameter among their dependencies."""
    for known, where, expected in _knowns(fmu):
        if known.causality in _PARAMETERS and expected != _AT_START:
            yield f"{where} depends on {known.name}, a parameter: expected {expected}"


_PARAMETERS = ("parameter", "calculatedParameter")
_AT_START = "an input or what has initial exact"
_LATER = "an input, a continuous-time state or the independent variable"


def _knowns(fmu: FmuFile) -> Iterator[tuple[Variable, str, str]]:
    """Yields (dependency that is none of the Knowns, its unknown, what is expected)."""
    states = _possible_states(fmu)
    for section, where, _, listed, _ in _dependencies(fmu):
        for index in map(integer, listed):
            if index is None or not 1 <= index <= len(fmu.variables):
                continue
            known, is_at_start = fmu.variables[index - 1], section == "InitialUnknowns"
            is_given = known.initial == "exact" or known.causality == "parameter" or not known.is_legal_pair
            known_otherwise = is_given if is_at_start else index in states
            if known.causality not in ("input", "independent") and not known_otherwise:
                yield known, where, _AT_START if is_at_start else _LATER


def _possible_states(fmu: FmuFile) -> frozenset[int]:
    """States, and in an FMU that need not list Derivatives whatever another variable is the derivative of."""
    if "ModelExchange" in fmu.interfaces:
        return fmu.states
    marked = (integer(v.typed.get("derivative")) for v in fmu.variables)
    return fmu.states | {index for index in marked if index is not None}


@rule(_CLAUSE, Stage.DESCRIPTION)
def dependencies_on_states_are_provided(fmu: FmuFile) -> Iterator[str]:
    """For co-simulation alone, dependencies name states if providesDirectionalDerivative is true."""
    if not _derivatives_are_ignored(fmu):
        return
    states = _possible_states(fmu)
    for section, where, _, listed, _ in _dependencies(fmu):
        for index in map(integer, listed):
            if section != "InitialUnknowns" and index in states:
                name = fmu.variables[index - 1].name if 1 <= index <= len(fmu.variables) else ""
                yield f"{where} depends on the state {name}: expected providesDirectionalDerivative"


@rule(_CLAUSE, Stage.DESCRIPTION)
def dependencies_kind(fmu: FmuFile) -> Iterator[str]:
    """dependenciesKind has one word for each dependency; in InitialUnknowns dependent or constant."""
    for section, where, _, listed, element in _dependencies(fmu):
        kinds = element.get("dependenciesKind")
        if kinds is None:
            continue
        if element.get("dependencies") is None:
            yield f"{where} has dependenciesKind: expected dependencies too"
        elif len(kinds.split()) != len(listed):
            yield f"{where}: {len(kinds.split())} kinds of dependency: expected {len(listed)}, one each"
        for kind in sorted(set(kinds.split()) & _FACTORS) if section == "InitialUnknowns" else ():
            if kind != "constant":
                yield f"{where}: kind {kind!r}: expected dependent or constant"


@rule(_CLAUSE, Stage.DESCRIPTION)
def dependencies_of_reals_have_factors(fmu: FmuFile) -> Iterator[str]:
    """Kinds of dependency with a factor, all but dependent, are of Real unknowns."""
    for _, where, unknown, _, element in _dependencies(fmu):
        factors = sorted(set(element.get("dependenciesKind", "").split()) & _FACTORS)
        if factors and unknown is not None and unknown.kind not in ("Real", ""):
            yield f"{where} is {unknown.kind} and has kind {factors[0]!r}: expected dependent"

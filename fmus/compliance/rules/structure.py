"""Rules of dependencies and lists of unknowns: FMI 2.0.5, 2.2.8 Definition of the Model Structure."""

import itertools
from collections.abc import Iterator, Sequence
from functools import lru_cache

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rows import add_rows, row
from fmus.compliance.rule import Stage, repeated, rule
from fmus.compliance.variable import Unknown, Variable, integer

_FACTORS = {"constant", "fixed", "tunable", "discrete"}
_COMPUTED = ("approx", "calculated")
_LATER = "an input, a continuous-time state or the independent variable"
_WITH_KNOWNS = "Outputs", "Derivatives", "InitialUnknowns"
_LATER_OF_FMI_3 = "an input, a state, a parameter or the independent variable"
_DEPENDS = "{subject[0].where} depends on {subject[1].name} ({subject[1].causality})"


def _unknowns(fmu: FmuFile) -> list[Unknown]:
    return [unknown for unknowns in fmu.unknowns.values() for unknown in unknowns]


def _knowns(unknown: Unknown, fmu: FmuFile) -> list[Variable]:
    """Returns the variables that an unknown lists as its dependencies."""
    return [fmu.by_key[i] for i in map(integer, unknown.dependencies) if i in fmu.by_key]


def _factors(unknown: Unknown) -> set[str]:
    """Returns the kinds of dependencies but dependent."""
    return _FACTORS & {*unknown.kinds}


def _indices(fmu: FmuFile, section: str) -> list[int]:
    indices = (unknown.variable.index for unknown in fmu.unknowns[section])
    return [index for index in indices if index]


def _listed(fmu: FmuFile, indices: set[int]) -> str:
    listed = (fmu.variables[index - 1] for index in sorted(indices))
    return ", ".join(f"{v.name} ({v.reference if fmu.is_fmi3 else v.index})" for v in listed)


def _derivatives_are_ignored(fmu: FmuFile) -> bool:
    """Derivatives without directional derivatives mean nothing in an FMU for co-simulation alone."""
    return set(fmu.interfaces) == {"CoSimulation"} and not fmu.claims("providesDirectionalDerivative")


@rule("2.2.8", Stage.DESCRIPTION)
def structure_indices(fmu: FmuFile) -> Iterator[str]:
    """Each Unknown is the index of a variable, once in its section."""
    for unknown in _unknowns(fmu):
        if not unknown.variable.index:
            yield f"{unknown.where}: expected {fmu.key_words}"
    for where, count in repeated(unknown.where for unknown in _unknowns(fmu)).items():
        yield f"{where} is listed {count} times: expected once"


@rule("2.2.8", Stage.DESCRIPTION)
def outputs_are_listed(fmu: FmuFile) -> Iterator[str]:
    """Outputs lists exactly the variables of causality output."""
    expected = {v.index for v in fmu.variables if v.causality == "output"}
    return _difference(fmu, "Outputs", expected, expected)


@rule("2.2.8", Stage.DESCRIPTION)
def initial_unknowns_are_complete(fmu: FmuFile) -> Iterator[str]:
    """InitialUnknowns lists outputs, states and their derivatives with initial approx or calculated, and all
    calculated parameters; no others."""
    clocked = {v.index for v in fmu.variables if "clocks" in v.attributes}
    computed = {v.index for v in fmu.variables if v.initial in _COMPUTED} - clocked
    outputs = [v for v in fmu.variables if v.causality == "output"]
    expected = {v.index for v in fmu.variables if v.causality == "calculatedParameter"}
    expected |= {v.index for v in outputs} & computed
    of_states = (fmu.states | fmu.state_derivatives.keys()) & computed
    unclear = {v.index for v in outputs if not v.is_legal_pair} | clocked
    needed = expected if _derivatives_are_ignored(fmu) else expected | of_states
    return _difference(fmu, "InitialUnknowns", needed, expected | of_states | unclear)


def _difference(fmu: FmuFile, section: str, expected: set[int], allowed: set[int]) -> Iterator[str]:
    got = set(_indices(fmu, section))
    if expected - got:
        yield f"{fmu.section(section)} lacks {_listed(fmu, expected - got)}"
    if got - allowed:
        yield f"{fmu.section(section)} lists {_listed(fmu, got - allowed)}: expected it not to"


@rule("2.2.8", Stage.DESCRIPTION)
def derivatives_are_marked(fmu: FmuFile) -> Iterator[str]:
    """Variables that Derivatives lists have the attribute derivative, each of another state."""
    section = fmu.section("Derivatives")
    for index in _indices(fmu, "Derivatives"):
        if "derivative" not in fmu.variables[index - 1].typed:
            listed = _listed(fmu, {index})
            yield f"{section} lists {listed}: expected a variable with the attribute derivative"
    for state, count in repeated(fmu.state_derivatives.values()).items():
        yield f"{section} lists {count} derivatives of {_listed(fmu, {state})}: expected one"


@rule("2.2.8", Stage.DESCRIPTION)
def derivatives_are_there(fmu: FmuFile) -> Iterator[str]:
    """For model exchange there are Derivatives if a variable with initial exact has a derivative."""
    if "ModelExchange" in fmu.interfaces and not fmu.unknowns["Derivatives"]:
        for index, state in fmu.derivatives.items():
            is_state = state.causality in ("local", "output") and state.variability == "continuous"
            if is_state and state.initial == "exact":
                name = fmu.variables[index - 1].name
                section = fmu.section("Derivatives")
                yield f"no {section}: expected {name} there, the derivative of {state.name}"


def _unknown_dependencies(fmu: FmuFile) -> Iterator[tuple[Unknown, Variable]]:
    """Yields unknowns, each with a dependency that is not among its knowns."""
    states = _possible_states(fmu)
    for unknown in (unknown for name in _WITH_KNOWNS for unknown in fmu.unknowns[name]):
        for known in _knowns(unknown, fmu):
            is_given = known.initial == "exact" or known.causality == "parameter" or not known.is_legal_pair
            # a state of FMI 3.0 may be discrete
            is_state = known.index in states or (
                fmu.is_fmi3 and (known.variability == "discrete" or known.causality == "parameter")
            )
            is_known = is_given if unknown.is_initial else is_state
            if known.causality not in ("input", "independent") and not is_known:
                yield unknown, known


def _is_parameter(dependency: tuple[Unknown, Variable], _: FmuFile) -> bool:
    """Whether Outputs or Derivatives depend on a parameter."""
    unknown, known = dependency
    return not unknown.is_initial and known.causality in ("parameter", "calculatedParameter")


@lru_cache(maxsize=1)
def _possible_states(fmu: FmuFile) -> frozenset[int]:
    """States, and in an FMU that need not list Derivatives whatever another variable is the derivative of."""
    is_exchanged = "ModelExchange" in fmu.interfaces
    return fmu.states if is_exchanged else fmu.states | {v.index for v in fmu.derivatives.values()}


def _states_among(unknown: Unknown, fmu: FmuFile) -> str:
    known = [v.name for v in _knowns(unknown, fmu) if v.index in _possible_states(fmu)]
    return "" if unknown.is_initial else ", ".join(known)


def _no_index(unknown: Unknown, fmu: FmuFile) -> str:
    indices = [(text, integer(text)) for text in unknown.dependencies]
    others = [text for text, index in indices if index is not None and index not in fmu.by_key]
    return f"{', '.join(others)}: expected {fmu.key_words}" if others else ""


def _descent(indices: Sequence[int]) -> str:
    """Returns the first index after a greater one, with that."""
    return next((f"{b} follows {a}" for a, b in itertools.pairwise(indices) if b < a), "")


add_rows(__name__, Stage.DESCRIPTION, rows=(
    row("initial-unknowns-ascend", lambda fmu: [_indices(fmu, "InitialUnknowns")],
        (lambda indices, _: _descent(indices), "InitialUnknowns: {value}: expected ascending indices")),
    row("dependencies-are-indices", _unknowns,
        (_no_index, "{where}: dependency {value}"),
        (lambda unknown, _: ", ".join(repeated(unknown.dependencies)),
         "{where}: dependency {value} is listed several times: expected once")),
    row("dependencies-ascend", _unknowns,
        (lambda unknown, _: _descent([index for text in unknown.dependencies if (index := integer(text))]),
         "{where}: dependency {value}: expected ascending indices")),
    row("dependencies-are-known", _unknown_dependencies,
        (lambda d, _: d[0].is_initial, f"{_DEPENDS}: expected an input or what has initial exact"),
        (lambda d, fmu: _LATER_OF_FMI_3 if fmu.is_fmi3 else not _is_parameter(d, fmu) and _LATER,
         f"{_DEPENDS}: expected {{value}}")),
    row("dependencies-on-parameters",
        _unknown_dependencies, (_is_parameter, f"{_DEPENDS}: expected {_LATER}")),
    row("dependencies-on-states-are-provided",
        lambda fmu: _unknowns(fmu) if _derivatives_are_ignored(fmu) else (),
        (_states_among, "{where} depends on states ({value}): expected providesDirectionalDerivative")),
    row("dependencies-kind",
        lambda fmu: [unknown for unknown in _unknowns(fmu) if "dependenciesKind" in unknown.element.attrib],
        (lambda unknown, _: "dependencies" not in unknown.element.attrib,
         "{where} has dependenciesKind: expected dependencies too"),
        (lambda u, _: len(u.kinds) != len(u.dependencies) and (len(u.kinds), len(u.dependencies)),
         "{where}: {value[0]} kinds of dependency: expected {value[1]}, one each"),
        (lambda unknown, _: unknown.is_initial and ", ".join(sorted(_factors(unknown) - {"constant"})),
         "{where}: kind {value!r}: expected dependent or constant")),
    row("dependencies-of-reals-have-factors",
        lambda fmu: [u for u in _unknowns(fmu) if u.variable.base_kind not in ("Real", "")],
        (lambda unknown, _: ", ".join(sorted(_factors(unknown))),
         "{where} is {variable.kind} and has kind {value!r}: expected dependent")),
))  # fmt: skip

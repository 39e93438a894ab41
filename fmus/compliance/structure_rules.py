"""Rules of dependencies and lists of unknowns: FMI 2.0.5, 2.2.8 Definition of the Model Structure."""

import itertools
from collections.abc import Iterator

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rule import Stage, repeated, rule
from fmus.compliance.variable import integer

_CLAUSE = "2.2.8 Definition of the Model Structure (ModelStructure)"
_SECTIONS = ("Outputs", "Derivatives", "InitialUnknowns")
_KINDS = ("dependent", "constant", "fixed", "tunable", "discrete")


def _indices(fmu: FmuFile, section: str) -> list[int]:
    return [index for index, _ in fmu.unknowns(section) if index is not None]


def _listed(fmu: FmuFile, indices: set[int]) -> str:
    return ", ".join(f"{fmu.variables[index - 1].name} ({index})" for index in sorted(indices))


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
    yield from _difference(fmu, "Outputs", got, expected)


def _difference(fmu: FmuFile, section: str, got: set[int], expected: set[int]) -> Iterator[str]:
    if expected - got:
        yield f"{section} lacks {_listed(fmu, expected - got)}"
    if got - expected:
        yield f"{section} lists {_listed(fmu, got - expected)}: expected it not to"


@rule(_CLAUSE, Stage.DESCRIPTION)
def derivatives_are_marked(fmu: FmuFile) -> Iterator[str]:
    """What Derivatives lists has the attribute derivative."""
    marked = {v.index for v in fmu.variables if "derivative" in v.typed}
    yield from _difference(fmu, "Derivatives", set(_indices(fmu, "Derivatives")) - marked, set())


@rule(_CLAUSE, Stage.DESCRIPTION)
def initial_unknowns_are_complete(fmu: FmuFile) -> Iterator[str]:
    """InitialUnknowns lists calculated parameters; outputs and states with initial approx or calculated."""
    expected = {
        v.index
        for v in fmu.variables
        if v.causality == "calculatedParameter"
        or (v.causality == "output" and v.initial in ("approx", "calculated"))
    }
    for derivative in _indices(fmu, "Derivatives"):
        state = integer(fmu.variables[derivative - 1].typed.get("derivative"))
        for index in (derivative, state):
            if index is None or not 1 <= index <= len(fmu.variables):
                continue
            if fmu.variables[index - 1].initial in ("approx", "calculated"):
                expected.add(index)
    yield from _difference(fmu, "InitialUnknowns", set(_indices(fmu, "InitialUnknowns")), expected)


@rule(_CLAUSE, Stage.DESCRIPTION)
def initial_unknowns_ascend(fmu: FmuFile) -> Iterator[str]:
    """InitialUnknowns are in ascending order of their indices."""
    indices = _indices(fmu, "InitialUnknowns")
    for before, after in itertools.pairwise(indices):
        if after < before:
            yield f"InitialUnknowns: {after} follows {before}: expected ascending indices"


@rule(_CLAUSE, Stage.DESCRIPTION)
def dependencies_are_legal(fmu: FmuFile) -> Iterator[str]:
    """Dependencies are indices of other variables that are known: no output, no calculated parameter."""
    for section in _SECTIONS:
        for unknown, element in fmu.unknowns(section):
            listed = element.get("dependencies", "").split()
            where = f"{section}, unknown {element.get('index')}"
            for text in listed:
                yield from (f"{where}: {message}" for message in _illegal(fmu, unknown, text, section))
            for text, count in repeated(listed).items():
                yield f"{where}: dependency {text} is listed {count} times: expected once"


def _illegal(fmu: FmuFile, unknown: int | None, text: str, section: str) -> Iterator[str]:
    index = integer(text)
    if index is None or not 1 <= index <= len(fmu.variables):
        yield f"dependency {text}: expected 1..{len(fmu.variables)}"
        return
    known = fmu.variables[index - 1]
    if index == unknown:
        yield f"dependency {text} is the unknown itself: expected another variable"
    elif index in fmu.states or known.causality in ("input", "independent", "parameter"):
        return
    elif section != "InitialUnknowns" or known.initial != "exact":
        yield f"dependency {text} is {known.name} ({known.causality}): expected an input or what is given"


@rule(_CLAUSE, Stage.DESCRIPTION)
def dependencies_kind(fmu: FmuFile) -> Iterator[str]:
    """dependenciesKind has one legal word for each dependency; for initial unknowns dependent or constant."""
    for section in _SECTIONS:
        legal = _KINDS[:2] if section == "InitialUnknowns" else _KINDS
        for _, element in fmu.unknowns(section):
            kinds = element.get("dependenciesKind")
            if kinds is None:
                continue
            where, count = f"{section}, unknown {element.get('index')}", len(kinds.split())
            expected = len(element.get("dependencies", "").split())
            if count != expected:
                yield f"{where}: {count} kinds of dependency: expected {expected}, one each"
            for kind in sorted(set(kinds.split()) - set(legal)):
                yield f"{where}: kind {kind!r}: expected one of {', '.join(legal)}"

"""Rules of names: FMI 2.0.5, 2.2.9 Variable Naming Conventions (variableNamingConvention)."""

import itertools
import re
from collections.abc import Iterator

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rule import Level, Stage, repeated, rule

_CLAUSE = "2.2.9 Variable Naming Conventions (variableNamingConvention)"
LONGEST_NAME = 55

_ESCAPE = r"\\['\"?\\abfnrtv]"
_QUOTED = rf"'(?:[^'\\\x00-\x1f\x7f]|{_ESCAPE})+'"
_INDICES = r"\[[0-9]+(?:,[0-9]+)*\]"
_PART = rf"(?:[A-Za-z_][A-Za-z0-9_]*|{_QUOTED})(?:{_INDICES})?"
_IDENTIFIER = rf"{_PART}(?:\.{_PART})*"
_STRUCTURED = re.compile(rf"{_IDENTIFIER}|der\({_IDENTIFIER}(?:,[0-9]+)?\)")
_OUTSIDE_OF_Q_CHAR = re.compile(r"""[^A-Za-z0-9_!#$%&()*+,\-./:;<>=?@\[\]^{}|~ ]""")
_QUOTED_NAME, _QUOTED_ESCAPE = re.compile(_QUOTED), re.compile(_ESCAPE)
_DERIVATIVE = re.compile(r"^der\((.*)$")
_INDEXED = re.compile(rf"{_QUOTED}|({_INDICES})")


def is_structured(fmu: FmuFile) -> bool:
    return fmu.root.get("variableNamingConvention") == "structured"


def not_structured(fmu: FmuFile) -> str:
    """Why rules of structured names do not apply."""
    return "" if is_structured(fmu) else "variableNamingConvention is not structured"


@rule("2.2.7 Definition of Model Variables (ModelVariables), 2.2.9", Stage.DESCRIPTION)
def variable_names_are_unique(fmu: FmuFile) -> Iterator[str]:
    """No two variables have the same name."""
    for name, count in repeated(v.name for v in fmu.variables).items():
        yield f"{count} variables are called {name!r}: expected one"


@rule(_CLAUSE, Stage.DESCRIPTION)
def variable_names_are_legal(fmu: FmuFile) -> Iterator[str]:
    """Names are not empty and on one line; with the structured convention they follow its grammar."""
    for v in fmu.variables:
        if "name" not in v.attributes:
            continue
        if not v.name or re.search(r"[\r\n\t]", v.name):
            yield f"variable {v.index}, {v.name!r}: expected a name without tab or line break"
        elif is_structured(fmu) and not _STRUCTURED.fullmatch(v.name):
            yield f"{v.name!r}: expected a structured name such as tank.level[1] or der(x)"


@rule("2.2.1 Definition of an FMU (fmiModelDescription)", Stage.DESCRIPTION, condition=not_structured)
def type_names_are_legal(fmu: FmuFile) -> Iterator[str]:
    """With the structured convention, names of types follow its grammar too."""
    for element in fmu.root.iterfind("TypeDefinitions/SimpleType"):
        name = element.get("name", "")
        if not _STRUCTURED.fullmatch(name):
            yield f"type {name!r}: expected a structured name such as Units.Length"


@rule(_CLAUSE, Stage.DESCRIPTION, Level.WARNING, condition=not_structured)
def quoted_names_have_legal_characters(fmu: FmuFile) -> Iterator[str]:
    """Between apostrophes a name holds the characters of Q-char and escapes alone."""
    for v in fmu.variables:
        for part in _QUOTED_NAME.findall(v.name) if _STRUCTURED.fullmatch(v.name) else ():
            others = sorted(set(_OUTSIDE_OF_Q_CHAR.findall(_QUOTED_ESCAPE.sub("", part[1:-1]))))
            if others:
                yield f"{v.name}: {' '.join(others)} between apostrophes: expected a character of Q-char"


@rule("advice: Simulink cuts identifiers off beyond 63 characters", Stage.DESCRIPTION, Level.WARNING)
def variable_names_are_short(fmu: FmuFile) -> Iterator[str]:
    """Names have at most 55 characters, so that importers can put something before them."""
    for v in fmu.variables:
        if len(v.name) > LONGEST_NAME:
            yield f"{v.name} has {len(v.name)} characters: expected at most {LONGEST_NAME}"


def _elements(fmu: FmuFile) -> Iterator[tuple[int, str, str, tuple[int, ...]]]:
    """(position, array, array of the last part alone, if that has an index, indices) of elements."""
    for v in fmu.variables:
        spans = [match.span(1) for match in _INDEXED.finditer(v.name) if match.group(1)]
        if spans and _STRUCTURED.fullmatch(v.name):
            indices = tuple(int(text) for a, b in spans for text in v.name[a + 1 : b - 1].split(","))
            (a, b) = spans[-1]
            is_last = v.name[b:].rstrip(")").partition(",")[0] == ""
            of = _DERIVATIVE.sub(r"\1", v.name[:a]) if is_last else ""  # der(x[1]) may follow x[1]
            yield v.index, _INDEXED.sub(lambda m: "[]" if m.group(1) else m.group(), v.name), of, indices


@rule(_CLAUSE, Stage.DESCRIPTION, condition=not_structured)
def arrays_are_consecutive(fmu: FmuFile) -> Iterator[str]:
    """Elements of an array follow one another; only derivatives of elements may stand between them."""
    positions: dict[str, list[int]] = {}
    for position, _, own, _ in _elements(fmu):
        if own:
            positions.setdefault(own, []).append(position)
    for own, members in positions.items():
        for before, after in itertools.pairwise(members):
            if after != before + 1:
                between = fmu.variables[before].name
                yield f"{between} stands between elements of {own}[]: expected consecutive elements"
                break


@rule(_CLAUSE, Stage.DESCRIPTION, condition=not_structured)
def arrays_are_row_major(fmu: FmuFile) -> Iterator[str]:
    """Elements of an array are in row-major order: the last index runs fastest."""
    last: dict[str, tuple[tuple[int, ...], int]] = {}
    for position, array, _, indices in _elements(fmu):
        before, earlier = last.get(array, ((), 0))
        if before and indices < before:
            names = fmu.variables[position - 1].name, fmu.variables[earlier - 1].name
            yield f"{names[0]} comes after {names[1]}: expected the last index to run fastest"
        last[array] = (indices, position)

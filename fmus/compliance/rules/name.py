"""Rules of names: FMI 2.0.5, 2.2.9 Variable Naming Conventions (variableNamingConvention)."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rule import Stage, repeated, rule

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
_INDEXED = re.compile(rf"{_QUOTED}|({_INDICES})")


def is_structured(fmu: FmuFile) -> bool:
    return fmu.root.get("variableNamingConvention") == "structured"


def not_structured(fmu: FmuFile) -> str:
    """Returns the reason why rules of structured names do not apply."""
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
        if not v.attributes["name"] or re.search(r"[\r\n\t]", v.name):
            yield f"variable {v.index}, {v.name!r}: expected a name without tab or line break"
        elif is_structured(fmu) and not _STRUCTURED.fullmatch(v.name):
            yield f"{v.name!r}: expected a structured name such as tank.level[1] or der(x)"


@rule("2.2.1 Definition of an FMU (fmiModelDescription)", Stage.DESCRIPTION)
def type_names_are_legal(fmu: FmuFile) -> Iterator[str]:
    """Names of types are as those of variables: not empty, on one line, and structured if these are."""
    for element in fmu.root.iterfind("TypeDefinitions/SimpleType[@name]"):
        name = element.get("name")
        if not name or re.search(r"[\r\n\t]", name):
            yield f"type {name!r}: expected a name without tab or line break"
        elif is_structured(fmu) and not _STRUCTURED.fullmatch(name):
            yield f"type {name!r}: expected a structured name such as Units.Length"


@rule(_CLAUSE, Stage.DESCRIPTION, condition=not_structured)
def quoted_names_have_legal_characters(fmu: FmuFile) -> Iterator[str]:
    """Between apostrophes a name holds the characters of Q-char and escapes alone."""
    for v in fmu.variables:
        for part in _QUOTED_NAME.findall(v.name) if _STRUCTURED.fullmatch(v.name) else ():
            others = sorted(set(_OUTSIDE_OF_Q_CHAR.findall(_QUOTED_ESCAPE.sub("", part[1:-1]))))
            if others:
                yield f"{v.name}: {' '.join(others)} between apostrophes: expected a character of Q-char"


@rule("advice: Simulink cuts identifiers off beyond 63 characters", Stage.DESCRIPTION)
def variable_names_are_short(fmu: FmuFile) -> Iterator[str]:
    """Names have at most 55 characters, so that importers can put something before them."""
    for v in fmu.variables:
        if len(v.name) > LONGEST_NAME:
            yield f"{v.name} has {len(v.name)} characters: expected at most {LONGEST_NAME}"


@dataclass(frozen=True)
class _Element:
    """An element of an array, at a position of ModelVariables.

    every_level: its name with no index of any level. own: its name without the indices at its end, empty if
    there are none. of: the same of the variable that it is a derivative of.
    """

    position: int
    every_level: str
    own: str
    of: str
    indices: tuple[int, ...]


@lru_cache(maxsize=1)
def _elements(fmu: FmuFile) -> tuple[_Element, ...]:
    return tuple(_read_elements(fmu))


def _read_elements(fmu: FmuFile) -> Iterator[_Element]:
    for v in fmu.variables:
        if "[" not in v.name:
            continue
        spans = [match.span(1) for match in _INDEXED.finditer(v.name) if match.group(1)]
        if spans and _STRUCTURED.fullmatch(v.name):
            indices = tuple(int(text) for a, b in spans for text in v.name[a + 1 : b - 1].split(","))
            every_level = _INDEXED.sub(lambda match: "[]" if match.group(1) else match.group(), v.name)
            before, after = v.name[: spans[-1][0]], v.name[spans[-1][1] :]
            is_at_end = after == "" or re.fullmatch(r"(,\d+)?\)", after) is not None
            own = f"{before}[]{after}" if is_at_end else ""
            yield _Element(v.index, every_level, own, before.removeprefix("der(") if own else "", indices)


@rule(_CLAUSE, Stage.DESCRIPTION, condition=not_structured)
def arrays_are_consecutive(fmu: FmuFile) -> Iterator[str]:
    """Elements of an array follow one another; only derivatives of elements may stand between them."""
    elements = {element.position: element for element in _elements(fmu)}
    last: dict[str, int] = {}
    for position, element in elements.items():
        between = range(last.get(element.own, position), position)[1:]
        others = [i for i in between if i not in elements or elements[i].of != element.of]
        if element.own and others:
            name = fmu.variables[others[0] - 1].name
            yield f"{name} stands between elements of {element.own}: expected consecutive elements"
        last[element.own] = position


@rule(_CLAUSE, Stage.DESCRIPTION, condition=not_structured)
def arrays_are_row_major(fmu: FmuFile) -> Iterator[str]:
    """Elements of an array are in row-major order: the last index runs fastest."""
    last: dict[str, tuple[tuple[int, ...], int]] = {}
    for element in _elements(fmu):
        before, earlier = last.get(element.every_level, ((), 0))
        if element.indices < before:
            names = [fmu.variables[position - 1].name for position in (element.position, earlier)]
            yield f"{names[0]} comes after {names[1]}: expected the last index to run fastest"
        last[element.every_level] = (element.indices, element.position)

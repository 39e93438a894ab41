"""Rules of variables: names, causality, start values, derivatives, alias sets. FMI 2.0.5, 2.2.7 and 2.2.9."""

import math
import re
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rows import add_rows, anything, elements, row
from fmus.compliance.rule import Stage, repeated, rule
from fmus.compliance.variable import INITIAL, Variable, integer, is_true, number

_ESCAPE = r"\\['\"?\\abfnrtv]"
_QUOTED = rf"'(?:[^'\\\x00-\x1f\x7f]|{_ESCAPE})+'"
_INDICES = r"\[[0-9]+(?:,[0-9]+)*\]"
_PART = rf"(?:[A-Za-z_][A-Za-z0-9_]*|{_QUOTED})(?:{_INDICES})?"
_IDENTIFIER = rf"{_PART}(?:\.{_PART})*"
_STRUCTURED = re.compile(rf"{_IDENTIFIER}|der\({_IDENTIFIER}(?:,[0-9]+)?\)")
_OUTSIDE_OF_Q_CHAR = re.compile(r"""[^A-Za-z0-9_!#$%&()*+,\-./:;<>=?@\[\]^{}|~ ]""")
_QUOTED_NAME, _QUOTED_ESCAPE = re.compile(_QUOTED), re.compile(_ESCAPE)
_INDEXED = re.compile(rf"{_QUOTED}|({_INDICES})")
_ELEMENT = re.compile(rf"(der\()?(.+){_INDICES}((?:,\d+)?\)?)")
_VALUES = {"Boolean": is_true, "Real": number, "Integer": integer}
_BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd")
_ROUNDED = 1e-6  # relative: tools write factors with as few as seven digits
_ALIASES = "ModelVariables/*/Alias/@name"
_NO_LINE = re.compile(r"|.*[\r\n\t].*", re.DOTALL)  # no name by any convention


def _not_structured(fmu: FmuFile) -> str:
    """Returns the reason why rules of structured names do not apply."""
    is_structured = fmu.root.get("variableNamingConvention") == "structured"
    return "" if is_structured else "variableNamingConvention is not structured"


def _breaks_grammar(name: str, fmu: FmuFile) -> bool:
    return not _not_structured(fmu) and not _STRUCTURED.fullmatch(name)


def _structured_names(fmu: FmuFile) -> list[str]:
    """Returns the names that follow the grammar; none where the convention is flat."""
    return [] if _not_structured(fmu) else [v.name for v in fmu.variables if _STRUCTURED.fullmatch(v.name)]


def _outside_of_q_char(name: str, _: FmuFile) -> str:
    texts = "".join(_QUOTED_ESCAPE.sub("", part[1:-1]) for part in _QUOTED_NAME.findall(name))
    return " ".join(sorted(set(_OUTSIDE_OF_Q_CHAR.findall(texts))))


@rule("2.2.9", Stage.DESCRIPTION, condition=_not_structured)
def arrays_are_consecutive(fmu: FmuFile) -> Iterator[str]:
    """Elements of an array follow one another, with the derivatives of elements alone between them, in
    row-major order: the last index runs fastest.
    """
    matches = [_STRUCTURED.fullmatch(v.name) and _ELEMENT.fullmatch(v.name) for v in fmu.variables]
    last: dict[tuple[str | None, ...], int] = {}
    greatest: dict[str, tuple[list[int], str]] = {}
    for i, (v, match) in enumerate(zip(fmu.variables, matches, strict=True)):
        if match:
            before, array, after = match.groups("")
            between = range(last.get(match.groups(), i), i)[1:]
            others = [j for j in between if not ((other := matches[j]) and other[2] == array)]
            if others:
                name, elements = fmu.variables[others[0]].name, f"{before}{array}[]{after}"
                yield f"{name} stands between elements of {elements}: expected consecutive elements"
            last[match.groups()] = i
        if _STRUCTURED.fullmatch(v.name):
            # arrays of arrays have indices on each level
            array = _INDEXED.sub(lambda match: "[]" if match[1] else match[0], v.name)
            indices = [int(index) for text in _INDEXED.findall(v.name) for index in re.findall(r"\d+", text)]
            least, other_name = greatest.get(array, (indices, v.name))
            if indices < least:
                yield f"{v.name} comes after {other_name}: expected the last index to run fastest"
            greatest[array] = indices, v.name


def _needs_start(v: Variable) -> bool:
    return v.kind != "Clock" and (v.causality == "input" or v.initial in ("exact", "approx"))


def _independent(fmu: FmuFile) -> list[Variable]:
    return [v for v in fmu.variables if v.causality == "independent"]


def _is_for_co_simulation(_: Variable, fmu: FmuFile) -> bool:
    """Whether an FMU of FMI 2.0 is for co-simulation alone."""
    return not fmu.is_fmi3 and "ModelExchange" not in fmu.interfaces


def _unlike(expected: str, attribute: str, v: Variable, fmu: FmuFile) -> str:
    """Returns what a derivative is of, and which of the two has another attribute than expected."""
    of = fmu.derivatives[v.index]
    others = {x.name: getattr(x, attribute) for x in (v, of) if getattr(x, attribute) != expected}
    listed = ", ".join(f"{name} ({other})" for name, other in others.items())
    return f"derivative of {of.name}: {listed}: expected {expected}" if others else ""


def _base(unit: Any) -> tuple[dict[str, float], float] | None:
    """Returns the exponents of base units but rad, and the factor; None for what has none."""
    base = None if unit is None else unit.find("BaseUnit")
    if base is None:
        return None
    exponents = {name: number(base.get(name, "0")) or 0.0 for name in _BASE_UNITS}
    return exponents, number(base.get("factor", "1")) or 0.0


def _unit_of_a_derivative(v: Variable, fmu: FmuFile) -> str:
    """Returns the wrong unit of a derivative and the expected one: the unit of its variable per second."""
    of = fmu.derivatives[v.index]
    got, base = (_base(fmu.units.get(x.get("unit") or "")) for x in (v, of))
    if got is None or base is None:
        return ""
    exponents, factor = base
    exponents["s"] -= 1
    if got[0] == exponents and math.isclose(got[1], factor, rel_tol=_ROUNDED):
        return ""
    return f"{v.get('unit')}: expected the unit of {of.name}, {of.get('unit')}, per second"


class _AliasSet(NamedTuple):
    """Variables of one base type with one value reference."""

    members: list[Variable]

    @property
    def names(self) -> str:
        names = ", ".join(v.name for v in self.members)
        return f"{names} (value reference {self.members[0].reference})"


def _alias_sets(fmu: FmuFile) -> Iterator[_AliasSet]:
    return (_AliasSet(members) for members in fmu.aliases.values() if len(members) > 1)


def _set_twice(fmu: FmuFile) -> Iterator[_AliasSet]:
    """Yields the variables of alias sets that can be set or are independent, where there are several."""
    for alias in _alias_sets(fmu):
        chosen = [v for v in alias.members if v.is_settable or v.causality == "independent"]
        if len(chosen) > 1:
            yield _AliasSet(chosen)


def _constants(alias: _AliasSet) -> list[Variable]:
    return [v for v in alias.members if v.variability == "constant"]


def _several(values: Iterable[object]) -> str:
    """Returns the values, if they are not all the same."""
    texts = {"none" if value is None else str(value) for value in values}
    return ", ".join(sorted(texts)) if len(texts) > 1 else ""


add_rows(__name__, Stage.DESCRIPTION, rows=(
    row("variable-names-are-unique",
        lambda fmu: repeated([*(v.name for v in fmu.variables), *fmu.root.xpath(_ALIASES)]).items(),
        (anything, "{subject[1]} variables are called {subject[0]!r}: expected one")),
    row("variable-names-are-legal", lambda fmu: [v for v in fmu.variables if "name" in v.attributes],
        (lambda v, _: _NO_LINE.fullmatch(v.attributes["name"]),
         "variable {index}, {name!r}: expected a name without tab or line break"),
        (lambda v, fmu: _breaks_grammar(v.name, fmu),
         "{name!r}: expected a structured name such as tank.level[1] or der(x)")),
    row("type-names-are-legal", elements("TypeDefinitions/SimpleType[@name]"),
        (lambda element, _: _NO_LINE.fullmatch(element.get("name")),
         "type {name!r}: expected a name without tab or line break"),
        (lambda element, fmu: _breaks_grammar(element.get("name"), fmu),
         "type {name!r}: expected a structured name such as Units.Length")),
    row("quoted-names-have-legal-characters", _structured_names,
        (_outside_of_q_char, "{subject}: {value} between apostrophes: expected a character of Q-char")),
    row("causality-and-variability", lambda fmu: [v for v in fmu.variables if not v.is_legal_pair],
        (lambda v, _: " or ".join(legal for causality, legal in INITIAL[v.fmi] if causality == v.causality),
         "{name}: causality {causality} with variability {variability}: expected {value}")),
    row("continuous-is-real",
        lambda fmu: [v for v in fmu.variables if v.variability == "continuous" and v.is_legal_pair],
        (lambda v, _: v.base_kind not in ("Real", "") and v.causality != "independent" and
         ("stated" if "variability" in v.attributes else "the default"),
         "{name} is {kind} and continuous ({value}): expected another variability")),
    row("initial-is-legal",
        lambda fmu: [v for v in fmu.variables if v.is_legal_pair and "initial" in v.attributes],
        (lambda v, _: v.initial != v.attributes["initial"] and (" or ".join(v.legal_initial or ()) or "none"),
         "{name} ({causality}, {variability}): initial {attributes[initial]}: expected {value}")),
    row("start-is-given", lambda fmu: [v for v in fmu.variables if v.kind and v.is_legal_pair],
        (lambda v, _: _needs_start(v) and v.start is None and (v.initial or "none"),
         "{name} ({causality}, {variability}, initial {value}): expected a start value"),
        (lambda v, _: not _needs_start(v) and v.start is not None and (v.initial or "none"),
         "{name} ({causality}, {variability}, initial {value}) has start {start!r}: expected none")),
    row("one-independent-variable", _independent,
        (lambda _, fmu: len(_independent(fmu)) > 1 and ", ".join(v.name for v in _independent(fmu)),
         "{value} are independent: expected one at most"),
        (lambda v, _: v.base_kind not in ("Real", "") and ("Float64" if v.fmi == 3 else "Real"),
         "{name} is independent and {kind}: expected {value}")),
    row("time-is-independent", lambda fmu: [v for v in fmu.variables if v.name == "time"],
        (lambda _, fmu: not _independent(fmu),
         "time is {causality} and no variable is independent: expected another name")),
    row("set-once-is-of-inputs",
        lambda fmu: [v for v in fmu.variables if "canHandleMultipleSetPerTimeInstant" in v.attributes],
        (_is_for_co_simulation,
         "{name} has canHandleMultipleSetPerTimeInstant: expected none without ModelExchange"),
        (lambda v, _: v.causality != "input",
         "{name} ({causality}) has canHandleMultipleSetPerTimeInstant: expected an input")),
    row("reinit-is-of-states", lambda fmu: [v for v in fmu.variables if "reinit" in v.typed],
        (_is_for_co_simulation, "{name} has reinit: expected none without ModelExchange"),
        (lambda v, fmu: v.index not in fmu.states, "{name} has reinit: expected a continuous-time state")),
    row("derivative-is-of-a-variable", lambda fmu: [v for v in fmu.variables if "derivative" in v.typed],
        (lambda v, fmu: v.index not in fmu.derivatives,
         "{name}: derivative {typed[derivative]}: expected another variable"),
        (lambda v, fmu: _unlike("Real", "base_kind", v, fmu), "{name}, {value}"),
        (lambda v, fmu: v.index in fmu.state_derivatives and _unlike("continuous", "variability", v, fmu),
         "{name}, {value}")),
    row("derivative-units", lambda fmu: [v for v in fmu.variables if v.index in fmu.derivatives],
        (_unit_of_a_derivative, "{name} has the unit {value}")),
    row("states-are-local-or-outputs", lambda fmu: [fmu.variables[index - 1] for index in sorted(fmu.states)],
        (lambda v, _: v.causality not in ("local", "output"),
         "{name} is a continuous-time state and {causality}: expected local or output")),
    row("alias-units", _alias_sets,
        (lambda alias, _: _several(v.get("unit") for v in alias.members if v.get("unit")),
         "{names}: expected one unit, got {value}")),
    row("alias-units-are-complete", _alias_sets,
        (lambda alias, _: len({v.get("unit") for v in alias.members} - {None}) == 1
         and _several(v.get("unit") for v in alias.members),
         "{names}: expected the unit for all or for none, got {value}")),
    row("alias-settable-once", _set_twice,
        (anything, "{names}: expected at most one that can be set or is independent")),
    row("alias-constants", lambda fmu: [alias for alias in _alias_sets(fmu) if _constants(alias)],
        (lambda alias, _: len(_constants(alias)) < len(alias.members) and len(_constants(alias)),
         "{names}: expected all constant or none, got {value} constant"),
        (lambda alias, _: _several(_VALUES.get(v.base_kind, str)(v.start) for v in alias.members),
         "{names} are constant: expected one start value, got {value}")),
))  # fmt: skip

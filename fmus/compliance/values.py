"""Values of variables for the rules: start values, other legal ones, which can be set; how two compare."""

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import Condition
from fmus.compliance.script import Expected, Reading
from fmus.compliance.texts import without_folders
from fmus.compliance.variable import Variable, is_integer_of_fmi

SAVES, SERIALISES = "canGetAndSetFMUstate", "canSerializeFMUstate"
ANY_STEP, INTERPOLATES = "canHandleVariableCommunicationStepSize", "canInterpolateInputs"
_LARGEST_REFERENCE = 2**32 - 1
_LONG_TEXT = "Tiefe ä, \N{GREEK SMALL LETTER PI}, \N{GRINNING FACE}; " * 20
_TINY = 1e-6  # beside a start value


def unless_claimed(capability: str) -> Condition:
    """Returns the condition of rules about a capability."""
    return lambda fmu: "" if fmu.claims(capability) else f"{capability} is not claimed"


def if_not_claimed(flag: str) -> Condition:
    """Returns the condition of rules that a flag takes back."""
    return lambda fmu: f"{flag} is claimed" if fmu.claims(flag) else ""


def start_values(variables: Iterable[Variable]) -> list[tuple[Variable, Any]]:
    """Returns each variable that has a start value, with that value."""
    return [(v, x) for v in variables if (x := v.start_value) is not None]


def far_values(v: Variable) -> list[Any]:
    """Returns legal values far from the start value: Reals three times as large or the limits, texts.

    A parameter keeps its sign unless its limits allow the other one: a negative period, for example, means
    nothing.
    """
    start = v.start_value
    if start is None:
        return []
    if v.base_kind == "String":
        return ["", _LONG_TEXT]
    if v.base_kind == "Integer":
        limits = {int(x) for x in (v.number("min"), v.number("max")) if x is not None}
        return sorted(x for x in (v.items or limits) - {start} if is_integer_of_fmi(x))
    if v.base_kind == "Boolean":
        return [1 - start]
    width = 3 * (abs(start) or v.nominal or 1.0)
    values = [min(start + width, v.high), max(start - width, v.low)]
    # some tools state a limit such as 1e-60 for "above 0"
    values = [x for x in values if x == 0.0 or abs(x) > _TINY * abs(start)]
    meant = [x for x in values if v.causality == "input" or x * start >= 0.0 or x in (v.low, v.high)]
    return [x for x in (v.held(x) for x in meant) if v.allows(x) and x != start]


def read_value(value: Any) -> Any:
    """Returns a value that was read, as it is set: Strings as text; None for NULL."""
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def keeps_its_value(v: Variable) -> bool:
    """Whether initialization leaves what was set: an event may change an output or a state."""
    return v.causality in ("parameter", "input")


def continuous_reals(probe: Probe, causality: str) -> list[Variable]:
    kind = causality, "Real", "continuous"
    return [v for v in probe.fmu.variables if (v.causality, v.kind, v.variability) == kind]


def references_of(variables: Iterable[Variable]) -> list[int]:
    return [v.reference or 0 for v in variables]


def unknown_reference(fmu: FmuFile) -> int:
    """Returns a value reference far from the variables': some without an entry may lie between."""
    used = {v.reference or 0 for v in fmu.variables} | {of.reference for of in fmu.elements or ()}
    far = max(used, default=0) + 1000
    return far if far <= _LARGEST_REFERENCE else next(i for i in itertools.count() if i not in used)


def other_values(variables: Iterable[Variable]) -> list[tuple[Variable, Any]]:
    """Returns each variable that has another legal value, with that value."""
    return [(v, x) for v in variables if (x := v.other_value) is not None]


_LARGE = 1e-5  # relative: a larger tolerance is relative to the variable itself
RESTARTED = 1e-2  # relative: a solver that begins anew at an event may change values as much
_SMALL = 0.01  # of the largest variable: smaller ones are compared at that size
_LONGEST_TEXT = 60  # characters of a value


def texts(*values: Any) -> list[str]:
    """Returns numbers with the fewest digits that show their difference, at least six."""
    if not all(isinstance(value, (int, float)) for value in values):
        return [repr(value) for value in values]
    for digits in (6, 9, 12, 15):
        shown = [f"{value:.{digits}g}" for value in values]
        if len(set(shown)) == len({repr(value) for value in values}):
            return shown
    return [repr(value) for value in values]


def same(a: Any, b: Any, tolerance: float = 0.0, scale: float = 0.0) -> bool:
    """Whether two values are equal; numbers up to a tolerance relative to the larger and the scale."""
    if a == b:
        return True
    if not isinstance(a, float) or not isinstance(b, (int, float)):
        return False
    if math.isnan(a) and math.isnan(b):
        return True
    return abs(a - b) <= tolerance * max(abs(a), abs(b), scale)


class Difference(NamedTuple):
    """A value that is not as expected, as text and as data; scale as in `same`."""

    text: str
    name: str
    expected: Expected
    got: Reading
    scale: float


def differing(
    expected: Sequence[Expected], got: Iterable[Reading], when: str, tolerance: float = 0.0,
    again: str = "{} again", where: Sequence[str] = (),
) -> Iterator[Difference]:  # fmt: skip
    """Yields each variable's first value that is not the same; a tolerance is relative to the variable's
    largest, or to its nominal value, but at most to the largest of all, or for a large tolerance to a
    hundredth of it; to the value itself where it is given.

    again: template of the expected value; where: words for each reading, by default its number
    """
    compared = list(zip(expected, got, strict=True))
    if all(reading.equals(source) for source, reading in compared):
        return
    # one reading is often expected again and again
    sources = {id(source): source for source, _ in compared}
    rows = {key: source if isinstance(source, dict) else source.values for key, source in sources.items()}
    pairs = [(rows[id(source)], reading, source, reading.values) for source, reading in compared]
    if all(other.items() <= row.items() for row, _, _, other in pairs):
        return
    scales, nominals = dict[str, float](), dict[str, float]()
    for key, source in sources.items():
        if isinstance(source, Reading):
            nominals |= {v.name: v.nominal for group in source.groups.values() for v in group}
            for name, value in rows[key].items():
                if isinstance(value, float) and math.isfinite(value):
                    scales[name] = max(abs(value), scales.get(name, 0.0))
    most = (_SMALL if tolerance >= _LARGE else 1.0) * max(scales.values(), default=0.0)
    named = set()
    for i, (row, reading, source, other) in enumerate(pairs):
        for name, value in other.items():
            value_read, value_expected = read_value(value), read_value(row[name])
            scale = max(scales.get(name, 0.0), min(nominals.get(name, 0.0), most))
            if name not in named and not same(value_expected, value_read, tolerance, scale):
                named.add(name)
                both = map(without_folders, texts(value_read, value_expected))
                new, old = (text[:_LONGEST_TEXT] for text in both)
                place = where[i] if where else f", step {i + 1}" if len(pairs) > 1 else ""
                text = f"{name} is {new} {when}{place}: expected {again.format(old)}"
                yield Difference(text, name, source, reading, 0.0 if isinstance(source, dict) else scale)

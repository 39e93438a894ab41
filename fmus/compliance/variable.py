"""A variable of the XML, with the defaults of FMI 2.0.5, 2.2.7, or of FMI 3.0.2, 2.4.7.4.

Wrong attributes raise no error.
"""

import math
import struct
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from typing import Any

from fmus.fmi.variable_types import TRANSFER_TYPE

_TABLE = resources.files("fmus.compliance") / "sentences" / "initial.toml"
_PAIRS = tomllib.loads(_TABLE.read_text(encoding="utf-8"))
# version of FMI -> (causality, variability) -> values that `initial` may have, the default first
INITIAL = {
    fmi: {
        tuple(pair.split()): tuple(values.split())
        for pair, values in (_PAIRS["both"] | _PAIRS[f"fmi{fmi}"]).items()
    }
    for fmi in (2, 3)
}

_TRUE = {"true": 1, "1": 1, "false": 0, "0": 0}
_PART = 0.01  # of a value or its nominal value: a change that is felt, and seldom refused


# each stands for one element: identity is quicker to compare than all attributes
@dataclass(frozen=True, eq=False)
class Variable:
    """A variable, of FMI 2.0 unless it is a `Variable3`.

    index: place in the list from 1, as ModelStructure of FMI 2.0 counts; items: values of its enumeration
    element: of the XML, in FMI 3.0
    """

    index: int
    attributes: Mapping[str, str]
    kind: str
    typed: Mapping[str, str]
    declared: Mapping[str, str]
    items: frozenset[int] = frozenset()
    element: Any = None
    fmi = 2

    @cached_property
    def name(self) -> str:
        return self.attributes.get("name") or f"<variable {self.index} without a name>"

    @property
    def legal_initial(self) -> tuple[str, ...] | None:
        """Legal values of `initial`, the default first; None if `is_legal_pair` is false."""
        return INITIAL[self.fmi].get((self.causality, self.variability))

    @property
    def is_legal_pair(self) -> bool:
        """Whether causality and variability are a pair that FMI allows."""
        return self.legal_initial is not None

    @cached_property
    def causality(self) -> str:
        return self.attributes.get("causality", "local")

    @cached_property
    def variability(self) -> str:
        return self.attributes.get("variability", "continuous")

    @cached_property
    def initial(self) -> str:
        """Attribute initial as stated, if that is legal, else the default, or ""."""
        stated, legal = self.attributes.get("initial", ""), self.legal_initial
        return stated if legal is None or stated in legal else next(iter(legal), "")

    @cached_property
    def reference(self) -> int | None:
        """The value reference, if it is a number that FMI can hold."""
        value = integer(self.attributes.get("valueReference"))
        return value if value is not None and 0 <= value < 2**32 else None

    @cached_property
    def base_kind(self) -> str:
        """The type of the getter: an Enumeration is read as an Integer."""
        return TRANSFER_TYPE.get(self.kind, self.kind)

    def get(self, attribute: str) -> str | None:
        """Returns an attribute of the type element, or else of its declared type (2.2.3)."""
        return self.typed.get(attribute, self.declared.get(attribute))

    def number(self, attribute: str) -> float | None:
        return number(self.get(attribute))

    def _number(self, attribute: str, default: float) -> float:
        stated = self.number(attribute)
        return default if stated is None else stated

    @cached_property
    def low(self) -> float:
        """The attribute min; -inf without one."""
        return self._number("min", -math.inf)

    @cached_property
    def high(self) -> float:
        """The attribute max; inf without one."""
        return self._number("max", math.inf)

    @cached_property
    def nominal(self) -> float:
        """The attribute nominal; 1.0 without one."""
        return self._number("nominal", 1.0)

    @property
    def start(self) -> str | None:
        return self.typed.get("start")

    @property
    def starts(self) -> list[str]:
        """The start values: one for each element of an array, or one for all."""
        return [] if self.start is None else [self.start]

    @cached_property
    def start_value(self) -> Any:
        """The start value as the setter takes it; None if it is missing or cannot be parsed."""
        text = self.start
        if text is None or self.base_kind == "String":
            return text
        if self.base_kind == "Boolean":
            return _TRUE.get(text.strip())
        value = self.number("start") if self.typed.get("start") == text else None
        if value is None or self.base_kind != "Integer":
            return value if value is None else self.held(value)
        return int(value) if is_integer_of_fmi(value) else None

    @property
    def is_single(self) -> bool:
        """Whether FMI 3.0 transfers it in single precision."""
        return self.typed.get("single") == "true"

    def held(self, value: float) -> float:
        """Returns a value as FMI 3.0 transfers it: in single or double precision."""
        return struct.unpack("f", struct.pack("f", value))[0] if self.is_single else value

    def allows(self, value: float) -> bool:
        """Whether a number is in its range, and an item of its enumeration."""
        is_legal = self.base_kind != "Integer" or is_integer_of_fmi(value)
        return is_legal and self.low <= value <= self.high and (not self.items or value in self.items)

    @cached_property
    def other_value(self) -> Any:
        """Another legal value near the start value, or None."""
        start = self.start_value
        if start is None:
            return None
        if self.base_kind == "String":
            return f"x{start}x"
        if self.base_kind == "Boolean":
            return 1 - start
        near = sorted(self.items, key=lambda x: abs(x - start)) or [start + 1, start - 1]
        if self.base_kind == "Real":
            change = _PART * max(abs(start), self.nominal or 1.0)
            change = min([change, *(abs(x - start) / 2 for x in (self.low, self.high) if x != start)])
            near = map(self.held, (start + change, start - change))
        return next((x for x in near if x != start and self.allows(x)), None)

    @property
    def is_settable(self) -> bool:
        """Can be set by fmi2SetXXX before or in initialization mode."""
        return self.causality == "input" or (
            self.variability != "constant" and self.initial in ("exact", "approx")
        )


_PARAMETERS = ("parameter", "calculatedParameter", "structuralParameter")


@dataclass(frozen=True, eq=False)
class Variable3(Variable):
    """A variable of FMI 3.0, perhaps an array."""

    fmi = 3

    @cached_property
    def variability(self) -> str:
        is_real = self.base_kind == "Real"
        default = "fixed" if self.causality in _PARAMETERS else "continuous" if is_real else "discrete"
        return self.attributes.get("variability", default)

    @property
    def legal_initial(self) -> tuple[str, ...] | None:
        # a Clock has no attribute initial
        return () if self.kind == "Clock" else super().legal_initial

    @cached_property
    def base_kind(self) -> str:
        """The type of FMI 2.0 that is like it."""
        return "Real" if self.kind.startswith("Float") else "Integer" if "Int" in self.kind else self.kind

    @property
    def start(self) -> str | None:
        return next(iter(self.starts), None)

    @property
    def starts(self) -> list[str]:
        values = [start.get("value", "") for start in self.element.iterfind("Start")]
        text = self.typed.get("start", "")
        # the schema has no such attribute of a String: `schema` alone reports it
        return values or ([text] if text and self.kind == "String" else text.split())

    def references(self, attribute: str) -> list[int | None]:
        """Returns the value references in an attribute."""
        return [integer(text) for text in self.attributes.get(attribute, "").split()]


_NONE = Variable(0, {}, "", {}, {})


@dataclass(frozen=True)
class Unknown:
    """An Unknown of a section of ModelStructure.

    indices: its dependencies as numbers; variable: with index 0 if no variable has its index
    """

    section: str
    element: Any
    indices: frozenset[int | None] = frozenset()
    variable: Variable = _NONE

    @property
    def dependencies(self) -> list[str]:
        return self.element.get("dependencies", "").split()

    @property
    def kinds(self) -> list[str]:
        return self.element.get("dependenciesKind", "").split()

    @property
    def is_initial(self) -> bool:
        return self.section.startswith("InitialUnknown")

    @property
    def where(self) -> str:
        index, reference = self.element.get("index"), self.element.get("valueReference")
        if self.variable.index:
            return f"{self.section}, unknown {self.variable.name} ({index or reference})"
        return f"{self.section}, index {index}" if index else f"{self.section}, value reference {reference}"

    def depends_on(self, known: Variable) -> bool:
        """Whether it lists a known, or lists nothing, which means all."""
        return "dependencies" not in self.element.attrib or known.index in self.indices


def number(text: str | None) -> float | None:
    """Returns a finite number, or None for other text, which the schema reports."""
    try:
        value = float(text) if text is not None else math.nan
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def integer(text: str | None) -> int | None:
    """Returns a whole number in decimal digits, or None for other text."""
    try:
        return int(text) if text is not None else None
    except ValueError:
        return None


def is_integer_of_fmi(value: float) -> bool:
    return -(2**31) <= value < 2**31


def is_true(text: str | None) -> bool:
    """Whether a Boolean attribute is true; blanks around it do not count."""
    return (text or "").strip() in ("true", "1")

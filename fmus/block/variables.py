"""Variables of a block: how they are declared, and the scalars of its interface that follow."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import Field, dataclass, field, fields, is_dataclass, make_dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import Any, Literal, TypeVar

from fmus.block.scalars import members
from fmus.block.units import per_second
from fmus.errors import range_text

Value = float | int | bool
Numbers = float | tuple["Numbers", ...]
Texts = str | None | tuple["Texts", ...]
Start = TypeVar("Start")


def variable(
    start: Start,
    description: str,
    *,
    unit: Texts = "1",
    display_unit: Texts = None,
    min: Numbers | None = None,
    max: Numbers | None = None,
    nominal: Numbers | None = None,
    variability: Literal["fixed", "tunable", "discrete"] | None = None,
    source: str = "",
) -> Start:
    """Declares one variable of a block.

    Parameters
    ----------
    start : float, int, bool, IntEnum member, or tuple of these
        Start value and type. A tuple declares a vector `name[1], name[2]`, a tuple of tuples a matrix
        `name[1,1]`, row by row.
    description : str
        Meaning of the variable, one line.
    unit : str or tuple of str
        Unit of `fmus.block.units`, such as "m", "N.s/m", "deg", "rev/min" or "degC"; "1" for a number.
    display_unit : str or tuple of str, optional
        Unit in which tools may show the value, such as "deg" for the unit "rad".
    min, max, nominal : number or tuple of the shape of `start`, optional
        Range and magnitude, in `unit`.
    variability : {"fixed", "tunable", "discrete"}, optional
        "fixed" or "tunable" for a parameter; "discrete" for a Real input or output that changes at events
        alone. By default class and type decide.
    source : str
        Origin of a number: published, estimate or guess.

    Returns
    -------
    field
        Default of a dataclass field, which is declared with the type of `start`.

    Raises
    ------
    TypeError
        If `start` is a list.

    Examples
    --------
    >>> @dataclass(frozen=True)
    ... class Parameters:
    ...     mass: float = variable(5.5, "Mass", unit="kg", min=0.1)
    >>> Parameters().mass
    5.5
    """
    start = plain(start)
    # A dataclass refuses a list, too, with a message about its own functions.
    if isinstance(start, list):
        raise TypeError(f"start {start!r}: expected a tuple")
    ranges = {"minimum": plain(min), "maximum": plain(max), "nominal": plain(nominal)}
    texts = {"description": description, "source": source}
    units = {"unit": unit, "display_unit": display_unit}
    metadata = {"units": units, "variability": variability, "ranges": ranges, "texts": texts}
    return field(default=start, metadata=metadata)


def plain(value: Any) -> Any:
    """Returns a value with Python's numbers in place of NumPy's, and a list in place of an array."""
    if isinstance(value, tuple):
        return tuple(map(plain, value))
    return value.tolist() if hasattr(value, "tolist") else value


def restarted(cls: type, starts: Mapping[str, Any], sources: Mapping[str, str] = {}) -> type:
    """Returns a class of the same variables with other start values, and with sources of these."""
    members = []
    for declared in (declared for declared in fields(cls) if declared.name in starts):
        name, texts = declared.name, declared.metadata["texts"]
        source = {"source": sources.get(name, texts["source"])}
        metadata = {**declared.metadata, "texts": texts | source}
        members.append((name, declared.type, field(default=plain(starts[name]), metadata=metadata)))
    return make_dataclass(cls.__name__, members, bases=(cls,), frozen=True) if members else cls


@dataclass(frozen=True)
class BlockVariable:
    """One scalar of a block's interface, in the terms of FMI 2.0 (2.2.7)."""

    name: str
    value_reference: int
    causality: str
    variability: str
    initial: str | None
    start: Value
    description: str
    unit: str | None
    display_unit: str | None
    minimum: Value | None
    maximum: Value | None
    nominal: float | None
    source: str
    enumeration: type[IntEnum] | None

    @cached_property
    def type(self) -> str:
        """FMI type: Real, Integer, Boolean or Enumeration."""
        if self.enumeration:
            return "Enumeration"
        return {float: "Real", int: "Integer", bool: "Boolean"}[type(self.start)]

    def derivative(self, value_reference: int) -> "BlockVariable":
        """Returns the derivative by time of a continuous state, as a variable."""
        return replace(
            self,
            name=f"der({self.name})",
            value_reference=value_reference,
            description=f"Derivative of: {self.description}",
            unit=per_second(self.unit or "1"),
            display_unit=None,
            minimum=None,
            maximum=None,
            nominal=None,
            source="",
        )

    @property
    def settable(self) -> bool:
        return self.causality in ("parameter", "input")

    def cast(self, value: Value) -> Value:
        """Returns the value in the Python type of the start value, or as enumeration member."""
        return (self.enumeration or type(self.start))(value)

    def refuse(self, value: Value) -> str | None:
        """Returns the reason why a value is not acceptable, or None if it is."""
        low, high = self.minimum, self.maximum
        if not math.isfinite(value):
            return f"{self.name} = {value!r}: expected a finite number"
        whole = {"Boolean": (0, 1), "Integer": (round(value),)}
        unknown = value not in list(self.enumeration or whole.get(self.type, [value]))
        outside = (low is not None and value < low) or (high is not None and value > high)
        return f"{self.name} = {value!r}: expected {self.expected}" if unknown or outside else None

    @property
    def expected(self) -> str:
        """Values that are acceptable, in words."""
        if self.enumeration:
            return "one of " + ", ".join(f"{m.value} ({m.name.lower()})" for m in self.enumeration)
        if self.type == "Boolean":
            return "0 (false) or 1 (true)"
        low = -math.inf if self.minimum is None else self.minimum
        high = math.inf if self.maximum is None else self.maximum
        return range_text(low, high, self.unit)


# causality, FMI variability, initial of each of a block's interface classes
ROLES = {
    "parameters": ("parameter", "tunable", "exact"),
    "calculated": ("calculatedParameter", "tunable", "calculated"),
    "inputs": ("input", "continuous", None),
    "outputs": ("output", "continuous", "calculated"),
}
_OF_STATES = ("local", "continuous", "calculated")
_UNDECLARED: Any = variable(0.0, "")


def scalar_variables(
    declared: Field, role: str, first_reference: int, prefix: str = ""
) -> Iterator[BlockVariable]:
    said = declared.metadata
    causality, variability, initial = ROLES.get(role, _OF_STATES)
    for offset, (index, start) in enumerate(_elements(declared.default)):
        is_real = isinstance(start, float)
        discrete = "discrete" if variability == "continuous" and not is_real else variability
        yield BlockVariable(
            name=prefix + declared.name + (f"[{','.join(str(i + 1) for i in index)}]" if index else ""),
            value_reference=first_reference + offset,
            causality=causality,
            variability=said["variability"] or discrete,
            initial=initial,
            start=start,
            enumeration=type(start) if isinstance(start, IntEnum) else None,
            **said["texts"],
            **{name: _at(value, index) if is_real else None for name, value in said["units"].items()},
            **{name: _at(value, index) for name, value in said["ranges"].items()},
        )


def state_variables(state: Any, said: Mapping[str, Any] = {}, path: str = "") -> Iterator[BlockVariable]:
    """Yields the scalars of a state, named by their paths; a plain one has the whole range of its type.

    said: metadata of its declaration
    """
    if is_dataclass(state):
        for part in fields(state):
            yield from state_variables(getattr(state, part.name), part.metadata, f"{path}.{part.name}")
    elif isinstance(state, tuple) and any(map(is_dataclass, state)):
        for index, part in members(state) or ():
            yield from state_variables(part, path=path + index)
    else:
        declared: Any = field(default=state, metadata=said if "ranges" in said else _UNDECLARED.metadata)
        declared.name = path.lstrip(".")
        yield from scalar_variables(declared, "state", 0)


def _elements(value: Any, index: tuple[int, ...] = ()) -> Iterator[tuple[tuple[int, ...], Any]]:
    if isinstance(value, tuple):
        for i, element in enumerate(value):
            yield from _elements(element, (*index, i))
    else:
        yield index, value


def _at(value: Any, index: tuple[int, ...]) -> Any:
    for i in index:
        if isinstance(value, tuple):
            value = value[i]
    return value

"""The scalars of dataclasses and nested tuples, in the order of declaration, and back."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any


def members(value: Any, first: int = 1) -> list[tuple[str, Any]] | None:
    """Returns (".name" or "[1]", value) of each member of a tuple or dataclass; None of a scalar.

    first: index of the first element of a tuple
    """
    if isinstance(value, tuple):
        return [(f"[{i}]", element) for i, element in enumerate(value, first)]
    names = _member_names(value if isinstance(value, type) else type(value))
    return None if names is None else [(f".{name}", getattr(value, name)) for name in names]


def flatten(value: Any) -> list[Any]:
    """Returns the scalars of a dataclass instance or nested tuple, in the order of declaration."""
    scalars: list[Any] = []
    _collect(value, scalars)
    return scalars


def _collect(value: Any, scalars: list[Any]) -> None:
    if isinstance(value, tuple):
        members = value
    elif (names := _member_names(value if isinstance(value, type) else type(value))) is not None:
        members = [getattr(value, name) for name in names]
    else:
        scalars.append(value)
        return
    for member in members:
        # most are floats: a call for each would take longer
        if member.__class__ is float:
            scalars.append(member)
        else:
            _collect(member, scalars)


@cache
def _member_names(cls: type) -> tuple[str, ...] | None:
    """Returns the names of a dataclass' members; None for any other class."""
    return tuple(member.name for member in fields(cls)) if is_dataclass(cls) else None


def unflatten(template: Any, scalars: list[Any]) -> Any:
    """Returns scalars in the shape of `template`, a class or an instance: the inverse of `flatten`.

    Raises ValueError when the number of scalars does not fit.
    """
    remaining = iter(scalars)
    try:
        value = _fill(template, remaining)
    except StopIteration:
        raise ValueError(f"{len(scalars)} scalars are too few") from None
    if next(remaining, None) is not None:
        raise ValueError(f"{len(scalars)} scalars are too many")
    return value


def _fill(template: Any, scalars: Iterator[Any]) -> Any:
    if template.__class__ is float:
        return next(scalars)
    if isinstance(template, tuple):
        return tuple([_fill(element, scalars) for element in template])
    cls = template if isinstance(template, type) else type(template)
    if (names := _member_names(cls)) is None:
        return next(scalars)
    if template is cls:
        return cls(*[_fill(member, scalars) for member in _defaults(cls)])
    return cls(*[_fill(getattr(template, name), scalars) for name in names])


@cache
def _defaults(cls: type) -> tuple[Any, ...]:
    """Returns the defaults of a dataclass' members."""
    return tuple(member.default for member in fields(cls))

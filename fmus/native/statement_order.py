"""Statements of generated C as late as they can stand: right before the first that uses their number.

There are more numbers than registers: one that is computed long before its use is stored and loaded again.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

_VARIABLE = re.compile(r"\bv\d+\b")
_ELSE, _END = "} else {", "}"


@dataclass(frozen=True)
class Branch:
    """`if (...) {`, and what stands in it and in its else."""

    head: str
    taken: list["str | Branch"]
    other: list["str | Branch"] = field(default_factory=list)


def as_late_as_possible(lines: Iterable[str]) -> list[str]:
    """The statements of a function, of which each sets a variable once, in another order."""
    body, _ = _block(iter(lines))
    return list(_ordered(body))


def _block(lines: Iterator[str]) -> tuple[list[str | Branch], str]:
    """What stands before the end of a block, and the line that ends it."""
    items: list[str | Branch] = []
    for line in lines:
        if line in (_ELSE, _END):
            return items, line
        if not line.startswith("if ("):
            items.append(line)
            continue
        taken, end = _block(lines)
        items.append(Branch(line, taken, _block(lines)[0] if end == _ELSE else []))
    return items, ""


def _ordered(items: list[str | Branch]) -> Iterator[str]:
    waiting = {}
    for item in items:
        target = item.partition(" = ")[0] if isinstance(item, str) else ""
        if _VARIABLE.fullmatch(target):
            waiting[target] = item
            continue
        for variable in _used(item):
            yield from _needed(variable, waiting)
        yield from [item] if isinstance(item, str) else _lines(item)
    for variable in list(waiting):  # what is used behind this block
        yield from _needed(variable, waiting)


def _needed(variable: str, waiting: dict[str, str]) -> list[str]:
    """The statement of a variable after those of what it uses, as far as they are waiting."""
    statements, path = [], [variable]
    while path:  # a function of its own would call itself as often as the longest chain has statements
        missing = [used for used in _used(waiting.get(path[-1], "")) if used in waiting]
        if missing:
            path.append(missing[0])
        else:
            statements += [waiting.pop(name) for name in (path.pop(),) if name in waiting]
    return statements


def _lines(branch: Branch) -> Iterator[str]:
    yield branch.head
    yield from _ordered(branch.taken)
    if branch.other:
        yield _ELSE
        yield from _ordered(branch.other)
    yield _END


def _used(item: str | Branch) -> list[str]:
    """The variables that a statement reads, or a branch in its head and inside."""
    if isinstance(item, str):
        return _VARIABLE.findall(item.partition(" = ")[2])
    inside = [variable for other in (*item.taken, *item.other) for variable in _used(other)]
    return _VARIABLE.findall(item.head) + inside

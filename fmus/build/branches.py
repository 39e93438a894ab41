"""Statements in C for operations: what only one alternative needs stands in a branch of its own.

CasADi evaluates both alternatives of a choice. Here an operation that is needed only where a condition holds
stands in an `if` of that condition, unless that would save less than a branch may cost. The operations and
their order in each expression are those of CasADi, so the results are the same bit for bit.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from heapq import heappop, heappush
from itertools import takewhile

from fmus.build.operations import Operation

Path = tuple[int, ...]
"""The conditions, outermost first, under which an operation is carried out: numbers of operations that are
true; ~number for one that is false."""

_BRANCH = 8  # cost of operations that are not worth a branch


class Statements:
    """The statements of a function in an order in which each number is there before it is used.

    assigned: the operations that have a variable; in_branches: those that not every call carries out
    """

    def __init__(self, operations: Sequence[Operation], results: Sequence[int]) -> None:
        self._operations = operations
        self._paths = _paths(operations, results)
        self.assigned = [number for number in sorted(self._paths) if operations[number].arguments]
        self.in_branches = {number for number, path in self._paths.items() if path}
        self._missing = {number: len(self._needed(number)) for number in self.assigned}
        self._users: dict[int, list[int]] = defaultdict(list)
        for number in self.assigned:
            for argument in self._needed(number):
                self._users[argument].append(number)
        self._ready: dict[Path, list[int]] = defaultdict(list)  # heaps
        for number, count in self._missing.items():
            if not count:
                self._ready[self._paths[number]].append(number)

    def term(self, number: int) -> str:
        """What stands for the number of an operation in an expression."""
        operation = self._operations[number]
        return f"v{number}" if operation.arguments else operation.text

    def lines(self, path: Path = ()) -> Iterator[str]:
        """The statements of a branch, as far as they can be carried out, in the order of the operations."""
        ready = self._ready[path]
        while True:
            while ready:
                number = heappop(ready)
                yield self._statement(number)
                self._finish(number)
            inside = [other for other, heap in self._ready.items() if heap and other[: len(path)] == path]
            if not inside:
                return
            first = min(inside, key=lambda other: self._ready[other][0])
            yield from self._branches(path, first[len(path)])

    def _branches(self, path: Path, condition: int) -> Iterator[str]:
        """The statements where a condition holds, and where it does not."""
        number = max(condition, ~condition)
        holds, fails = ([f"    {line}" for line in self.lines((*path, way))] for way in (number, ~number))
        yield f"if ({'' if holds else '!'}{self.term(number)}) {{"
        yield from holds or fails
        if holds and fails:
            yield "} else {"
            yield from fails
        yield "}"

    def _statement(self, number: int) -> str:
        operation = self._operations[number]
        return f"v{number} = {operation.text.format(*map(self.term, operation.arguments))};"

    def _needed(self, number: int) -> set[int]:
        """The operations that must come before one: its arguments, and the conditions of its branch."""
        conditions = (max(condition, ~condition) for condition in self._paths[number])
        used = {*self._operations[number].arguments, *conditions}
        return {argument for argument in used if self._operations[argument].arguments}

    def _finish(self, number: int) -> None:
        for user in self._users[number]:
            self._missing[user] -= 1
            if not self._missing[user]:
                heappush(self._ready[self._paths[user]], user)


def _paths(operations: Sequence[Operation], results: Sequence[int]) -> dict[int, Path]:
    """The branch of each operation that is needed."""
    cheap: set[Path] = set()
    while True:
        paths = _needs(operations, results, cheap)
        costs: dict[Path, int] = defaultdict(int)
        for number, path in paths.items():
            for length in range(1, len(path) + 1):
                costs[path[:length]] += operations[number].cost
        more = {path for path, cost in costs.items() if cost < _BRANCH}
        if not more:
            break
        cheap |= more
    return paths


def _needs(operations: Sequence[Operation], results: Sequence[int], cheap: set[Path]) -> dict[int, Path]:
    """For each operation the conditions under which alone it is needed, but for branches that are cheap."""
    paths: dict[int, Path] = dict.fromkeys(results, ())
    for number in range(len(operations) - 1, -1, -1):
        if number not in paths:
            continue
        operation, path = operations[number], paths[number]
        for index, argument in enumerate(operation.arguments):
            condition = _condition(operations, operation, index)
            inner = path if condition is None or condition in path else (*path, condition)
            inner = path if inner in cheap else inner
            paths[argument] = _common(paths.get(argument, inner), inner)
    return paths


def _condition(operations: Sequence[Operation], operation: Operation, index: int) -> int | None:
    """The condition under which alone an operation needs one of its arguments, if there is one."""
    if not index or operation.name not in ("IF_ELSE_ZERO", "CHOICE"):
        return None
    number, holds = operation.arguments[0], index == 1
    while operations[number].name == "NOT":
        number, holds = operations[number].arguments[0], not holds
    return number if holds else ~number


def _common(first: Path, second: Path) -> Path:
    pairs = zip(first, second, strict=False)
    return tuple(a for a, _ in takewhile(lambda pair: pair[0] == pair[1], pairs))

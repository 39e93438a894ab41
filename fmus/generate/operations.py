"""The operations of a function of CasADi, and their order; `c_code.py` writes them in a dialect of C.

CasADi evaluates both alternatives of a choice. Here an operation that is needed only where a condition holds
stands in an `if` of that condition, unless that would save less than a branch may cost. The operations of
each expression keep CasADi's order, so the results are the same bit for bit.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from heapq import heappop, heappush
from itertools import takewhile

from fmus.extras import imports_of

with imports_of("build", "building an FMU"):
    import casadi


TIMES = ("t", "h")
"""Arguments that are numbers; all others are columns."""
# functions of math.h and elementary.h with CasADi's names in lower case
_SAME_NAMES = (
    "EXP LOG POW SQRT SIN COS TAN ASIN ACOS ATAN FLOOR CEIL FMOD FMOD_BY_WHOLE REMAINDER FABS COPYSIGN "
    "ERF SINH COSH TANH ASINH ACOSH ATANH ATAN2 HYPOT LOG1P EXPM1"
)
CALLS = {name: name.lower() for name in _SAME_NAMES.split()} | {
    "CONSTPOW": "pow",
    "FMIN": "smaller",
    "FMAX": "larger",
}
"""Operation -> function of math.h or elementary.h."""
_QUICK_CALLS = {"SQRT", "FABS", "FLOOR", "CEIL", "COPYSIGN", "FMIN", "FMAX"}
_NAMES = {getattr(casadi, name): name[3:] for name in dir(casadi) if name.startswith("OP_")}
_LARGEST_WHOLE = 2.0**53
# operations that cost less are not worth a branch
_BRANCH = 8


@dataclass(frozen=True)
class Operation:
    """A number that a function computes from numbers of other operations.

    name: as in CasADi, or RESULT, CHOICE (a condition and two numbers), FMOD_BY_WHOLE (of a constant)
    arguments: numbers of operations
    text: of an argument or result of the function, `t` or `x[0]`, or of a constant
    place: address in C of argument, result and flag of a call that is repeated for a new argument alone
    """

    name: str
    arguments: tuple[int, ...] = ()
    text: str = ""
    place: str = ""

    @property
    def is_dear_call(self) -> bool:
        """Whether it calls a function of math.h that takes much longer than a sum or a product."""
        return self.name in CALLS and self.name not in _QUICK_CALLS

    @property
    def cost(self) -> int:
        """About how much longer than a sum or a product it takes."""
        if self.is_dear_call:
            return 20
        return 5 if self.name in ("DIV", "INV", "SQRT") else int(bool(self.arguments))


def operations_of(function: casadi.Function) -> list[Operation]:
    """Returns the operations of a function; the last ones are its results."""
    operations: list[Operation] = []
    results: list[Operation] = []
    held: dict[int, int] = {}  # place in CasADi's memory -> operation
    for i in range(function.n_instructions()):
        code = function.instruction_id(i)
        if code == casadi.OP_OUTPUT:
            used, element = function.instruction_input(i)[0], function.instruction_output(i)[1]
            results.append(Operation("RESULT", (held[used],), f"{function.name_out(0)}[{element}]"))
            continue
        if code == casadi.OP_INPUT:
            argument, element = function.instruction_input(i)
            column = function.name_in(argument)
            operation = Operation("INPUT", text=column if column in TIMES else f"{column}[{element}]")
        elif code == casadi.OP_CONST:
            operation = Operation("CONST", text=_constant(function.instruction_constant(i)))
        else:
            used = tuple(held[number] for number in function.instruction_input(i))
            # of 0 and -0, CasADi's functions give the first, the functions of elementary.h the second
            if code in (casadi.OP_FMIN, casadi.OP_FMAX):
                used = used[::-1]
            choice = _choice(operations, used) if code == casadi.OP_ADD else None
            operation = choice or Operation(_NAMES[code], used)
            if operation.name == "FMOD" and _is_whole(operations[used[1]]):
                operation = replace(operation, name="FMOD_BY_WHOLE")
        operations.append(operation)
        held[function.instruction_output(i)[0]] = len(operations) - 1
    return operations + results


def places_of(function: casadi.Function, others: Sequence[casadi.SX]) -> dict[int, int]:
    """Returns operation of `operations_of` -> place among other expressions that have the same number.

    Numbers are compared at one arbitrary point of the symbols.
    """
    terms, _ = _terms(function, function.sx_in())
    results = casadi.vertcat(*terms, *others)
    symbols = casadi.vertcat(*casadi.symvar(results))
    values = casadi.Function("values", [symbols], [results])
    point = [1.0 + 0.1 * math.sin(i) for i in range(symbols.numel())]
    numbers = values(point).full().ravel().tolist()
    places = {number: place for place, number in enumerate(numbers[len(terms) :])}
    return {i: places[number] for i, number in enumerate(numbers[: len(terms)]) if number in places}


def with_roundings(function: casadi.Function) -> casadi.Function:
    """Returns a function whose last argument has a relative rounding error for each operation.

    Whole numbers have none: sums and products of random generators, clocks and conditions are exact.
    """
    errors = casadi.SX.sym("errors", function.n_instructions())
    arguments = function.sx_in()
    _, results = _terms(function, arguments, lambda i, x: x + x * errors[i] * (x != casadi.floor(x)))
    return casadi.Function(function.name(), [*arguments, errors], [casadi.vertcat(*results)])


def _terms(
    function: casadi.Function,
    arguments: Sequence[casadi.SX],
    rounded: Callable[[int, casadi.SX], casadi.SX] = lambda i, x: x,
) -> tuple[list[casadi.SX], list[casadi.SX]]:
    """Returns the number of each operation, and the results; rounded: changes the number of one."""
    terms: list[casadi.SX] = []
    results: list[casadi.SX] = []
    held: dict[int, casadi.SX] = {}  # place in CasADi's memory -> number
    for i in range(function.n_instructions()):
        code, used = function.instruction_id(i), function.instruction_input(i)
        if code == casadi.OP_OUTPUT:
            results.append(held[used[0]])
            continue
        if code == casadi.OP_INPUT:
            term = arguments[used[0]][used[1]]
        elif code == casadi.OP_CONST:
            term = casadi.SX(function.instruction_constant(i))
        else:
            apply = casadi.SX.unary if len(used) == 1 else casadi.SX.binary
            term = rounded(i, apply(code, *(held[number] for number in used)))
        held[function.instruction_output(i)[0]] = term
        terms.append(term)
    return terms, results


def follows_from(operations: Sequence[Operation], names: Collection[str]) -> list[bool]:
    """Returns for each operation whether it follows from one of these arguments."""
    follows: list[bool] = []
    for operation in operations:
        is_one = operation.name == "INPUT" and operation.text.split("[")[0] in names
        follows.append(is_one or any(follows[argument] for argument in operation.arguments))
    return follows


def _choice(operations: Sequence[Operation], terms: Sequence[int]) -> Operation | None:
    """Returns one operation in place of CasADi's choice: a sum of two terms, one of which is 0.

    The operation adds 0, too, as the sum makes 0 of -0.
    """
    first, second = (operations[number] for number in terms)
    if first.name == second.name == "IF_ELSE_ZERO":
        for one, other in ((first, second), (second, first)):
            condition = operations[other.arguments[0]]
            if condition.name == "NOT" and condition.arguments == one.arguments[:1]:
                return Operation("CHOICE", (*one.arguments, other.arguments[1]))
    return None


def _is_whole(operation: Operation) -> bool:
    """Whether it is a constant from 1 to 2^53 without a fraction."""
    if operation.name != "CONST" or not operation.text[0].isdigit():
        return False
    value = float(operation.text)
    return value.is_integer() and 1.0 <= value <= _LARGEST_WHOLE


def _constant(value: float) -> str:
    text = repr(value).replace("inf", "INFINITY").replace("nan", "NAN")
    return f"({text})" if text.startswith("-") else text


Path = tuple[int, ...]
"""The conditions, outermost first, under which an operation is carried out: numbers of operations that are
true; ~number for one that is false."""


@dataclass(frozen=True)
class Branch:
    """Operations for a condition, the number of an operation: where it holds, and where it fails."""

    condition: int
    holds: list["Step"]
    fails: list["Step"]


Step = int | Branch
"""An operation, by its number, or a branch."""


class Schedule:
    """An order of operations in which each number is there before it is used.

    steps: the operations that the results need, without constants and arguments of the function; then the
    results. numbered: these operations by number; in_branches: those that not every call carries out
    """

    def __init__(self, operations: Sequence[Operation]) -> None:
        results = [number for number, operation in enumerate(operations) if operation.name == "RESULT"]
        self._operations = operations
        self._paths = _paths(operations, [operations[result].arguments[0] for result in results])
        self.in_branches = {number for number, path in self._paths.items() if path}
        self.numbered = [number for number in sorted(self._paths) if operations[number].arguments]
        self._missing = {number: len(self._needed(number)) for number in self.numbered}
        self._users: dict[int, list[int]] = defaultdict(list)
        for number in self.numbered:
            for argument in self._needed(number):
                self._users[argument].append(number)
        self._ready: dict[Path, list[int]] = defaultdict(list)  # heaps
        for number, count in self._missing.items():
            if not count:
                self._ready[self._paths[number]].append(number)
        self.steps = [*self._steps(()), *results]

    def _steps(self, path: Path) -> Iterator[Step]:
        """Yields the operations of a branch that can be carried out, in their order."""
        ready = self._ready[path]
        while True:
            while ready:
                number = heappop(ready)
                yield number
                self._finish(number)
            inside = [other for other, heap in self._ready.items() if heap and other[: len(path)] == path]
            if not inside:
                return
            condition = min(inside, key=lambda other: self._ready[other][0])[len(path)]
            number = max(condition, ~condition)
            yield Branch(number, *(list(self._steps((*path, way))) for way in (number, ~number)))

    def _needed(self, number: int) -> set[int]:
        """Returns the operations that must come before one: its arguments, its branch's conditions."""
        conditions = (max(condition, ~condition) for condition in self._paths[number])
        used = {*self._operations[number].arguments, *conditions}
        return {argument for argument in used if self._operations[argument].arguments}

    def _finish(self, number: int) -> None:
        for user in self._users[number]:
            self._missing[user] -= 1
            if not self._missing[user]:
                heappush(self._ready[self._paths[user]], user)


def _paths(operations: Sequence[Operation], results: Sequence[int]) -> dict[int, Path]:
    """Returns the branch of each operation that is needed."""
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
    """Returns the conditions under which alone each operation is needed, except cheap branches."""
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
    """Returns the condition under which alone an operation needs one of its arguments, if there is one."""
    if not index or operation.name not in ("IF_ELSE_ZERO", "CHOICE"):
        return None
    number, holds = operation.arguments[0], index == 1
    while operations[number].name == "NOT":
        number, holds = operations[number].arguments[0], not holds
    return number if holds else ~number


def _common(first: Path, second: Path) -> Path:
    pairs = zip(first, second, strict=False)
    return tuple(a for a, _ in takewhile(lambda pair: pair[0] == pair[1], pairs))


def as_late_as_possible(steps: Sequence[Step], operations: Sequence[Operation]) -> list[Step]:
    """Returns the steps in another order: each right before the first that uses its number.

    A number that is computed long before its use leaves its register: it is stored and loaded again.
    """
    ordered: list[Step] = []
    waiting: dict[int, None] = {}  # in the order of the steps

    def place(number: int) -> None:
        path = [number] if number in waiting else []
        # A recursion would be as deep as the longest chain of operations.
        while path:
            missing = [used for used in operations[path[-1]].arguments if used in waiting]
            if missing:
                path.append(missing[0])
            else:
                del waiting[path[-1]]
                ordered.append(path.pop())

    for step in steps:
        if isinstance(step, int) and operations[step].name != "RESULT":
            waiting[step] = None
            continue
        for number in _used(step, operations):
            place(number)
        if isinstance(step, int):
            ordered.append(step)
        else:
            inside = (as_late_as_possible(part, operations) for part in (step.holds, step.fails))
            ordered.append(Branch(step.condition, *inside))
    # the rest is used behind this branch
    for number in list(waiting):
        place(number)
    return ordered


def _used(step: Step, operations: Sequence[Operation]) -> list[int]:
    """Returns the operations whose numbers an operation reads, or a branch in its condition and inside."""
    if isinstance(step, int):
        return [*operations[step].arguments]
    inside = [number for part in (*step.holds, *step.fails) for number in _used(part, operations)]
    return [step.condition, *inside]

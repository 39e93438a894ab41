"""The operations of a function of CasADi, with their expressions in C."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi

from fmus.errors import ExportError

TIMES = ("t", "h")
"""Arguments that are numbers; all else are columns."""
_CALLS = {
    "EXP": "exp", "LOG": "log", "POW": "pow", "CONSTPOW": "pow", "SQRT": "sqrt", "SIN": "sin", "COS": "cos",
    "TAN": "tan", "ASIN": "asin", "ACOS": "acos", "ATAN": "atan", "FLOOR": "floor", "CEIL": "ceil",
    "FMOD": "fmod", "REMAINDER": "remainder", "FABS": "fabs", "COPYSIGN": "copysign", "ERF": "erf",
    "FMIN": "smaller", "FMAX": "larger", "SINH": "sinh", "COSH": "cosh", "TANH": "tanh", "ASINH": "asinh",
    "ACOSH": "acosh", "ATANH": "atanh", "ATAN2": "atan2", "HYPOT": "hypot", "LOG1P": "log1p",
    "EXPM1": "expm1",
}  # fmt: skip
_EXPRESSIONS = {
    "ASSIGN": "{0}", "ADD": "{0} + {1}", "SUB": "{0} - {1}", "MUL": "{0} * {1}", "DIV": "{0} / {1}",
    "NEG": "-{0}", "SQ": "{0} * {0}", "TWICE": "2 * {0}", "INV": "1 / {0}", "LT": "{0} < {1}",
    "LE": "{0} <= {1}", "EQ": "{0} == {1}", "NE": "{0} != {1}", "NOT": "!{0}", "AND": "{0} && {1}",
    "OR": "{0} || {1}", "IF_ELSE_ZERO": "{0} ? {1} : 0", "SIGN": "{0} < 0 ? -1 : {0} > 0 ? 1 : {0}",
    "CHOICE": "({0} ? {1} : {2}) + 0.0",
    **{name: f"{function}({{0}})" for name, function in _CALLS.items()},
    **{name: f"{_CALLS[name]}({{0}}, {{1}})" for name in
       ("POW", "CONSTPOW", "FMOD", "REMAINDER", "COPYSIGN", "ATAN2", "HYPOT")},
    # of 0 and -0, CasADi's give the first and ours the second
    **{name: f"{_CALLS[name]}({{1}}, {{0}})" for name in ("FMIN", "FMAX")},
}  # fmt: skip
_OPERATIONS = {
    getattr(casadi, f"OP_{name}"): (name, text) for name, text in _EXPRESSIONS.items() if name != "CHOICE"
}
_REMAINDER_BY_WHOLE = "fmod_by_whole({0}, {1})"
_LARGEST_WHOLE = 2.0**53
_QUICK_CALLS = {"SQRT", "FABS", "FLOOR", "CEIL", "COPYSIGN", "FMIN", "FMAX"}


@dataclass(frozen=True)
class Operation:
    """A number that a function computes: its expression in C, of arguments that are numbers of operations.

    An argument of the function is called as in CasADi, and a constant stands for itself.
    """

    name: str
    text: str
    arguments: tuple[int, ...] = ()

    def remembered_in(self, place: str) -> "Operation":
        """The same call of one argument, computed where that is another than before; place: of both in C."""
        return replace(self, text=f"remembered({_CALLS[self.name]}, {{0}}, {place})")

    @property
    def is_dear_call(self) -> bool:
        """Whether it calls a function of math.h that takes much longer than a sum or a product."""
        return self.name in _CALLS and self.name not in _QUICK_CALLS

    @property
    def cost(self) -> int:
        """About how much longer than a sum or a product it takes."""
        if self.is_dear_call:
            return 20
        return 5 if self.name in ("DIV", "INV", "SQRT") else int(bool(self.arguments))


def operations_of(function: casadi.Function) -> tuple[list[Operation], list[tuple[int, int]]]:
    """The operations of a function, and for each element of the result its place and operation."""
    operations: list[Operation] = []
    held: dict[int, int] = {}  # place in CasADi's memory -> operation
    results = []
    for i in range(function.n_instructions()):
        code = function.instruction_id(i)
        if code == casadi.OP_OUTPUT:
            results.append((function.instruction_output(i)[1], held[function.instruction_input(i)[0]]))
            continue
        if code == casadi.OP_INPUT:
            argument, element = function.instruction_input(i)
            column = function.name_in(argument)
            operations.append(Operation("INPUT", column if column in TIMES else f"{column}[{element}]"))
        elif code == casadi.OP_CONST:
            operations.append(Operation("CONST", _constant(function.instruction_constant(i))))
        elif code in _OPERATIONS:
            used = tuple(held[number] for number in function.instruction_input(i))
            choice = _choice(operations, used) if code == casadi.OP_ADD else None
            operation = choice or Operation(*_OPERATIONS[code], used)
            if operation.name == "FMOD" and _is_whole(operations[used[1]]):
                operation = replace(operation, text=_REMAINDER_BY_WHOLE)
            operations.append(operation)
        else:
            raise ExportError(f"{function.name()}: operation {code} of CasADi has no expression in C")
        held[function.instruction_output(i)[0]] = len(operations) - 1
    return operations, results


def _choice(operations: Sequence[Operation], terms: Sequence[int]) -> Operation | None:
    """One operation in place of a sum of two terms, of which one or the other is 0, as CasADi has a choice.

    The sum with 0 makes 0 of -0.
    """
    first, second = (operations[number] for number in terms)
    if first.name == second.name == "IF_ELSE_ZERO":
        for one, other in ((first, second), (second, first)):
            condition = operations[other.arguments[0]]
            if condition.name == "NOT" and condition.arguments == one.arguments[:1]:
                used = (*one.arguments, other.arguments[1])
                return Operation("CHOICE", _EXPRESSIONS["CHOICE"], used)
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

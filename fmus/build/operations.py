"""The operations of a function of CasADi, which `c_functions.py` writes in a dialect of C."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi

TIMES = ("t", "h")
"""Arguments that are numbers; all else are columns."""
CALLS = {
    "EXP": "exp", "LOG": "log", "POW": "pow", "CONSTPOW": "pow", "SQRT": "sqrt", "SIN": "sin", "COS": "cos",
    "TAN": "tan", "ASIN": "asin", "ACOS": "acos", "ATAN": "atan", "FLOOR": "floor", "CEIL": "ceil",
    "FMOD": "fmod", "FMOD_BY_WHOLE": "fmod_by_whole", "REMAINDER": "remainder", "FABS": "fabs",
    "COPYSIGN": "copysign", "ERF": "erf", "FMIN": "smaller", "FMAX": "larger", "SINH": "sinh", "COSH": "cosh",
    "TANH": "tanh", "ASINH": "asinh", "ACOSH": "acosh", "ATANH": "atanh", "ATAN2": "atan2", "HYPOT": "hypot",
    "LOG1P": "log1p", "EXPM1": "expm1",
}  # fmt: skip
"""Operation -> function of math.h or elementary.h."""
_QUICK_CALLS = {"SQRT", "FABS", "FLOOR", "CEIL", "COPYSIGN", "FMIN", "FMAX"}
_NAMES = {getattr(casadi, name): name[3:] for name in dir(casadi) if name.startswith("OP_")}
_LARGEST_WHOLE = 2.0**53


@dataclass(frozen=True)
class Operation:
    """A number that a function computes from numbers of other operations.

    name: as in CasADi, or RESULT, CHOICE (a condition and two numbers), FMOD_BY_WHOLE (of a constant)
    arguments: numbers of operations
    text: of an argument or result of the function, `t` or `x[0]`, or of a constant
    place: in C, of the last argument and result of a call that is made where its argument changes
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
            if code in (casadi.OP_FMIN, casadi.OP_FMAX):  # of 0 and -0, these give the first, ours the second
                used = used[::-1]
            choice = _choice(operations, used) if code == casadi.OP_ADD else None
            operation = choice or Operation(_NAMES[code], used)
            if operation.name == "FMOD" and _is_whole(operations[used[1]]):
                operation = replace(operation, name="FMOD_BY_WHOLE")
        operations.append(operation)
        held[function.instruction_output(i)[0]] = len(operations) - 1
    return operations + results


def _choice(operations: Sequence[Operation], terms: Sequence[int]) -> Operation | None:
    """Returns one operation in place of CasADi's choice: a sum of two terms, one of which is 0.

    The sum with 0 makes 0 of -0.
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

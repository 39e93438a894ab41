"""Functions of CasADi as C99."""

import textwrap
from collections.abc import Collection, Sequence

import casadi

from fmus.build.branches import Statements
from fmus.build.operations import TIMES, Operation, operations_of

_ARGUMENTS = {**{time: f"double {time}" for time in TIMES}, "k": "double *k"}


def c_function(function: casadi.Function, name: str, is_inlined: bool = False) -> str:
    """A static function of that name: its arguments are called as CasADi's, and the column of its result.

    The times t and h are numbers, all other arguments columns. is_inlined: whether each call becomes a copy
    """
    operations, results = operations_of(function)
    code = _c_function(name, function.name_in(), function.name_out(0), operations, results)
    return code.replace("static ", "static INLINED ", 1) if is_inlined else code


def c_functions(function: casadi.Function, name: str, held: Collection[str], inputs: str) -> tuple[str, int]:
    """As `c_function`, but what follows from the arguments `held` alone is computed by another function.

    NAME_constants writes these numbers to a column k, which is the last argument of NAME. After them come
    argument and result of each call that follows from the argument `inputs` too, and is dear: NAME computes
    it anew where the argument has changed. Second result: how many numbers there are in k.
    """
    operations, results = operations_of(function)
    arguments, result = function.name_in(), function.name_out(0)
    used = [number for _, number in results]
    varies = _follows_from(operations, {*arguments} - {*held})
    constants = _constants(operations, used, varies)
    numbered = list(enumerate(constants))
    calls = _calls_of_inputs(operations, varies, _follows_from(operations, {*arguments} - {*held, inputs}))
    places = range(len(constants), len(constants) + 2 * len(calls), 2)
    first = [a for a in arguments if a in held]
    unknown = [f"k[{i}] = NAN;" for place in places for i in (place, place + 1)]
    first = _c_function(f"{name}_constants", first, "k", operations, numbered, unknown)
    for index, number in numbered:
        operations[number] = Operation("INPUT", f"k[{index}]")
    for place, number in zip(places, calls, strict=True):
        operations[number] = operations[number].remembered_in(f"k + {place}")
    code = _c_function(name, [*arguments, "k"], result, operations, results)
    return f"{first}\n{code}", len(constants) + 2 * len(calls)


def _follows_from(operations: Sequence[Operation], names: Collection[str]) -> list[bool]:
    """Of each operation whether it follows from one of these arguments."""
    follows: list[bool] = []
    for operation in operations:
        is_one = operation.text.split("[")[0] in names and not operation.arguments
        follows.append(is_one or any(follows[argument] for argument in operation.arguments))
    return follows


def _constants(operations: Sequence[Operation], results: Sequence[int], varies: Sequence[bool]) -> list[int]:
    """The operations that do not vary, and that others or the results use."""
    users = [operation.arguments for operation, v in zip(operations, varies, strict=True) if v]
    used = {*results, *(argument for arguments in users for argument in arguments)}
    return sorted(number for number in used if operations[number].arguments and not varies[number])


def _calls_of_inputs(
    operations: Sequence[Operation], varies: Sequence[bool], varies_in_any_step: Sequence[bool]
) -> list[int]:
    """The dear calls whose argument changes with inputs alone, which may be the same for many steps."""
    return [
        number
        for number, operation in enumerate(operations)
        if operation.is_dear_call and len(operation.arguments) == 1
        if varies[number] and not varies_in_any_step[number]
    ]


def _c_function(
    name: str,
    argument_names: Sequence[str],
    result: str,
    operations: Sequence[Operation],
    results: Sequence[tuple[int, int]],
    last_lines: Sequence[str] = (),
) -> str:
    arguments = [_ARGUMENTS.get(a, f"const double *{a}") for a in argument_names]
    statements = Statements(operations, [number for _, number in results])
    lines = list(statements.lines())
    lines += [f"{result}[{index}] = {statements.term(number)};" for index, number in results]
    lines += last_lines
    names = [f"v{n} = 0" if n in statements.in_branches else f"v{n}" for n in statements.assigned]
    declared = textwrap.wrap(f"double {', '.join(names)};", 110, subsequent_indent="    ") if names else []
    code = "\n".join(f"    {line}" for line in (*declared, *lines))
    return f"static void {name}({', '.join((*arguments, f'double *{result}'))}) {{\n{code}\n}}\n"

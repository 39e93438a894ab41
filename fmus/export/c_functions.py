"""Functions of CasADi as C99."""

import textwrap
from collections.abc import Collection, Sequence

import casadi

from fmus.export.branches import Statements
from fmus.export.operations import TIMES, Operation, operations_of


def c_function(function: casadi.Function, name: str) -> str:
    """A static function of that name: its arguments are called as CasADi's, and the column of its result.

    The times t and h are numbers, all other arguments columns.
    """
    operations, results = operations_of(function)
    return _c_function(name, function.name_in(), function.name_out(0), operations, results)


def c_functions(function: casadi.Function, name: str, held: Collection[str]) -> tuple[str, int]:
    """As `c_function`, but what follows from the arguments `held` alone is computed by another function.

    NAME_constants writes these numbers to a column k, which is the last argument of NAME. Second result: how
    many they are.
    """
    operations, results = operations_of(function)
    arguments, result = function.name_in(), function.name_out(0)
    constants = _constants(operations, [number for _, number in results], {*arguments} - {*held})
    numbered = list(enumerate(constants))
    first = _c_function(f"{name}_constants", [a for a in arguments if a in held], "k", operations, numbered)
    for index, number in numbered:
        operations[number] = Operation("INPUT", f"k[{index}]")
    second = _c_function(name, [*arguments, "k"], result, operations, results)
    return f"{first}\n{second}", len(constants)


def _constants(
    operations: Sequence[Operation], results: Sequence[int], varying: Collection[str]
) -> list[int]:
    """The operations that follow from no varying argument, and that others or the results use."""
    varies: list[bool] = []
    for operation in operations:
        is_varying_argument = operation.text.split("[")[0] in varying and not operation.arguments
        varies.append(is_varying_argument or any(varies[argument] for argument in operation.arguments))
    users = [operation.arguments for operation, v in zip(operations, varies, strict=True) if v]
    used = {*results, *(argument for arguments in users for argument in arguments)}
    return sorted(number for number in used if operations[number].arguments and not varies[number])


def _c_function(
    name: str,
    argument_names: Sequence[str],
    result: str,
    operations: Sequence[Operation],
    results: Sequence[tuple[int, int]],
) -> str:
    arguments = [f"double {a}" if a in TIMES else f"const double *{a}" for a in argument_names]
    statements = Statements(operations, [number for _, number in results])
    lines = list(statements.lines())
    lines += [f"{result}[{index}] = {statements.term(number)};" for index, number in results]
    names = [f"v{n} = 0" if n in statements.in_branches else f"v{n}" for n in statements.assigned]
    declared = textwrap.wrap(f"double {', '.join(names)};", 110, subsequent_indent="    ") if names else []
    code = "\n".join(f"    {line}" for line in (*declared, *lines))
    return f"static void {name}({', '.join((*arguments, f'double *{result}'))}) {{\n{code}\n}}\n"

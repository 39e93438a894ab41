"""Traced functions -> C in two dialects: for one instance, and for a group of instances.

`fmus/firmware/code.py` has a third one, for microcontrollers. All write the same operations, a statement
each. So their numbers are the same bit for bit, but for firmware in floats.
"""

import textwrap
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

from fmus.errors import ExportError
from fmus.extras import imports_of
from fmus.generate.operations import (
    CALLS,
    TIMES,
    Operation,
    Schedule,
    Step,
    as_late_as_possible,
    follows_from,
    operations_of,
)
from fmus.generate.trace import Traced

with imports_of("build", "building an FMU"):
    import casadi

_INITIAL = """static void model_initial_{kind}(double t, const double *x, const double *u, const double *p,
                                 const double *v, double *along) {{
    double between[{size}];
    model_{first}(t, x, u, p, v, between);
    model_{second}(t, x, u, p, between, along);
}}
"""
_ABOUT_LANES = "/* Equations in vectors, for ensembles. An importer compiles model_code.h. */\n"


@dataclass(frozen=True)
class CFunction:
    """A static function of C: its arguments have CasADi's names, as has the column of its result.

    is_inlined: whether each call becomes a copy
    """

    name: str
    arguments: Sequence[str]
    result: str
    operations: Sequence[Operation]
    is_inlined: bool = False

    @cached_property
    def schedule(self) -> Schedule:
        """The schedule of its operations, which all dialects share."""
        return Schedule(self.operations)


class ScalarC:
    """C99 for one instance: a number is a double, a condition 1.0 or 0.0."""

    number, unset = "double", "0"
    column = "double *"
    # Arguments that a function writes: they are not const.
    changed = ("k",)
    more_arguments: Sequence[str] = ()
    inlined = "INLINED "
    branch = "if ({0}) {{", "if (!{0}) {{", "}} else {{"
    expressions: ClassVar = {
        "RESULT": "{0}",
        "ASSIGN": "{0}",
        "ADD": "{0} + {1}",
        "SUB": "{0} - {1}",
        "MUL": "{0} * {1}",
        "DIV": "{0} / {1}",
        "NEG": "-{0}",
        "SQ": "{0} * {0}",
        "TWICE": "2 * {0}",
        "INV": "1 / {0}",
        "LT": "{0} < {1}",
        "LE": "{0} <= {1}",
        "EQ": "{0} == {1}",
        "NE": "{0} != {1}",
        "NOT": "!{0}",
        "AND": "{0} && {1}",
        "OR": "{0} || {1}",
        "IF_ELSE_ZERO": "{0} ? {1} : 0",
        "SIGN": "{0} < 0 ? -1 : {0} > 0 ? 1 : {0}",
        "CHOICE": "({0} ? {1} : {2}) + 0.0",
    }

    def function(self, f: CFunction) -> str:
        """Returns the C code; the times t and h are numbers, all other arguments columns."""
        arguments = [*map(self._argument, f.arguments), self._column(f.result), *self.more_arguments]
        head = f"static {self.inlined if f.is_inlined else ''}void {f.name}({', '.join(arguments)})"
        body = "\n".join(f"    {line}" for line in (*self._declarations(f), *self._lines(f, self._steps(f))))
        return f"{head} {{\n{body}\n}}\n"

    def _argument(self, name: str) -> str:
        if name in TIMES:
            return f"double {name}"
        return f"{'' if name in self.changed else 'const '}{self._column(name)}"

    def _column(self, name: str) -> str:
        return f"{self.column}{name}"

    def _declarations(self, f: CFunction) -> list[str]:
        unset, names = f.schedule.in_branches, dict[str, list[str]]()
        for n in f.schedule.numbered:
            names.setdefault(self._type(n), []).append(f"v{n} = {self.unset}" if n in unset else f"v{n}")
        texts = [f"{number} {', '.join(listed)};" for number, listed in names.items()]
        return [line for text in texts for line in textwrap.wrap(text, 110, subsequent_indent="    ")]

    def _type(self, number: int) -> str:
        """Returns the type in C of the number of an operation."""
        return self.number

    def _steps(self, f: CFunction) -> Sequence[Step]:
        return f.schedule.steps

    def _lines(self, f: CFunction, steps: Sequence[Step]) -> Iterator[str]:
        for step in steps:
            if isinstance(step, int):
                yield self._statement(f, step)
                continue
            holds, fails = ([f"    {line}" for line in self._lines(f, p)] for p in (step.holds, step.fails))
            heads = [head.format(self._term(f, step.condition)) for head in self.branch]
            yield heads[0 if holds else 1]
            yield from holds or fails
            if holds and fails:
                yield heads[2]
                yield from fails
            yield "}"

    def _statement(self, f: CFunction, number: int) -> str:
        operation = f.operations[number]
        terms = [self._term(f, argument) for argument in operation.arguments]
        if operation.name in CALLS:
            value = self._call(operation, CALLS[operation.name], terms)
        elif operation.name in self.expressions:
            value = self.expressions[operation.name].format(*terms)
        else:
            raise ExportError(f"{f.name}: operation {operation.name} of CasADi has no expression in C")
        return f"{self._text(operation) or f'v{number}'} = {value};"

    def _term(self, f: CFunction, number: int) -> str:
        """Returns the text of the number of an operation in an expression."""
        operation = f.operations[number]
        return f"v{number}" if operation.arguments else self._text(operation)

    def _text(self, operation: Operation) -> str:
        return operation.text

    def _call(self, operation: Operation, function: str, terms: list[str]) -> str:
        if operation.place:
            return f"remembered({function}, {terms[0]}, {operation.place})"
        return f"{function}({', '.join(terms)})"


class VectorC(ScalarC):
    """C of Clang for a group of instances, a lane for each, with the functions of lane_functions.h.

    A choice takes each lane from its own alternative, and a branch is carried out if one lane at least needs
    it. Every expensive call stores its arguments and its result, for the next call with equal arguments.

    memory: how many vectors the calls of all functions until now remember
    """

    number, unset = "Lanes", "ANY"
    column = "Lanes *restrict "
    changed = ()
    more_arguments = ("Lanes *restrict memory",)
    inlined = ""
    branch = "if (any(is_true({0}))) {{", "if (any(is_false({0}))) {{", "}} if (any(is_false({0}))) {{"
    expressions: ClassVar = {
        **ScalarC.expressions,
        "LT": "number({0} < {1})",
        "LE": "number({0} <= {1})",
        "EQ": "number({0} == {1})",
        "NE": "number({0} != {1})",
        "NOT": "number(is_false({0}))",
        "SIGN": "sign({0})",
        "AND": "number(is_true({0}) & is_true({1}))",
        "OR": "number(is_true({0}) | is_true({1}))",
        "CHOICE": "choice(is_true({0}), {1}, {2}) + all(0.0)",
        "IF_ELSE_ZERO": "choice(is_true({0}), {1}, all(0))",
    }

    def __init__(self) -> None:
        self.memory = 0

    def _steps(self, f: CFunction) -> Sequence[Step]:
        return as_late_as_possible(f.schedule.steps, f.operations)

    def _term(self, f: CFunction, number: int) -> str:
        term = super()._term(f, number)
        return term if f.operations[number].arguments or "[" in term else f"all({term})"

    def _call(self, operation: Operation, function: str, terms: list[str]) -> str:
        if operation.is_dear_call:
            terms = [*terms, f"memory + {self.memory}"]
            # `terms` has the arguments and the address, in whose place the result is counted
            self.memory += len(terms)
        return f"lanes_{function}({', '.join(terms)})"


def c_code(traced: Traced, derivatives: Mapping[str, casadi.Function]) -> dict[str, str]:
    """Returns file name -> C functions called model_FUNCTION, with the arguments of the traced ones.

    derivatives: further functions, of directional derivatives

    model_code.h has all of them, model_lanes.h the functions of a run for groups of instances.
    """
    # Numbers that follow from step size and parameters alone stay for many steps: model_step_constants
    # computes them once.
    step, constants = c_functions(traced.step, "model_step", held=("h", "p", "c"), inputs="u")
    others = {name: function for name, function in traced.functions().items() if name != "step"}
    others.update(derivatives)
    code = {name: c_function(f, f"model_{name}", name == "output") for name, f in others.items()}
    of_runs = [*step, *(code[name] for name in ("calculate", "requirements", "initial_state", "output"))]
    size, scalar, vector = f"enum {{ N_STEP_CONSTANTS = {constants} }};\n", ScalarC(), VectorC()
    lanes = [vector.function(f) for f in of_runs]
    memory = f"enum {{ N_MEMORY = {vector.memory} }};\n"
    equations = [size, *map(scalar.function, (*step, *code.values())), *_initial(derivatives)]
    return {
        "model_code.h": "\n".join(equations),
        "model_lanes.h": "\n".join([_ABOUT_LANES, size, memory, *lanes]),
    }


def _initial(derivatives: Mapping[str, casadi.Function]) -> Iterator[str]:
    """Yields the functions of initialization that call two functions one after the other."""
    for kind in ("forward", "adjoint"):
        if start := derivatives.get(f"start_{kind}"):
            first, second = (start.name(), f"step_{kind}")[:: 1 if kind == "forward" else -1]
            yield _INITIAL.format(kind=kind, first=first, second=second, size=start.numel_out(0))


def c_function(function: casadi.Function, name: str, is_inlined: bool = False) -> CFunction:
    """Returns the function of C of that name."""
    return CFunction(name, function.name_in(), function.name_out(0), operations_of(function), is_inlined)


def c_functions(
    function: casadi.Function, name: str, held: Collection[str], inputs: str
) -> tuple[list[CFunction], int]:
    """Returns the functions NAME_constants and NAME, and how many numbers they share in a column k.

    NAME_constants writes to k the numbers that follow from the arguments `held` alone. k is the last argument
    of NAME. After these numbers come argument, result and a flag of each expensive call that follows from the
    argument `inputs` too: NAME computes it again where the argument has changed.
    """
    operations, arguments = operations_of(function), function.name_in()
    varies = follows_from(operations, {*arguments} - {*held})
    constants = _constants(operations, varies)
    calls = _calls_of_inputs(operations, varies, follows_from(operations, {*arguments} - {*held, inputs}))
    count = len(constants) + 3 * len(calls)
    known = [*(o for o in operations if o.name != "RESULT"), Operation("CONST", text="0.0")]
    numbers = constants + [len(known) - 1] * 3 * len(calls)
    results = [Operation("RESULT", (number,), f"k[{index}]") for index, number in enumerate(numbers)]
    of_held = [argument for argument in arguments if argument in held]
    for index, number in enumerate(constants):
        operations[number] = Operation("INPUT", text=f"k[{index}]")
    for place, number in zip(range(len(constants), count, 3), calls, strict=True):
        operations[number] = replace(operations[number], place=f"k + {place}")
    return [
        CFunction(f"{name}_constants", of_held, "k", known + results),
        CFunction(name, [*arguments, "k"], function.name_out(0), operations),
    ], count


def _constants(operations: Sequence[Operation], varies: Sequence[bool]) -> list[int]:
    """Returns the operations that do not vary, and that others or the results use."""
    users = [o.arguments for o, v in zip(operations, varies, strict=True) if v or o.name == "RESULT"]
    used = {argument for arguments in users for argument in arguments}
    return sorted(number for number in used if operations[number].arguments and not varies[number])


def _calls_of_inputs(
    operations: Sequence[Operation], varies: Sequence[bool], varies_in_any_step: Sequence[bool]
) -> list[int]:
    """Returns the expensive calls whose argument changes with inputs alone: it may stay for many steps."""
    return [
        number
        for number, operation in enumerate(operations)
        if operation.is_dear_call and len(operation.arguments) == 1
        if varies[number] and not varies_in_any_step[number]
    ]

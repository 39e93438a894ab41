"""A block traced to CasADi: what its functions compute, as expressions and as C99.

Every function takes and gives column vectors in the order of `flatten`; parameters `p`, calculated
parameters `c`, inputs `u`, state `x`, outputs `y`, times `t` and `h` in s.
"""

import math
from collections.abc import Callable
from functools import cache, partial, reduce
from typing import Any

import casadi

from fmus.block import Block
from fmus.block.integration import between_events
from fmus.block.scalars import flatten, unflatten
from fmus.build import guard
from fmus.build.c_functions import ScalarC, VectorC, c_function, c_functions
from fmus.build.declaration import check_declaration, check_requirements, check_result, scalar_names
from fmus.build.right_derivative import right_derivative
from fmus.errors import ExportError
from fmus.numerics.symbols import unsimplified

_ABOUT_LANES = "/* Equations in vectors, for ensembles: an importer compiles those of model_code.h. */\n"


class Traced:
    """The functions of a block as CasADi functions.

    calculate: p -> c
    requirements: (p, c) -> 1 for each condition that holds, 0 for each that does not
    initial_state: (t, u, p, c) -> x
    step: (t, h, x, u, p, c) -> x
    output: (t, x, p, c) -> y
    output_rate: (t, x, u, p, c) -> dy/dt just after t: outputs after a step, derived by its length
    required: what each of the requirements expects, in words

    In model exchange `step` is evaluated with h = 0: what it copies from inputs follows them at once, what
    `sampled` and `at_events` guard is held, and the continuous states are the solver's. Of a block with these
    besides, all but `held` of the state that `held` returns:
    held: (t, x, u, p, c) -> x between events of model exchange
    derivative, crossings, event: (t, x, u, p, c) -> derivatives, event indicators, x after an event
    next_event: (t, x, u, p, c) -> the time at which the next sample is due [s], infinite if none is
    integrated_rate: (t, x, u, p, c) -> the derivatives that `integrate` of the block has, for a comparison
    """

    def __init__(self, block: Block) -> None:
        self.block = block
        check_declaration(block)
        t, h = casadi.SX.sym("t"), casadi.SX.sym("h")
        call = partial(guard.call, block.name)
        interface = (block.parameters, block.calculated, block.inputs)
        (ps, p), (cs, c), (us, u) = (_symbols(block, role) for role in interface)
        calculated, conditions = call(block.calculate, p), call(block.requirements, p, c)
        check_result(block, "calculate", calculated)
        check_requirements(block, conditions)
        initial = call(block.initial_state, t, u, p, c)
        check_result(block, "initial_state", initial)
        xs, x = _symbols(block, initial)
        stepped = call(block.advance, t, h, x, u, p, c)
        check_result(block, "step", stepped)
        outputs = call(block.output, t, x, p, c)
        check_result(block, "output", outputs)
        self.required = tuple(text for _, text in conditions)
        self.calculate = self._function("calculate", "p", [ps], "c", calculated)
        self.requirements = self._function(
            "requirements", "p c", [ps, cs], "holds", tuple(holds for holds, _ in conditions)
        )
        self.initial_state = self._function("initial_state", "t u p c", [t, us, ps, cs], "x", initial)
        self.step = self._function("step", "t h x u p c", [t, h, xs, us, ps, cs], "next", stepped)
        self.output = self._function("output", "t x p c", [t, xs, ps, cs], "y", outputs)
        for name in ("calculate", "step", "output"):
            self._check_constants(name)

        rate = right_derivative(_column(call(block.output, t + h, stepped, p, c)), h)
        self.output_rate = self._function("output_rate", "t x u p c", [t, xs, us, ps, cs], "rate", rate)

        if block.derivative:
            self._trace_exchange(block.derivative, t, h, (xs, us, ps, cs), (x, u, p, c))

    def _trace_exchange(
        self, derivative: Callable[..., Any], t: casadi.SX, h: casadi.SX, columns: tuple, values: tuple
    ) -> None:
        """Traces what a block with continuous states needs besides."""
        block, (xs, us, ps, cs), (x, *others) = self.block, columns, values
        count, arguments = len(flatten(block.continuous)), [t, xs, us, ps, cs]
        call = partial(guard.call, block.name)

        def function(name: str, result: Any) -> casadi.Function:
            return self._function(name, "t x u p c", arguments, name, result)

        held, rates = call(block.held, t, x, *others), call(derivative, t, x, *others)
        check_result(block, "derivative", rates)
        event = call(block.step, t, 0.0, x, *others)
        check_result(block, "step", event)
        after = _column(event)
        for i in _copied(block, xs, _column(held)):
            after[i] = xs[i]
        due = reduce(casadi.fmin, call(_due_samples, block, t, x, *others), casadi.SX(math.inf))
        self.held, self.derivative = function("held", held), function("rates", rates)
        self.crossings = function("crossings", tuple(call(block.crossings, t, x, *others)))
        self.event, self.next_event = function("event", after), function("next_event", due)
        if block.integrate:
            integrated = call(block.integrate, t, h, x, *others)
            check_result(block, "integrate", integrated)
            self.integrated_rate = function("rate", right_derivative(_column(integrated)[:count], h))

    def between_events(self, function: casadi.Function) -> casadi.Function:
        """Returns a function of (t, x, u, p, c) with the state between events in place of x."""
        t, x, *others = function.sx_in()
        result = function(t, self.held(t, x, *others), *others)
        return casadi.Function(function.name(), [t, x, *others], [result])

    def _check_constants(self, name: str) -> None:
        """Raises ExportError for a function with a constant that is NaN."""
        function: casadi.Function = getattr(self, name)
        for i in range(function.n_instructions()):
            is_constant = function.instruction_id(i) == casadi.OP_CONST
            if is_constant and math.isnan(function.instruction_constant(i)):
                where = guard.location(getattr(self.block, name))
                raise ExportError(
                    f"block {self.block.name!r}: {where}{name} holds a constant that is not a number"
                )

    def functions(self) -> dict[str, casadi.Function]:
        """Returns everything that an FMU needs, by name."""
        own = {name: value for name, value in vars(self).items() if isinstance(value, casadi.Function)}
        return {name: value for name, value in own.items() if name != "integrated_rate"}

    def c_code(self, derivatives: dict[str, casadi.Function]) -> dict[str, str]:
        """Returns file name -> C functions called model_FUNCTION, with the arguments of this class.

        derivatives: further functions, of directional derivatives

        model_code.h has all of them, model_lanes.h those of a run for groups of instances. What a step needs
        of its size and the parameters alone is computed apart, by model_step_constants.
        """
        step, constants = c_functions(self.step, "model_step", held=("h", "p", "c"), inputs="u")
        others = {
            name: function for name, function in self.functions().items() if name != "step"
        } | derivatives
        code = {name: c_function(f, f"model_{name}", name == "output") for name, f in others.items()}
        of_runs = [*step, *(code[name] for name in ("calculate", "requirements", "initial_state", "output"))]
        size, scalar, vector = f"enum {{ N_STEP_CONSTANTS = {constants} }};\n", ScalarC(), VectorC()
        lanes = [vector.function(f) for f in of_runs]
        memory = f"enum {{ N_MEMORY = {vector.memory} }};\n"
        return {
            "model_code.h": "\n".join([size, *map(scalar.function, (*step, *code.values()))]),
            "model_lanes.h": "\n".join([_ABOUT_LANES, size, memory, *lanes]),
        }

    def _function(
        self, name: str, names: str, arguments: list, result_name: str, result: Any
    ) -> casadi.Function:
        column = casadi.densify(result if isinstance(result, casadi.SX) else _column(result))
        column = unsimplified(casadi.cse, column)
        return casadi.Function(name, arguments, [column], names.split(), [result_name])


@cache
def traced(block: Block) -> Traced:
    """Returns the functions of a block, traced once in a process; ExportError if it cannot be traced."""
    try:
        return Traced(block)
    except ExportError:
        raise
    except (TypeError, AttributeError, RuntimeError, NotImplementedError) as error:
        if " are free." in str(error):  # symbols that are no arguments of a function, in CasADi's words
            reason = (
                f"a function changes its arguments, or gives what an earlier call has kept; {guard.NO_MEMORY}"
            )
            raise ExportError(f"block {block.name!r} cannot be traced: {reason}") from error
        raise ExportError(f"block {block.name!r} cannot be traced: {error}") from error


def _symbols(block: Block, template: Any) -> tuple[casadi.SX, Any]:
    """Returns a column of symbols, also in the shape of the template, a class of the block or a value."""
    count = len(flatten(template() if isinstance(template, type) else template))
    column = casadi.SX.sym("x", count)
    return column, guard.call(block.name, unflatten, template, [column[i] for i in range(count)])


def _column(value: Any) -> casadi.SX:
    scalars = flatten(value)
    return casadi.vertcat(*map(casadi.SX, scalars)) if scalars else casadi.SX(0, 1)


def _due_samples(block: Block, t: float, state: Any, *others: Any) -> list[float]:
    """Returns the times at which samples are due [s]."""
    with between_events() as due:
        block.step(t, 0.0, state, *others)
    return due


def _copied(block: Block, state: casadi.SX, held: casadi.SX) -> list[int]:
    """Returns the numbers of the state that follow inputs at once.

    state, held: the state, and as it is between events
    Raises ExportError if `step` changes something at no event that is no copy of what is given.
    """
    changed = [i for i in range(state.numel()) if not casadi.is_equal(state[i], held[i])]
    for wrong in (i for i in changed if casadi.depends_on(held[i], state[changed])):
        name = [*scalar_names(block.state)][wrong]
        raise ExportError(
            f"block {block.name!r}: {guard.location(block.step)}step changes {name} by what it was: "
            "expected at_events(state, new) or sampled(...) of fmus.numerics around it"
        )
    return changed


def indicator_count(block: Block) -> int:
    """Returns how many event indicators a block has."""
    return traced(block).crossings.numel_out(0) if block.derivative else 0


def restarted_states(block: Block) -> set[int]:
    """Returns the value references of the continuous states that an event may change."""
    if not block.derivative:
        return set()
    functions = traced(block)
    _, x, *_ = arguments = functions.event.sx_in()
    after = functions.event(*arguments)
    states = block.states[: len(block.states) // 2]
    return {v.value_reference for i, v in enumerate(states) if not casadi.is_equal(after[i], x[i])}

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
from fmus.block.scalars import flatten, unflatten
from fmus.build import guard
from fmus.build.c_functions import ScalarC, VectorC, c_function, c_functions
from fmus.build.declaration import check_declaration, check_requirements, check_result
from fmus.build.exchange import copied, due_samples
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
    calculate_derivative: (p, v) -> directional derivative of c along the seed v of p
    initial_derivative: (t, u, p, c, v) -> that of y, and of x of a block with continuous states, along the
        seed v of (p, c, u), in initialisation mode
    output_derivative: (t, x, p, c, v) -> that of y along the seed v of (p, c), the state held; of a block
        with continuous states of (p, c, x)
    initial_sparsity: which of (c, y) follow from which of (p, u) in initialisation mode
    required: what each of the requirements expects, in words

    Of a block with continuous states besides, all but `held` of the state that `held` returns:
    held: (t, x, u, p, c) -> x between events of model exchange
    derivative, crossings, event: (t, x, u, p, c) -> derivatives, event indicators, x after an event
    next_event: (t, x, u, p, c) -> the time at which the next sample is due [s], infinite if none is
    held_derivative, rates_derivative: (t, x, u, p, c, v) -> directional derivative of x between events, and
        of the derivatives, along the seed v of (p, c, u, x)
    present_sparsity: which of y and the derivatives follow from which of u and the continuous states
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

        unknown = first = _column(call(block.output, t, initial, p, c))
        if derivative := block.derivative:
            self._trace_exchange(derivative, t, h, (xs, us, ps, cs), (x, u, p, c))
            first = casadi.vertcat(first, _column(initial))
        known = casadi.vertcat(ps, cs, us)
        self.calculate_derivative = self._along("calculate_derivative", "p", [ps], _column(calculated), ps)
        self.initial_derivative = self._along("initial_derivative", "t u p c", [t, us, ps, cs], first, known)
        held = _column(outputs), casadi.vertcat(ps, cs, *([xs] if block.derivative else []))
        self.output_derivative = self._along("output_derivative", "t x p c", [t, xs, ps, cs], *held)
        if derivative:
            start = call(block.held, t, initial, u, p, c)
            continuous = _column(initial)[: len(flatten(block.continuous))]
            unknown = casadi.vertcat(unknown, continuous, _column(call(derivative, t, start, u, p, c)))
        unknowns = casadi.vertcat(_column(calculated), casadi.substitute(unknown, cs, _column(calculated)))
        self.initial_sparsity = casadi.jacobian_sparsity(unknowns, casadi.vertcat(ps, us))

    def _trace_exchange(
        self, derivative: Callable[..., Any], t: casadi.SX, h: casadi.SX, columns: tuple, values: tuple
    ) -> None:
        """Traces what a block with continuous states needs besides."""
        block, (xs, us, ps, cs), (x, *others) = self.block, columns, values
        count, arguments = len(flatten(block.continuous)), [t, xs, us, ps, cs]
        call = partial(guard.call, block.name)

        def function(name: str, result: Any) -> casadi.Function:
            return self._function(name, "t x u p c", arguments, name, result)

        def along(name: str, result: Any) -> casadi.Function:
            known = casadi.vertcat(ps, cs, us, xs)
            return self._along(name, "t x u p c", arguments, _column(result), known)

        held, rates = call(block.held, t, x, *others), call(derivative, t, x, *others)
        check_result(block, "derivative", rates)
        event = call(block.step, t, 0.0, x, *others)
        check_result(block, "step", event)
        after = _column(event)
        for i in copied(block, xs, _column(held)):
            after[i] = xs[i]
        due = reduce(casadi.fmin, call(due_samples, block, t, x, *others), casadi.SX(math.inf))
        self.held, self.held_derivative = function("held", held), along("held_derivative", held)
        self.derivative, self.rates_derivative = function("rates", rates), along("rates_derivative", rates)
        self.crossings = function("crossings", tuple(call(block.crossings, t, x, *others)))
        self.event, self.next_event = function("event", after), function("next_event", due)
        outputs, rates = call(block.output, t, held, *others[1:]), call(derivative, t, held, *others)
        both, known = casadi.vertcat(_column(outputs), _column(rates)), casadi.vertcat(us, xs[:count])
        self.present_sparsity = casadi.jacobian_sparsity(both, known)
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

    def c_code(self, derivatives: dict[str, casadi.Function] | None = None) -> dict[str, str]:
        """Returns file name -> C functions called model_FUNCTION, with the arguments of this class.

        derivatives: these in place of the directional derivatives that FMI 2.0 has

        model_code.h has all of them, model_lanes.h those of a run for groups of instances. What a step needs
        of its size and the parameters alone is computed apart, by model_step_constants.
        """
        step, constants = c_functions(self.step, "model_step", held=("h", "p", "c"), inputs="u")
        others = {name: function for name, function in self.functions().items() if name != "step"}
        if derivatives is not None:
            others = {name: f for name, f in others.items() if not name.endswith("_derivative")} | derivatives
        code = {name: c_function(f, f"model_{name}", name == "output") for name, f in others.items()}
        of_runs = [*step, *(code[name] for name in ("calculate", "requirements", "initial_state", "output"))]
        size, scalar, vector = f"enum {{ N_STEP_CONSTANTS = {constants} }};\n", ScalarC(), VectorC()
        lanes = [vector.function(f) for f in of_runs]
        memory = f"enum {{ N_MEMORY = {vector.memory} }};\n"
        return {
            "model_code.h": "\n".join([size, *map(scalar.function, (*step, *code.values()))]),
            "model_lanes.h": "\n".join([_ABOUT_LANES, size, memory, *lanes]),
        }

    def _along(
        self, name: str, names: str, arguments: list, result: casadi.SX, known: casadi.SX
    ) -> casadi.Function:
        seed = casadi.SX.sym("v", known.numel())
        along = casadi.jtimes(result, known, seed)
        return self._function(name, f"{names} v", [*arguments, seed], "along", along)

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


def initial_dependencies(block: Block) -> dict[int, tuple[int, ...]]:
    """Returns value reference of each initial unknown -> those of the parameters and inputs behind it."""
    unknowns = (*block.of_causality("calculatedParameter"), *block.of_causality("output"), *block.states)
    knowns = (*block.of_causality("parameter"), *block.of_causality("input"))
    dependencies: dict[int, list[int]] = {v.value_reference: [] for v in unknowns}
    for row, column in zip(*traced(block).initial_sparsity.get_triplet(), strict=True):
        dependencies[unknowns[row].value_reference].append(knowns[column].value_reference)
    return {unknown: tuple(sorted(known)) for unknown, known in dependencies.items()}


def present_dependencies(block: Block) -> dict[int, tuple[int, ...]]:
    """Returns value reference of each output and derivative -> those of the inputs and states behind it."""
    outputs, count = block.of_causality("output"), len(block.states) // 2
    unknowns, knowns = (
        (*outputs, *block.states[count:]),
        (*block.of_causality("input"), *block.states[:count]),
    )
    dependencies: dict[int, list[int]] = {v.value_reference: [] for v in unknowns}
    triplets = traced(block).present_sparsity.get_triplet() if count else ((), ())
    for row, column in zip(*triplets, strict=True):
        dependencies[unknowns[row].value_reference].append(knowns[column].value_reference)
    return {unknown: tuple(sorted(known)) for unknown, known in dependencies.items()}


def restarted_states(block: Block) -> set[int]:
    """Returns the value references of the continuous states that an event may change."""
    if not block.derivative:
        return set()
    functions = traced(block)
    _, x, *_ = arguments = functions.event.sx_in()
    after = functions.event(*arguments)
    states = block.states[: len(block.states) // 2]
    return {v.value_reference for i, v in enumerate(states) if not casadi.is_equal(after[i], x[i])}

"""A block traced to CasADi: the results of its functions as expressions.

Every function takes and gives column vectors in the order of `flatten`; parameters `p`, calculated
parameters `c`, inputs `u`, state `x`, outputs `y`, times `t` and `h` in s.
"""

import math
from collections.abc import Callable
from functools import reduce
from typing import Any

from fmus.block import Block
from fmus.block.integration import between_events
from fmus.block.scalars import flatten, unflatten
from fmus.errors import ExportError
from fmus.extras import imports_of
from fmus.generate import guard
from fmus.generate.declare import check_declaration, check_requirements, check_result, scalar_names
from fmus.generate.operations import operations_of
from fmus.numerics.symbols import unsimplified

with imports_of("build", "building an FMU"):
    import casadi

# Elapsed times [s]: in the first one slopes hardly change, in the second one a lag of 1 ns ends.
_SHORT_STEPS = 1e-11, 1e-8


class Traced:
    """The functions of a block as CasADi functions.

    calculate: p -> c
    requirements: (p, c) -> 1 for each condition that holds, 0 for each that does not
    initial_state: (t, u, p, c) -> x
    step: (t, h, x, u, p, c) -> x
    output: (t, x, p, c) -> y
    required: what each of the requirements expects, in words
    indicators: how many event indicators the block has
    restarted: value references of the continuous states that an event may change

    A block with continuous states has these, too. In model exchange `step` is evaluated with h = 0: copies of
    inputs follow them at once, states that `sampled` and `at_events` guard are held, and the solver
    integrates the continuous states.

    held: (t, x, u, p, c) -> x between events of model exchange; the following functions take this state
    derivative, crossings, event: (t, x, u, p, c) -> derivatives, event indicators, x after an event
    next_event: (t, x, u, p, c) -> the time of the next sample [s], infinite without one
    integrated_rate: (t, x, u, p, c) -> the derivatives that `integrate` of the block has, for a comparison
    """

    def __init__(self, block: Block) -> None:
        self.block = block
        check_declaration(block)
        t, h = casadi.SX.sym("t"), casadi.SX.sym("h")
        # name of an argument -> column of symbols; the same in the shape that a function of the block takes
        self._columns: dict[str, casadi.SX] = {"t": t, "h": h}
        self._values: dict[str, Any] = {**self._columns}
        for name, role in (("p", block.parameters), ("c", block.calculated), ("u", block.inputs)):
            self._add_symbols(name, role)
        calculated, conditions = self._result("calculate", "p"), self._called(block.requirements, "p c")
        check_requirements(block, conditions)
        initial = self._result("initial_state", "t u p c")
        self._add_symbols("x", initial)
        stepped = self._result("step", "t h x u p c", block.advance)
        outputs = self._result("output", "t x p c")
        self.required = tuple(text for _, text in conditions)
        self.calculate = self._function("calculate", "p", "c", calculated)
        self.requirements = self._function(
            "requirements", "p c", "holds", tuple(holds for holds, _ in conditions)
        )
        self.initial_state = self._function("initial_state", "t u p c", "x", initial)
        self.step = self._function("step", "t h x u p c", "next", stepped)
        self.output = self._function("output", "t x p c", "y", outputs)
        for name in ("calculate", "step", "output"):
            self._check_constants(name)
        self.indicators, self.restarted = 0, set[int]()
        if block.derivative:
            self._trace_exchange()

    def _trace_exchange(self) -> None:
        """Traces the further functions of a block with continuous states."""
        block, x, arguments = self.block, self._columns["x"], "t x u p c"
        held, rates = self._called(block.held, arguments), self._result("derivative", arguments)
        event = _column(self._result("step", "t h x u p c", h=0.0))
        for i in _copied(block, x, _column(held)):
            event[i] = x[i]
        due = self._called(_due_samples, f"block {arguments}", block=block)
        self.held = self._function("held", arguments, "held", held)
        self.derivative = self._function("rates", arguments, "rates", rates)
        crossings = tuple(self._called(block.crossings, arguments))
        self.crossings = self._function("crossings", arguments, "crossings", crossings)
        self.indicators = self.crossings.numel_out(0)
        self.event = self._function("event", arguments, "event", event)
        self.restarted = self._restarted()
        next_event = reduce(casadi.fmin, due, casadi.SX(math.inf))
        self.next_event = self._function("next_event", arguments, "next_event", next_event)
        if block.integrate:
            integrated = _column(self._result("integrate", "t h x u p c"))[: len(flatten(rates))]
            h = self._columns["h"]
            slope = casadi.densify(casadi.jacobian(integrated, h))
            # At a corner, such as a limit that is reached, CasADi takes the mean of the slopes of both sides,
            # and a derivative may be finite in place of a jump. So any slope from the least to the largest
            # of a short step is right.
            slopes = [casadi.substitute(slope, h, elapsed) for elapsed in (0.0, *_SHORT_STEPS)]
            least, most = (reduce(extreme, slopes) for extreme in (casadi.fmin, casadi.fmax))
            between = casadi.fmin(casadi.fmax(_column(rates), least), most)
            rate = casadi.if_else(least <= most, between, least)  # NaN without a slope
            self.integrated_rate = self._function("rate", arguments, "rate", rate)

    def between_events(self, function: casadi.Function) -> casadi.Function:
        """Returns a function of (t, x, u, p, c) with the state between events in place of x."""
        t, x, *others = function.sx_in()
        result = function(t, self.held(t, x, *others), *others)
        return casadi.Function(function.name(), [t, x, *others], [result])

    def _restarted(self) -> set[int]:
        _, x, *_ = arguments = self.event.sx_in()
        after, states = self.event(*arguments), self.block.states[: len(self.block.states) // 2]
        return {v.value_reference for i, v in enumerate(states) if not casadi.is_equal(after[i], x[i])}

    def _check_constants(self, name: str) -> None:
        """Raises ExportError for a function with a constant that is NaN."""
        if any(operation.text == "NAN" for operation in operations_of(getattr(self, name))):
            where = guard.location(getattr(self.block, name))
            raise ExportError(
                f"block {self.block.name!r}: {where}{name} holds a constant that is not a number"
            )

    def functions(self) -> dict[str, casadi.Function]:
        """Returns the functions that an FMU needs, by name."""
        own = {name: value for name, value in vars(self).items() if isinstance(value, casadi.Function)}
        return {name: value for name, value in own.items() if name != "integrated_rate"}

    def _add_symbols(self, name: str, template: Any) -> None:
        """Adds the symbols of an argument in the shape of a class of the block, or of a value."""
        count = len(flatten(template() if isinstance(template, type) else template))
        column = self._columns[name] = casadi.SX.sym("x", count)
        scalars = [column[i] for i in range(count)]
        self._values[name] = guard.call(self.block.name, unflatten, template, scalars)

    def _called(self, function: Callable[..., Any], arguments: str, **instead: Any) -> Any:
        """Returns the result of a function for symbols; instead: other values of some arguments."""
        values = self._values | instead
        return guard.call(self.block.name, function, *(values[name] for name in arguments.split()))

    def _result(
        self, name: str, arguments: str, function: Callable[..., Any] | None = None, **instead: Any
    ) -> Any:
        """Returns the checked result of a function of the block, or of one in its place."""
        result = self._called(function or getattr(self.block, name), arguments, **instead)
        check_result(self.block, name, result)
        return result

    def _function(self, name: str, arguments: str, result_name: str, result: Any) -> casadi.Function:
        names = arguments.split()
        column = casadi.densify(result if isinstance(result, casadi.SX) else _column(result))
        column = unsimplified(casadi.cse, column)
        return casadi.Function(name, [self._columns[n] for n in names], [column], names, [result_name])


def trace(block: Block) -> Traced:
    """Returns the functions of a block; ExportError if it cannot be traced."""
    try:
        return Traced(block)
    except ExportError:
        raise
    except (TypeError, AttributeError, RuntimeError, NotImplementedError) as error:
        # CasADi's message for symbols that are no arguments of a function
        if " are free." in str(error):
            reason = (
                f"a function changes its arguments, or gives what an earlier call has kept; {guard.NO_MEMORY}"
            )
            raise ExportError(f"block {block.name!r} cannot be traced: {reason}") from error
        raise ExportError(f"block {block.name!r} cannot be traced: {error}") from error


def _column(value: Any) -> casadi.SX:
    scalars = flatten(value)
    return casadi.vertcat(*map(casadi.SX, scalars)) if scalars else casadi.SX(0, 1)


def _due_samples(block: Block, t: float, state: Any, *others: Any) -> list[float]:
    """Returns the times of the next samples [s]."""
    with between_events() as due:
        block.step(t, 0.0, state, *others)
    return due


def _copied(block: Block, state: casadi.SX, held: casadi.SX) -> list[int]:
    """Returns the numbers of the state that follow inputs at once.

    state, held: the state, and as it is between events
    Raises ExportError if `step` changes a state between events by its former value.
    """
    changed = [i for i in range(state.numel()) if not casadi.is_equal(state[i], held[i])]
    for wrong in (i for i in changed if casadi.depends_on(held[i], state[changed])):
        name = [*scalar_names(block.state)][wrong]
        raise ExportError(
            f"block {block.name!r}: {guard.location(block.step)}step changes {name} by what it was: "
            "expected at_events(state, new) or sampled(...) of fmus.numerics around it"
        )
    return changed

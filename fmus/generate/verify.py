"""Check that a traced block, and its library, give the results of its Python functions, and miss no sample.

The functions are called at random points. A difference is rounding if the function itself changes as much
when the result of each of its operations changes by a unit in the last place, which also covers a branch that
is taken within rounding. Any other difference refuses the block.
"""

import math
import random
from collections.abc import Callable, Iterator, Sequence
from enum import IntEnum
from functools import cache
from typing import Any

import numpy as np

from fmus.block import Block
from fmus.block.random_points import disturbed, drawn, is_limited, permitted
from fmus.block.scalars import flatten, members, unflatten
from fmus.errors import ExportError
from fmus.generate.declare import scalar_names
from fmus.generate.guard import NO_MEMORY, location, own_line
from fmus.generate.native import ShippedLibrary
from fmus.generate.operations import with_roundings
from fmus.generate.trace import Traced, trace
from fmus.numerics import Clock
from fmus.numerics.symbols import are_numbers, unsimplified

_POINTS, _STEPS = 60, 3  # draws of parameters; steps from each, with inputs drawn anew
_CHANGED = 0.1, 0.5, 1.0  # shares of the numbers that are drawn; others have their start values
# relative: a few roundings of elementary functions, which differ between C libraries
_EQUAL = 1e-12
# random errors of all operations, each of _ROUNDING; how much larger than their effect a difference may be
_PERTURBATIONS, _AMPLIFIED = 32, 32.0
_ROUNDING = 2.0**-52
# beside such a number another order of operations may overflow, as its square does
_LARGE = 1e150
# of the points; a function that amplifies rounding at more of them is not compared at all
_MOST_AMPLIFIED = 0.2
_AT_TWO_CALLS = f"at one call and {{}} at another, same arguments; {NO_MEMORY}"
_TRACED = "when it is traced"
_COMPILED = "when it is compiled; set ZIG_GLOBAL_CACHE_DIR to an empty folder, and build again"
_FUNCTIONS = ("calculate", "requirements", "initial_state", "output", "step")
_OF_CONTINUOUS = ("derivative", "crossings")
_INTEGRATED = "as the rate of the function integrate"
# After so many internal steps, one that is half a per cent longer than the period is late.
_INTERNAL_STEPS = 200
# relative: two ways to the same derivative
_NEARLY_EQUAL = 1e-9


class Comparison:
    """A function of a block beside its traced form."""

    def __init__(self, traced: Traced, name: str, as_written: Callable[[], Traced]) -> None:
        # as_written: returns the block traced without simplifications
        block = traced.block
        self._python: Callable[..., Any] = getattr(block, name)
        self._where = f"block {block.name!r}: {location(self._python)}{name}"
        self._name, self._traced, self._as_written = name, traced, as_written
        if name in _OF_CONTINUOUS:
            function = self._python
            self._python = lambda t, x, *others: function(t, block.held(t, x, *others), *others)
        elif name == "step":
            self._python = block.advance
        self.calls: list[tuple[Sequence[Any], Any, list[float]]] = []  # arguments, result, its numbers
        self._errors: list[tuple[Sequence[Any], Exception]] = []  # arguments without a result
        self._attempts = 0
        self._are_requirements = name == "requirements"

    def __call__(self, *arguments: Any, is_reached: bool = True) -> Any:
        """Returns the result of the Python function; None for NaN, infinity or an error.

        is_reached: whether the block can have these arguments; errors at others do not count
        """
        self._attempts += 1
        errors = len(self._errors)
        result, numbers = self._evaluate(arguments)
        if not is_reached:
            del self._errors[errors:]
        if numbers is not None:
            self.calls.append((arguments, result, numbers))
        return result

    def _evaluate(self, arguments: Sequence[Any]) -> tuple[Any, list[float] | None]:
        try:
            result = self._python(*arguments)
            values = [holds for holds, _ in result] if self._are_requirements else flatten(result)
            if not all(isinstance(value, complex) or are_numbers(value) for value in values):
                raise ExportError(f"{self._where} depends on an earlier call; {NO_MEMORY}")
            if any(isinstance(value, complex) or not math.isfinite(value) for value in values):
                return None, None
        except ExportError:
            raise
        except (ArithmeticError, ValueError) as error:
            self._errors.append((arguments, error))
            return None, None
        except Exception as error:
            raise ExportError(f"{self._where} raises {_described(error)}") from error
        return result, list(map(float, values))

    def check(self, rng: random.Random) -> None:
        """Raises ExportError for the first point where the function differs, or for too few to compare."""
        if self._attempts and not self.calls:
            last = f": {_described(self._errors[-1][1])}" if self._errors else ""
            raise ExportError(
                f"{self._where} gives no finite numbers at any of {self._attempts} random points{last}"
            )
        self._check_errors()
        for arguments, result, numbers in self.calls:
            again = self._evaluate(arguments)[1] or [math.nan] * len(numbers)
            exactly = [0.0] * len(numbers)
            self._compare(result, numbers, again, exactly, _AT_TWO_CALLS)
        self.check_traced(self._name, _TRACED, rng)

    def check_traced(self, name: str, how: str, rng: random.Random, equal: float = _EQUAL) -> None:
        """Compares the numbers of each call with a traced function; raises ExportError for a difference."""
        given = _numbers_of(_traced_function(self._traced, name), [a for a, _, _ in self.calls])
        self._check_numbers(given, name, how, rng, equal)

    def check_compiled(self, given: Sequence[list[float] | None], rng: random.Random) -> None:
        """Compares the numbers of each call with the compiled function; raises ExportError for a difference.

        given: the numbers for each call, or None to leave it out
        """
        self._check_numbers(given, self._name, _COMPILED, rng, _EQUAL)

    def _check_numbers(
        self, given: Sequence[list[float] | None], name: str, how: str, rng: random.Random, equal: float
    ) -> None:
        amplified, with_errors = 0, None
        for (arguments, result, numbers), others in zip(self.calls, given, strict=True):
            rounding = [equal * abs(x) for x in numbers]
            if others is None or (
                max(map(abs, numbers), default=0.0) > _LARGE and not all(map(math.isfinite, others))
            ):
                continue
            if not all(map(_are_near, numbers, others, rounding)):
                amplified += 1
                with_errors = with_errors or with_roundings(_traced_function(self._as_written(), name))
                moved = _moved(with_errors, arguments, rng)
                allowed = [max(a, _AMPLIFIED * b) for a, b in zip(rounding, moved, strict=True)]
                self._compare(result, numbers, others, allowed, f"in Python and {{}} {how}")
        if amplified > _MOST_AMPLIFIED * len(self.calls):
            raise ExportError(f"{self._where} differs {how} at {amplified} of {len(self.calls)} points")

    def _check_errors(self) -> None:
        """Raises ExportError where Python divides by zero or leaves a domain, and compiled code does not."""
        # Compiled code takes a number that is too large for Python for infinite: that is no such error.
        errors = [(a, error) for a, error in self._errors if not isinstance(error, OverflowError)]
        results = _numbers_of(
            _traced_function(self._traced, self._name), [arguments for arguments, _ in errors]
        )
        for (_, error), numbers in zip(errors, results, strict=True):
            if all(map(math.isfinite, numbers)):
                raise ExportError(
                    f"{self._where} raises {_described(error)}, where compiled code gives numbers; exclude "
                    "such values with min, max or requirements, or give an alternative of "
                    "fmus.numerics.where that is not always legal as a function: lambda: ..."
                )

    def _compare(
        self, result: Any, numbers: list[float], others: list[float], allowed: list[float], how: str
    ) -> None:
        """Raises ExportError for the first number that is not near the other, whose origin `how` states."""
        if all(map(_are_near, numbers, others, allowed)):
            return
        names = [f"({text})" for _, text in result] if self._are_requirements else scalar_names(result)
        for name, x, y, difference in zip(names, numbers, others, allowed, strict=True):
            if not _are_near(x, y, difference):
                raise ExportError(f"{self._where} gives {name} = {x!r} {how.format(repr(y))}")


def check_trace(traced: Traced, seed: int = 0) -> dict[str, Comparison]:
    """Checks that the traced functions of a block give the values of its Python functions.

    seed: of the random points
    Returns the calls of each function, for `check_shipped`. Raises ExportError for a difference.
    """
    block = traced.block
    # The points follow from the variables alone: a block under another name is compared at the same ones.
    rng = random.Random(seed)
    names = (*_FUNCTIONS, *(_OF_CONTINUOUS if block.derivative else ()))
    # without a simplification such as (a + b) - b = a the traced functions round as Python does
    as_written = cache(lambda: unsimplified(trace, block))
    compare = {name: Comparison(traced, name, as_written) for name in names}
    for point in range(_POINTS):
        _compare_at_a_point(block, compare, rng, at_start=point == 0)
    _compare_at_zeros(block, compare)
    for comparison in compare.values():
        comparison.check(rng)
    if block.integrate:
        compare["derivative"].check_traced("integrated_rate", _INTEGRATED, rng, _NEARLY_EQUAL)
    return compare


def check_shipped(compare: dict[str, Comparison], library: ShippedLibrary) -> None:
    """Checks that the library of an FMU gives the values of Python; raises ExportError for a difference.

    The library gives outputs for states that it reaches: they are compared where Python reached the same.
    """
    rng, outputs = random.Random(0), {}
    given = {"calculate": [library.calculated(p) for (p,), _, _ in compare["calculate"].calls]}
    for name in ("initial_state", "step"):
        reached = [library.reached(*arguments) or (0.0, None, []) for arguments, _, _ in compare[name].calls]
        given[name] = [x for _, x, _ in reached]
        for (arguments, state, numbers), (t, x, y) in zip(compare[name].calls, reached, strict=True):
            outputs |= {(t, id(state), id(arguments[-2])): y} if x == numbers else {}
    calls = compare["output"].calls
    given["output"] = [outputs.get((t, id(x), id(p))) for (t, x, p, _), _, _ in calls]
    for name, numbers in given.items():
        compare[name].check_compiled(numbers, rng)


def _compare_at_a_point(
    block: Block, compare: dict[str, Comparison], rng: random.Random, at_start: bool
) -> None:
    """Draws parameters, inputs and a time; follows the state over a few steps, and disturbs it in between."""

    def is_permitted(p: Any) -> bool:
        c = compare["calculate"](p)
        required = None if c is None else compare["requirements"](p, c)
        return required is not None and all(holds for holds, _ in required)

    changed = 0.0 if at_start else rng.choice(_CHANGED)
    p = permitted(block, drawn(block, "parameter", block.parameters, changed, rng), is_permitted)
    c = compare["calculate"](p)
    if c is None:
        return
    _check_whole(block, "calculate", block.calculated, c)
    # a run may begin before 0
    t = 0.0 if at_start else rng.uniform(-0.5, 1.0) * block.stop_time
    reached, h = None, p.internal_step * rng.choice((1.0, rng.uniform(0.1, 1.0)))
    for _ in range(_STEPS):
        u = drawn(block, "input", block.inputs, changed, rng)
        is_reached = reached is None
        x = compare["initial_state"](t, u, p, c) if is_reached else disturbed(block, reached, rng)
        if x is None:
            return
        if is_reached:
            _check_ranges(block, "initial_state", x, {"t": t}, u, p)
        y = compare["output"](t, x, p, c, is_reached=is_reached)
        for name in _OF_CONTINUOUS if block.derivative else ():
            compare[name](t, x, u, p, c, is_reached=is_reached)
        after = compare["step"](t, h, x, u, p, c, is_reached=is_reached)
        times = {"t": t, "h": h}
        if after is not None:
            _check_whole(block, "step", block.state, after)
            _check_ranges(block, "step", after, times, u, p, x)
        elif not is_reached:
            _check_limited(block, compare["step"], reached, x, (t, h, u, p, c))
        reached, t = after, t + h
        if is_reached:
            for outputs in filter(
                None, (y, None if reached is None else compare["output"](t, reached, p, c))
            ):
                _check_whole(block, "output", block.outputs, outputs)


def _check_ranges(block: Block, name: str, state: Any, *point: Any) -> None:
    """Raises ExportError if a function gives a state outside its range; point: its arguments."""
    for v, value in zip(block.state_variables, flatten(state), strict=True):
        if reason := v.refuse(value):
            where = f"block {block.name!r}: {location(getattr(block, name))}{name}"
            raise ExportError(f"{where} gives {reason}{_at(block, *point)}")


def _check_limited(block: Block, step: Comparison, reached: Any, state: Any, point: Sequence[Any]) -> None:
    """Raises ExportError if a step has no finite numbers because of states with declared limits alone.

    reached, state: the state before and after it was disturbed; point: the other arguments of `step`
    """
    t, h, u, p, c = point
    pairs = zip(block.state_variables, flatten(state), flatten(reached), strict=True)
    limited = unflatten(reached, [x if is_limited(v) else before for v, x, before in pairs])
    calls = [step(t, h, x, u, p, c, is_reached=False) for x in (reached, limited)]
    if calls[0] is not None and calls[1] is None:
        where = f"block {block.name!r}: {location(block.step)}step"
        at = _at(block, {"t": t, "h": h}, u, p, limited)
        raise ExportError(f"{where} gives no finite number for a state in its range{at}")


def _at(block: Block, times: dict[str, float], u: Any, p: Any, state: Any = None) -> str:
    """Returns a point in words: times, and the values that differ from the start values."""
    scalars = [*flatten(p), *flatten(u), *(flatten(state) if state else ())]
    variables = *block.of_causality("parameter"), *block.of_causality("input"), *block.state_variables
    changed = {v.name: x for v, x in zip(variables, scalars, strict=False) if x != v.start}
    return " at " + ", ".join(f"{name} = {x + 0!r}" for name, x in (times | changed).items())


def _compare_at_zeros(block: Block, compare: dict[str, Comparison]) -> None:
    """Steps once from the start values, with one input after the other at zero, where divisions end."""
    inputs = block.of_causality("input")
    p = unflatten(block.parameters, [v.start for v in block.of_causality("parameter")])
    c = compare["calculate"](p)
    for zero in inputs if c is not None else ():
        if zero.refuse(0) is None:
            u = unflatten(block.inputs, [v.cast(0) if v is zero else v.start for v in inputs])
            if (x := compare["initial_state"](0.0, u, p, c)) is not None:
                compare["step"](0.0, p.internal_step, x, u, p, c)


def _check_whole(block: Block, name: str, declared: type, result: Any) -> None:
    """Raises ExportError if a function gives a number that its Integer, Boolean or Enumeration cannot be."""
    for path, start, x in zip(scalar_names(result), flatten(declared), flatten(result), strict=False):
        if isinstance(start, int) and x not in _items(start, x):
            raise ExportError(
                f"block {block.name!r}: {location(getattr(block, name))}{name} gives {path} = {x!r}: "
                f"expected {_expected(start)}, as {declared.__name__} declares it with {start!r}; "
                f"write {float(start)!r} for any number"
            )


def _items(start: int, x: float) -> tuple[float, ...]:
    """Returns the values that a variable with this start value can have, as far as x could be among them."""
    if isinstance(start, bool):
        return 0, 1
    return tuple(type(start)) if isinstance(start, IntEnum) else (round(x),)


def _expected(start: int) -> str:
    if isinstance(start, IntEnum):
        return "one of " + ", ".join(f"{m.value} ({m.name.lower()})" for m in type(start))
    return "0 or 1" if isinstance(start, bool) else "a whole number"


def _traced_function(traced: Traced, name: str) -> Any:
    """Returns a traced function; of continuous states, with the state between events."""
    function = getattr(traced, name)
    return traced.between_events(function) if name in (*_OF_CONTINUOUS, "integrated_rate") else function


def _numbers_of(function: Any, calls: list[Sequence[Any]]) -> list[list[float]]:
    """Returns the results of a traced function for all arguments, in one call."""
    if not calls:
        return []
    columns = zip(*(map(flatten, arguments) for arguments in calls), strict=True)
    matrices = [np.array(scalars, float).reshape(len(calls), -1).T for scalars in columns]
    return function.map(len(calls))(*matrices).full().T.tolist()


def _moved(function: Any, arguments: Sequence[Any], rng: random.Random) -> list[float]:
    """Returns the distances that results move with random rounding errors; function: of `with_roundings`."""
    count = function.numel_in(function.n_in() - 1), _PERTURBATIONS
    errors = np.random.default_rng(rng.getrandbits(64)).uniform(-_ROUNDING, _ROUNDING, count)
    errors[:, 0] = 0.0
    columns = [np.array(flatten(argument), float).reshape(-1, 1) for argument in arguments]
    results = function.map(_PERTURBATIONS)(*(c.repeat(_PERTURBATIONS, 1) for c in columns), errors).full()
    return np.fmax.reduce(np.abs(results - results[:, :1]), axis=1).tolist()


def _described(error: Exception) -> str:
    """Returns the error as text, with the line of the user's that raised it."""
    own = own_line(error)
    return f"{error!r} at {own[0]}:{own[1]}: {own[2]}" if own else repr(error)


def _are_near(x: float, y: float, allowed: float) -> bool:
    # written so that it is false for NaN
    return abs(x - y) <= allowed


# samples: `sampled` takes one in a step at most


def check_sampling(block: Block) -> None:
    """Raises ExportError for a block that misses samples with all variables at their start values."""
    p, u, t = block.parameters(), block.inputs(), 0.0
    try:
        c = block.calculate(p)
        state = block.initial_state(t, u, p, c)
        for i in range(_INTERNAL_STEPS if any(True for _ in _clocks(state)) else 0):
            t, before = i * p.internal_step, state
            state = block.advance(t, p.internal_step, before, u, p, c)
            _check_step(block, t, p.internal_step, before, state)
    except ExportError:
        raise
    # the comparison with the traced functions judges these
    except (ArithmeticError, ValueError):
        return


def _check_step(block: Block, t: float, h: float, before: Any, after: Any) -> None:
    """Raises ExportError for a late clock: it starts again between t and t + h, unlike a block's Clock(t)."""
    for old, new in zip(_clocks(before), _clocks(after), strict=True):
        if new.start != old.start and new.count == 0 and new.start > t and new.start != t + h:
            missed = "samples"
            expected = "a step_size, or a parameter internal_step, of at most the sampling period"
            # a clock that starts at 0 is late for a sample at t + h, whatever its period is
            if old.start <= t == 0.0:
                missed = f"the sample that is due at {old.start!r} s"
                expected = "Clock(t + period) in initial_state, for samples at t + h"
            raise ExportError(
                f"block {block.name!r}: {location(block.step)}step misses {missed} in internal steps of "
                f"{h!r} s: expected {expected}"
            )


def _clocks(value: Any) -> Iterator[Clock]:
    """Yields the clocks in a state, at any depth."""
    if isinstance(value, Clock):
        yield value
    for _, part in members(value) or ():
        yield from _clocks(part)

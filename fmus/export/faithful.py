"""Whether a traced block computes what its Python functions do: both are called at random points.

A difference is rounding if the Python function itself changes as much when its arguments change by a few
units in the last place. Any other difference refuses the block.
"""

import math
import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from fmus.block import Block, ScalarVariable, flatten, unflatten
from fmus.errors import ExportError
from fmus.export.guard import location, own_line
from fmus.export.symbolic import traced

_POINTS, _STEPS = 60, 3  # draws of parameters; steps from each, with inputs drawn anew
_EQUAL = 1e-12  # relative: a few roundings of elementary functions, which differ between C libraries
_ULP, _PERTURBATIONS, _AMPLIFIED = 2.0**-52, 8, 32.0
_MOST_AMPLIFIED = (
    0.2  # of the points; a function that amplifies rounding at more of them is not compared at all
)
_SPECIAL = (0.0, 0.5, -0.5, 1.0, -1.0, 1.5, -1.5, 2.0, 2.5, -2.5)  # signs, and halves, which are rounded
_FUNCTIONS = ("calculate", "requirements", "initial_state", "output", "step")


def check_faithful(block: Block) -> None:
    """ExportError for a block whose traced functions give other values than its Python functions."""
    rng = random.Random(block.name)
    compare = {name: _Comparison(block, name) for name in _FUNCTIONS}
    for point in range(_POINTS):
        _compare_at_a_point(block, compare, rng, at_start=point == 0)
    for comparison in compare.values():
        comparison.check(rng)


def _compare_at_a_point(
    block: Block, compare: dict[str, "_Comparison"], rng: random.Random, at_start: bool
) -> None:
    """Draw parameters, inputs and a time; follow the state over a few steps, and disturb it in between."""
    changed = 0.0 if at_start else rng.choice((0.1, 0.5, 1.0))
    p = _drawn(block, "parameter", block.parameters, changed, rng)
    c = compare["calculate"](p)
    required = None if c is None else compare["requirements"](p, c)
    if required is None or not all(holds for holds, _ in required):
        return
    t = 0.0 if at_start else rng.uniform(0.0, block.stop_time)
    x, h = None, p.internal_step * rng.choice((1.0, rng.uniform(0.1, 1.0)))
    for _ in range(_STEPS):
        u = _drawn(block, "input", block.inputs, changed, rng)
        x = compare["initial_state"](t, u, p, c) if x is None else _disturbed(x, rng)
        if x is None:
            return
        compare["output"](t, x, p, c)
        x, t = compare["step"](t, h, x, u, p, c), t + h


class _Comparison:
    """A function of a block beside its traced form."""

    def __init__(self, block: Block, name: str) -> None:
        self._python: Callable[..., Any] = getattr(block, name)
        self._traced = getattr(traced(block), name)
        self._where = f"block {block.name!r}: {location(self._python)}{name}"
        self._calls: list[tuple[Sequence[Any], Any, list[float]]] = []  # arguments, result, its numbers
        self._errors: list[tuple[Sequence[Any], Exception]] = []  # arguments without a result
        self._attempts = 0

    def __call__(self, *arguments: Any) -> Any:
        """What the Python function returns; None where that is no finite number."""
        self._attempts += 1
        result, numbers = self._evaluate(arguments)
        if numbers is not None:
            self._calls.append((arguments, result, numbers))
        return result

    def _evaluate(self, arguments: Sequence[Any]) -> tuple[Any, list[float] | None]:
        try:
            result = self._python(*arguments)
            values = flatten(result) if is_dataclass(result) else [holds for holds, _ in result]
            if any(isinstance(value, complex) or not math.isfinite(value) for value in values):
                return None, None
        except (ArithmeticError, ValueError) as error:
            self._errors.append((arguments, error))
            return None, None
        except Exception as error:
            raise ExportError(f"{self._where} raises {_described(error)}") from error
        return result, list(map(float, values))

    def check(self, rng: random.Random) -> None:
        """ExportError for the first point where the function differs, or if too few can be compared."""
        if self._attempts and not self._calls:
            last = f": {_described(self._errors[-1][1])}" if self._errors else ""
            raise ExportError(
                f"{self._where} gives no finite numbers at any of {self._attempts} random points{last}"
            )
        self._check_errors()
        amplified = 0
        for (arguments, result, numbers), given in zip(
            self._calls, self._traced_numbers([a for a, _, _ in self._calls]), strict=True
        ):
            again = self._evaluate(arguments)[1] or [math.nan] * len(numbers)
            exactly = [0.0] * len(numbers)
            self._compare(result, numbers, again, exactly, "at one call and {} at another, same arguments")
            rounding = [_EQUAL * max(abs(x), abs(y)) for x, y in zip(numbers, given, strict=True)]
            if not all(map(_are_near, numbers, given, rounding)):
                amplified += 1
                moved = self._moved(arguments, numbers, rng)
                allowed = [max(a, _AMPLIFIED * b) for a, b in zip(rounding, moved, strict=True)]
                self._compare(result, numbers, given, allowed, "in Python and {} when it is traced")
        if amplified > _MOST_AMPLIFIED * len(self._calls):
            raise ExportError(
                f"{self._where} differs when traced at {amplified} of {len(self._calls)} points"
            )

    def _check_errors(self) -> None:
        """ExportError where Python divides by zero or leaves a domain, and compiled code gives numbers.

        Not where a number is too large for Python, which compiled code takes for infinite.
        """
        errors = [(a, error) for a, error in self._errors if not isinstance(error, OverflowError)]
        results = self._traced_numbers([arguments for arguments, _ in errors])
        for (_, error), numbers in zip(errors, results, strict=True):
            if all(map(math.isfinite, numbers)):
                raise ExportError(
                    f"{self._where} raises {_described(error)}, where compiled code gives numbers; give an "
                    "alternative of fmus.numerics.where that is not always legal as a function: lambda: ..."
                )

    def _traced_numbers(self, calls: list[Sequence[Any]]) -> list[list[float]]:
        """What the traced function gives for all arguments, in one call."""
        if not calls:
            return []
        columns = zip(*(map(flatten, arguments) for arguments in calls), strict=True)
        matrices = [np.array(scalars, float).reshape(len(calls), -1).T for scalars in columns]
        return self._traced.map(len(calls))(*matrices).full().T.tolist()

    def _moved(self, arguments: Sequence[Any], numbers: Sequence[float], rng: random.Random) -> list[float]:
        """How far the numbers move when the arguments change by roundings."""
        moved = [0.0] * len(numbers)
        for _ in range(_PERTURBATIONS):
            other = self._evaluate([_rounded(argument, rng) for argument in arguments])[1] or numbers
            moved = [max(most, abs(x - y)) for most, x, y in zip(moved, other, numbers, strict=True)]
        return moved

    def _compare(
        self, result: Any, numbers: list[float], others: list[float], allowed: list[float], how: str
    ) -> None:
        """ExportError for the first number that is not near the other; `how` says where that is from."""
        names = _names(result) if is_dataclass(result) else (f"({text})" for _, text in result)
        for name, x, y, difference in zip(names, numbers, others, allowed, strict=True):
            if not _are_near(x, y, difference):
                raise ExportError(f"{self._where} gives {name} = {x!r} {how.format(repr(y))}")


def _described(error: Exception) -> str:
    """What is raised, and in which line of the user's."""
    own = own_line(error)
    return f"{error!r} at {own[0]}:{own[1]}: {own[2]}" if own else repr(error)


def _are_near(x: float, y: float, allowed: float) -> bool:
    return abs(x - y) <= allowed  # False for NaN


def _drawn(block: Block, causality: str, template: type, changed: float, rng: random.Random) -> Any:
    """Parameters or inputs, of which a part is not at the start value."""
    variables = block.of_causality(causality)
    return unflatten(template, [_draw(v, rng) if rng.random() < changed else v.start for v in variables])


def _draw(v: ScalarVariable, rng: random.Random) -> Any:
    """A permitted value: near the start value, anywhere in the range, at its ends, or a special one."""
    if v.enumeration:
        return rng.choice(list(v.enumeration))
    if v.type == "Boolean":
        return rng.random() < 0.5
    low, high = (v.minimum, v.maximum)
    low, high = (v.start - 10 if low is None else low), (v.start + 10 if high is None else high)
    if v.type == "Integer":
        return rng.randint(int(low), int(high))
    near = v.start * rng.uniform(0.5, 1.5) + (0.0 if v.start else rng.uniform(-1.0, 1.0))
    anywhere = (
        math.exp(rng.uniform(math.log(low), math.log(high))) if 0.0 < low < high else rng.uniform(low, high)
    )
    value = rng.choice((near, near, anywhere, rng.choice((low, high)), rng.choice(_SPECIAL)))
    return float(min(max(value, low), high))


def _changed_numbers(value: Any, change: Callable[[float], float]) -> Any:
    """A dataclass or number whose floats are changed."""
    scalars = [change(x) if isinstance(x, float) else x for x in flatten(value)]
    return unflatten(value, scalars)


def _disturbed(state: Any, rng: random.Random) -> Any:
    def change(x: float) -> float:
        return rng.choice((x, x, x * rng.uniform(0.5, 1.5), x + rng.uniform(-1.0, 1.0), rng.choice(_SPECIAL)))

    return _changed_numbers(state, change)


def _rounded(argument: Any, rng: random.Random) -> Any:
    return _changed_numbers(argument, lambda x: x * (1.0 + rng.choice((-2, -1, 0, 1, 2)) * _ULP))


def _names(value: Any, name: str = "") -> Iterator[str]:
    """Names of the scalars of a dataclass, in the order of `flatten`."""
    if isinstance(value, tuple):
        for i, element in enumerate(value):
            yield from _names(element, f"{name}[{i + 1}]")
    elif is_dataclass(value):
        for field in fields(value):
            yield from _names(getattr(value, field.name), f"{name}.{field.name}".lstrip("."))
    else:
        yield name

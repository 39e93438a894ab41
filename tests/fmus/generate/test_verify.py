"""A block whose trace would not be what its Python functions compute is refused; every other one is built."""

import functools
import gc
import inspect
import math
import random
import re
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from enum import IntEnum
from itertools import count
from types import FrameType, FunctionType
from typing import Any

import casadi
import numpy as np
import pytest

from fmus import numerics
from fmus.block import Block, variable
from fmus.errors import ExportError
from fmus.generate import builder
from fmus.generate.operations import with_roundings
from fmus.generate.trace import Traced, trace
from fmus.generate.verify import check_trace
from tests.shared_builds import slow_but


class Mode(IntEnum):
    """A choice."""

    SLOW = 1
    FAST = 2


@dataclass(frozen=True)
class Parameters:
    internal_step: float = variable(0.1, "Longest internal step", unit="s", min=1e-3, max=1.0)
    mode: Mode = variable(Mode.SLOW, "Mode")
    flag: bool = variable(False, "Flag")
    number: int = variable(2, "Number", min=1, max=5)


@dataclass(frozen=True)
class Inputs:
    u: float = variable(0.25, "Input")


@dataclass(frozen=True)
class State:
    x: float = 0.5


@dataclass(frozen=True)
class Outputs:
    y: float = variable(0.0, "Output")


Rule = Callable[[float, float, Parameters], Any]  # of u, x and the parameters: the next x


def block_of(rule: Rule) -> Block:
    return Block(
        name="Trial",
        description="A rule for the next state",
        parameters=Parameters,
        inputs=Inputs,
        state=State,
        outputs=Outputs,
        initial_state=lambda t, inputs, p, c: State(),
        step=lambda t, h, state, inputs, p, c: State(rule(inputs.u, state.x, p)),
        output=lambda t, state, p, c: Outputs(state.x),
    )


def branch(u: float, x: float, p: Parameters) -> float:
    if u > 0.0:
        return x
    return -x


def assigns(u: float, x: float, p: Parameters) -> float:
    global LAST  # noqa: PLW0603
    LAST = 1.0
    return x + LAST


def first_is_remembered(u: float, x: float, p: Parameters, memory: dict[str, float] = {}) -> float:  # noqa: B006
    return x + memory.setdefault("first", u)


def catches(u: float, x: float, p: Parameters) -> float:
    try:
        return math.tanh(x)
    except TypeError:
        return x


def halves_while_large(u: float, x: float, p: Parameters) -> float:
    while x > 0.1:
        x = 0.5 * x
    return x


def asserts(u: float, x: float, p: Parameters) -> float:
    assert u > 0.0
    return x


class Counter:
    calls = 0

    def __call__(self, u: float, x: float, p: Parameters) -> float:
        self.calls += 1
        return x + self.calls


LAST = 0.0
NUMBERS = count()
GAINS = {Mode.SLOW: 1.0, Mode.FAST: 10.0}
GENERATOR = np.random.default_rng(1)


@functools.cache
def cached(u: float) -> float:
    return u + 1.0


AT_ANOTHER = "step gives x = .* at one call and .* at another, same arguments"
IN_PYTHON = "step gives x = .* in Python and .* when it is traced"
DIVISION = r"ZeroDivisionError\('float division by zero'\) at .*:\d+"
SHAPES = r"test_verify.py:\d+: .*TypeError: alternatives"
REFUSED: list[tuple[Rule, str]] = [
    (lambda u, x, p: math.tanh(x), r"math.tanh\(x\): a number is needed.*use fmus.numerics.tanh$"),
    (lambda u, x, p: x + math.floor(math.exp(u)), r"math.exp\(u\): a number is needed.*fmus.numerics.exp$"),
    (lambda u, x, p: math.fabs(u), r"use fmus.numerics.absolute$"),
    (lambda u, x, p: math.pow(u, 2.0), r"use fmus.numerics.power$"),
    (lambda u, x, p: x * float(u), r"float\(u\): a number is needed.*; leave it out$"),
    (lambda u, x, p: float(np.float64(u)), r"np.float64\(u\): a NumPy array is .*; leave it out$"),
    (lambda u, x, p: complex(u).real, r"complex\(u\): a number is needed"),
    (lambda u, x, p: float(int(u)), r"int\(u\): an integer is needed.*use fmus.numerics.trunc$"),
    (branch, r"u > 0.0: a truth value is needed.*use fmus.numerics.where$"),
    (lambda u, x, p: x if p.flag else u, r"x if p.flag else u: a truth value is needed.*numerics.where$"),
    (lambda u, x, p: u and x, r"u and x: a truth value is needed.*numerics.logical_and$"),
    (lambda u, x, p: x if 0.0 < u < 1.0 else u, r"a truth value is needed.*numerics.logical_and$"),
    (lambda u, x, p: x if p.mode == Mode.FAST else u, r"p.mode == Mode.FAST: a truth value is needed"),
    (lambda u, x, p: x if u in (1.0, 2.0) else u, r"u in \(1.0, 2.0\): a truth value .*numerics.any$"),
    (lambda u, x, p: max(x, u), r"max\(x, u\): a truth value is needed.*use fmus.numerics.maximum$"),
    (lambda u, x, p: min(x, u), r"use fmus.numerics.minimum$"),
    (lambda u, x, p: sorted((x, u))[0], r"sorted\(\(x, u\)\): a truth value .*numerics.minimum$"),
    (lambda u, x, p: GAINS[p.mode] * x, r"GAINS\[p.mode\]: a key is needed.*use fmus.numerics.select$"),
    (lambda u, x, p: GAINS.get(p.mode, 5.0) * x, r"GAINS.get\(p.mode, 5.0\): a key is needed"),
    (lambda u, x, p: cached(u), r"cached\(u\): a key is needed"),
    (lambda u, x, p: float(round(u)), r"round\(u\): Python's is of a number.*numerics.round$"),
    (lambda u, x, p: np.sin(x), r"np.sin\(x\): NumPy's functions are of numbers.*use fmus.numerics.sin$"),
    (lambda u, x, p: np.clip(x, 0.0, u), r"NumPy's functions are of numbers.*use fmus.numerics.clip$"),
    (lambda u, x, p: np.where(x > 0.0, x, u), r"NumPy's functions are of numbers.*fmus.numerics.where$"),
    (lambda u, x, p: np.dot([x, u], [1.0, 2.0]), r"a NumPy array is needed.*use fmus.numerics.matmul$"),
    (lambda u, x, p: np.add(x, np.ones(2))[0], r"np.add\(.*NumPy's functions are of numbers"),
    (
        lambda u, x, p: GAIN if f"{u:.1f}" else u,
        r"a text is needed, but .*; leave it out, or call .* in a test",
    ),
    (lambda u, x, p: [x, u][p.mode], r"\[x, u\]\[p.mode\]: an integer is needed.*fmus.numerics.choose$"),
    (lambda u, x, p: x[0], r"x\[0\]: a sequence is needed, but the value is not known"),  # type: ignore[index]
    (lambda u, x, p: sum(v for v in u), r"a sequence is needed, but the value is not known"),  # type: ignore[misc]
    (lambda u, x, p: x if (u > 0.0) & (x > 0.0) else u, r"a truth value is needed.*numerics.logical_and$"),
    (lambda u, x, p: x if (u > 0.0) | p.flag else u, r"a truth value is needed.*numerics.logical_or$"),
    (lambda u, x, p: x if (u > 0.0) ^ p.flag else u, r"a truth value is needed.*numerics.logical_xor$"),
    (lambda u, x, p: x if not p.flag else u, r"if not p.flag else u: a truth value is needed"),
    (lambda u, x, p: numerics.where(~p.flag, x, u), r"~p.flag: a truth value is .*numerics.logical_not$"),
    (lambda u, x, p: math.gamma(u), r"math.gamma\(u\): a number is .*; compute it from constants alone$"),
    (lambda u, x, p: x if math.isnan(u) else u, r"leave it out: a step whose results are not finite is"),
    (halves_while_large, r"x > 0.1: a truth value is needed.*; use for with a constant number of turns, and"),
    (asserts, r"u > 0.0: a truth value is needed.*; use the requirements of the block$"),
    (lambda u, x, p: setattr(p, "flag", x), r"setattr\(p, \"flag\", x\): FrozenInstanceError: cannot"),
    (lambda u, x, p: {"a": x}["b"], r"\{\"a\": x\}\[\"b\"\]: KeyError: 'b'$"),
    (lambda u, x, p: u % 0.1, r"u % 0.1: Python and compiled code differ.*use fmus.numerics.fmod$"),
    (lambda u, x, p: 0.1 % u, r"use fmus.numerics.fmod$"),
    (lambda u, x, p: u // 0.1, r"u // 0.1: .*use fmus.numerics.floor$"),
    (lambda u, x, p: divmod(u, 0.1)[1], r"use fmus.numerics.fmod$"),
    (
        lambda u, x, p: sum(x for _ in range(p.number)),
        r"range\(p.number\): an int.*constant number of turns$",
    ),
    (lambda u, x, p: x + random.random(), r"random.random\(\): random gives another value at each call"),
    (lambda u, x, p: x + random.gauss(0.0, 1.0), r"random.gauss\(0.0, 1.0\): random gives another value"),
    (lambda u, x, p: x + time.time(), r"time.time\(\): time gives another value at each call"),
    (lambda u, x, p: x + time.monotonic() // 3600, r"monotonic gives another value at each call"),
    (lambda u, x, p: x + datetime.now().year, r"now gives another value at each call"),
    (assigns, r"the global LAST is assigned, but an FMU has no memory beside its state"),
    (lambda u, x, p: numerics.where(u == 0.0, 0.0, x / u), rf"{DIVISION}: x / u, where .*: lambda: \.\.\.$"),
    (lambda u, x, p: numerics.minimum(1.0 / u, 5.0), r"ZeroDivisionError.*where compiled code gives numbers"),
    (lambda u, x, p: x + 1.0 / 0.0, r"1.0 / 0.0: ZeroDivisionError: float division by zero$"),
    (lambda u, x, p: x / 0.0, r"no finite numbers at any of \d+ random points: ZeroDivi.*: x / 0.0$"),
    (
        lambda u, x, p: numerics.where(u > 0.0, x, (1.0, 2.0)),
        rf"{SHAPES} a number and a tuple of 2: expected",
    ),
    (
        lambda u, x, p: numerics.where(u > 0.0, (x, u), (1.0, 2.0, 3.0)),
        rf"{SHAPES} a tuple of 2 and a tuple of 3: expected two of",
    ),
    (
        lambda u, x, p: numerics.where(u > 0.0, (x, (u, x)), (x, u)),
        rf"{SHAPES} a tuple of 2 and a number at \[1\]: expected",
    ),
    (
        lambda u, x, p: numerics.where(u > 0.0, (x, (u, (x, x))), (x, (u, (x,)))),
        rf"{SHAPES} a tuple of 2 and a tuple of 1 at \[1\]\[1\]: expected two of one shape",
    ),
    (
        lambda u, x, p: numerics.interp(u, (1.0, 0.0), (0.0, 1.0)),
        r"ValueError: points .*: expected ascending",
    ),
    (lambda u, x, p: numerics.matmul(((1.0, 2.0, 3.0),), (u, x)), r"matmul of 1 x 3 and a vector of 2: expe"),
    (lambda u, x, p: numerics.solve(((1.0, 2.0, u),) * 2, (u, x)), r"solve of 2 x 3 and .* a square matrix"),
    (lambda u, x, p: (u, x) @ (x, u), r"operand type.* for @: 'tuple'.*; use fmus.numerics.matmul$"),  # type: ignore[operator]
]
REFUSED_RESULTS: list[tuple[Rule, str]] = [
    (lambda u, x, p: x + GENERATOR.random(), AT_ANOTHER),
    (lambda u, x, p: x + next(NUMBERS), AT_ANOTHER),
    (lambda u, x, p: 1.0 + 1e-15 * next(NUMBERS), AT_ANOTHER),
    (Counter(), AT_ANOTHER),
    (lambda u, x, p: x if p.mode is Mode.FAST else u, IN_PYTHON),
    (lambda u, x, p: x if isinstance(u, float) else u, IN_PYTHON),
    (lambda u, x, p: (u + 2.0**52) - 2.0**52, IN_PYTHON),
    (catches, IN_PYTHON),
    (first_is_remembered, r"step depends on an earlier call; an FMU has no memory beside its st"),
    (lambda u, x, p: numerics.where(u > 0.0, x, math.nan), r"step holds a constant that is not a number"),
    (
        lambda u, x, p: [x, u][5 if type(u) is float else 0],
        r"step raises IndexError\('list index out of range'\) at .*test_verify.py:\d+: \[x, u\]\[5",
    ),
    (lambda u, x, p: np.array([u, x]) if type(u) is float else u, r"step raises TypeError\(.*only"),
    (lambda u, x, p: (x, u), r"step returns State.x as a tuple: expected one number"),
    (lambda u, x, p: np.eye(2)[0], r"step returns State.x as a ndarray: expected one number"),
]


@pytest.mark.parametrize(("rule", "message"), REFUSED, ids=range(len(REFUSED)))
def test_a_line_that_cannot_be_traced_faithfully_is_refused(rule: Rule, message: str) -> None:
    with pytest.raises(ExportError, match=f"^block 'Trial'.*{message}") as refusal:
        check_trace(trace(block_of(rule)))
    code, start = inspect.getsourcelines(rule)
    named = int(re.findall(rf"{re.escape(__file__)}:(\d+)", str(refusal.value))[-1])
    assert start <= named < start + len(code)


@pytest.mark.parametrize(("rule", "message"), REFUSED_RESULTS, ids=range(len(REFUSED_RESULTS)))
def test_a_function_that_cannot_be_traced_faithfully_is_refused(rule: Rule, message: str) -> None:
    with pytest.raises(ExportError, match=f"^block 'Trial'.*{message}"):
        check_trace(trace(block_of(rule)))


def changes_its_argument(t: float, h: float, state: State, inputs: Inputs, *_: object) -> State:
    object.__setattr__(state, "x", state.x + inputs.u)
    return state


@pytest.mark.parametrize(
    ("step", "message"),
    [
        (lambda *_: Inputs(), r"step returns Inputs: expected State\(\.\.\.\)"),
        (
            changes_its_argument,
            "a function changes its arguments or depends on an earlier call; an",
        ),
    ],
)
def test_a_step_that_gives_another_class_or_changes_its_argument_is_refused(
    step: Callable[..., Any], message: str
) -> None:
    with pytest.raises(ExportError, match=message):
        check_trace(trace(replace(block_of(branch), step=step)))


def test_a_difference_names_file_and_line_of_the_function_and_both_values() -> None:
    block = block_of(lambda u, x, p: 1.0 if isinstance(u, float) else 2.0)
    with pytest.raises(ExportError) as refusal:
        check_trace(trace(block))
    position = f"{__file__}:{inspect.getsourcelines(block.step)[1]}"
    assert f"{position}: step gives x = 1.0 in Python and 2.0 when it is traced" in str(refusal.value)


def collector_starts(phase: str, info: dict[str, int]) -> None:
    """As a library may register it."""
    exec("global STARTED; import time; STARTED = time.time()", {"__name__": "a_library"})


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_what_the_garbage_collector_calls_meanwhile_is_not_the_blocks() -> None:
    def collects(u: float, x: float, p: Parameters) -> float:
        if not isinstance(u, float):  # while it is traced
            gc.collect()
        return x

    gc.callbacks.append(collector_starts)
    try:
        check_trace(trace(block_of(collects)))
    finally:
        gc.callbacks.remove(collector_starts)


GAIN = 3.0

ACCEPTED: list[Rule] = [
    lambda u, x, p: GAIN * x + math.sqrt(2.0) * math.pi * u,
    lambda u, x, p: max(GAIN, 1.0) * x if GAIN > 0.0 else u,
    lambda u, x, p: sum([gain * x for gain in (1.0, 2.0)]) + {"a": 1.0}["a"],
    lambda u, x, p: x**2 + abs(u) ** 0.5 - x / 3.0,
    lambda u, x, p: x + p.number + p.flag + p.mode,
    lambda u, x, p: numerics.where(p.mode == Mode.FAST, numerics.tanh(u), numerics.atan2(u, x)),
    lambda u, x, p: numerics.where(
        numerics.logical_and(p.flag, u < x), numerics.fmod(u, 0.1), numerics.ceil(x)
    ),
    lambda u, x, p: numerics.where(u == 0.0, 0.0, lambda: x / u),
    lambda u, x, p: numerics.select([u > 0.0, u < 0.0], [lambda: x / u, lambda: numerics.sqrt(-u)], x),
    lambda u, x, p: 1.0 / (1.0 + numerics.exp(-100.0 * u)),  # too large for Python, infinite when compiled
    lambda u, x, p: np.float64(2.0) * x + u / np.float64(3.0),
    lambda u, x, p: math.prod((x, u, 2.0)) + math.floor(x) - abs(u),
    lambda u, x, p: numerics.log(u),  # refused for u <= 0 by Python, not finite when it is traced
    lambda u, x, p: numerics.sin(1e6 * u) - numerics.sin(1e6 * u + 1e-9),
    # rounded by Python, simplified when it is traced
    lambda u, x, p: numerics.where(p.number == 5, (u + 1e9) - 1e9, u),
]


@pytest.mark.parametrize("rule", ACCEPTED, ids=range(len(ACCEPTED)))
def test_a_faithful_block_is_accepted(rule: Rule) -> None:
    check_trace(trace(block_of(rule)))


def test_a_sine_of_a_large_angle_is_as_exact_as_pi_in_casadi_s_wheel_for_windows() -> None:
    """There sin(1e12) differs by 1.02e-9 from this machine's, and sin(1e18) by 1.5e-4."""
    x = casadi.SX.sym("x")
    function = with_roundings(casadi.Function("f", [x], [casadi.sin(x)]))
    errors = np.full(function.size_in(1), 2.0**-52)
    for angle, least, most in [(1.0, 1e-16, 1e-15), (1e12, 1.02e-9, 1e-7), (1e18, 1.5e-4, 1.0)]:
        assert least < abs(function(angle, errors) - function(angle, 0.0 * errors)) < most
    assert abs(function(1e300, errors)) <= 1.0


@dataclass(frozen=True)
class ThreeInputs:
    u: float = variable(1.0, "Input")
    v: float = variable(1.0, "Input")
    w: float = variable(1.0, "Input")


@pytest.mark.parametrize("name", ["u", "v", "w"])
def test_a_division_by_zero_where_one_input_is_0_at_the_start_is_refused(name: str) -> None:
    """At no other point: other inputs have their start values, which random points hardly meet."""

    def step(t: float, h: float, state: State, inputs: ThreeInputs, p: Parameters, c: object) -> State:
        away = [x - (other != name) for other, x in vars(inputs).items()]
        square = sum(x * x for x in away) + t * t
        return State(numerics.where(square == 0.0, 0.0, state.x / square))

    block = replace(block_of(branch), inputs=ThreeInputs, step=step)
    with pytest.raises(ExportError, match=r"ZeroDivisionError.*state\.x / square, where compiled code gives"):
        check_trace(trace(block))


def test_a_block_is_compared_at_the_same_points_whatever_its_name() -> None:
    points: dict[str, list[tuple[float, float]]] = {"Trial": [], "Other": []}

    def recording(name: str) -> Rule:
        def rule(u: float, x: float, p: Parameters) -> float:
            if isinstance(u, float):
                points[name].append((u, x))
            return u + x

        return rule

    for name in points:
        check_trace(trace(replace(block_of(recording(name)), name=name)))
    assert points["Trial"]
    assert points["Trial"] == points["Other"]


def observed_where(condition: Any, if_true: Any, if_false: Any) -> Any:
    observe(condition, sys._getframe(1))  # type: ignore[name-defined] # noqa: F821
    return observed(condition, if_true, if_false)  # type: ignore[name-defined] # noqa: F821


@pytest.mark.parametrize(
    "name", slow_but(("L1Controller", "L1DepthController", "ExamplePlant"), builder.block_names())
)
def test_every_block_is_faithful_and_takes_its_branches_both_ways(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    block, outcomes = builder.load_block(name), dict[str, set[bool]]()

    def observe(condition: object, caller: FrameType) -> None:
        position = f"{caller.f_code.co_filename}:{caller.f_lineno}"
        if isinstance(condition, bool):
            outcomes.setdefault(position, set()).add(condition)

    # modules hold the function itself: its code is replaced, which finds these names in its module
    where = numerics.where
    names = {"observe": observe, "observed": FunctionType(where.__code__, where.__globals__), "sys": sys}
    for own_name, value in names.items():
        monkeypatch.setitem(where.__globals__, own_name, value)
    monkeypatch.setattr(where, "__code__", observed_where.__code__)
    check_trace(trace(block))
    assert outcomes or name == "ExamplePlant"  # which is linear
    assert {position for position, both in outcomes.items() if both != {True, False}} == set()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed"),
    [
        pytest.param("L1HeavePitchController", 6, marks=pytest.mark.slow),
        ("L1DepthController", 4),
        ("BlueRov2Plant", 8),
    ],
)
def test_a_block_is_faithful_at_any_random_points(name: str, seed: int) -> None:
    """Where sums cancel, a branch is near, and a derivative is finite in place of a jump."""
    check_trace(trace(builder.load_block(name)), seed)


def with_wrong_branches(block: Block, line: str | None = None) -> tuple[Traced, set[str]]:
    """Traces a block with the alternatives of all choices of a line exchanged.

    Returns the functions, and the lines with choices.
    """
    if_else, lines = casadi.if_else, set[str]()

    def exchanged(condition: casadi.SX, if_true: casadi.SX, if_false: casadi.SX) -> casadi.SX:
        frames = traceback.walk_stack(sys._getframe(1))
        names = (f"{frame.f_code.co_filename}:{number}" for frame, number in frames)
        caller = next(name for name in names if not re.search(r"numerics.(choice|symbols)\.py", name))
        lines.add(caller)
        return if_else(condition, *((if_false, if_true) if caller == line else (if_true, if_false)))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(casadi, "if_else", exchanged)
        return trace(block), lines


def serialized(traced: Traced) -> list[str]:
    return [function.serialize() for function in traced.functions().values()]


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["ThrustAllocation", "PidDepthController"],
)
def test_a_wrong_branch_of_the_traced_form_is_refused(name: str) -> None:
    block, accepted = builder.load_block(name), []
    right, lines = with_wrong_branches(block)
    for line in lines:
        wrong, _ = with_wrong_branches(block, line)
        if serialized(wrong) == serialized(right):  # no result takes it
            continue
        try:
            check_trace(wrong)
            accepted.append(line)
        except ExportError:
            continue
    assert accepted == []


@dataclass(frozen=True)
class Level:
    x: float = variable(0.5, "Level, at most 1 and at least -1")


def _rate(t: float, state: Level, inputs: Inputs, *_: Any) -> Level:
    inward = numerics.where(state.x > 0.0, numerics.minimum(inputs.u, 0.0), numerics.maximum(inputs.u, 0.0))
    is_inside = numerics.minimum(1.0 - state.x, 1.0 + state.x)
    return Level(numerics.where(is_inside > 0.0, inputs.u, numerics.where(is_inside < 0.0, 0.0, inward)))


def _limited(t: float, h: float, state: Level, inputs: Inputs, *_: Any) -> Level:
    return Level(numerics.clip(state.x + h * inputs.u, -1.0, 1.0))


def _limited_by_a_quotient(t: float, h: float, state: Level, inputs: Inputs, *_: Any) -> Level:
    share = numerics.where(h > 0.0, (1.0 - numerics.exp(-h)) / h, 1.0)
    return Level(numerics.clip(state.x + h * share * inputs.u, -1.0, 1.0))


@pytest.mark.parametrize("integrate", [_limited, _limited_by_a_quotient])
@pytest.mark.parametrize("start", [0.25, 1.0, -1.0])
def test_an_integration_with_a_limit_is_compared_by_the_slope_that_its_step_takes(
    integrate: Callable[..., Level], start: float
) -> None:
    """Also at the limit itself, where the slopes of both sides differ."""

    def block(rate: Callable[..., Level]) -> Block:
        return Block(
            "Limited", "A level with limits", parameters=Parameters, inputs=Inputs, outputs=Outputs,
            state=Level, continuous=Level, step_size=0.1, initial_state=lambda *_: Level(start),
            derivative=rate, integrate=integrate, step=lambda t, h, state, *_: state,
            output=lambda t, state, *_: Outputs(state.x),
        )  # fmt: skip

    check_trace(trace(block(_rate)))
    with pytest.raises(ExportError, match="as the rate of the function integrate"):
        check_trace(trace(block(lambda *arguments: Level(1.001 * _rate(*arguments).x))))


@dataclass(frozen=True)
class Ranged:
    x: float = variable(0.5, "Level", unit="m", min=0.0, max=2.0)
    rest: float = 0.5


def ranged(rule: Callable[[float, float], Any], first: float = 0.5) -> Block:
    """A block with a rule for the next x, of the input and x."""
    return replace(
        block_of(lambda u, x, p: x),
        state=Ranged,
        initial_state=lambda t, inputs, p, c: Ranged(first + 0.0 * t),
        step=lambda t, h, state, inputs, p, c: Ranged(rule(inputs.u, state.x), state.rest + 1.0),
        output=lambda t, state, p, c: Outputs(state.x),
    )


@pytest.mark.parametrize(
    ("block", "message"),
    [
        (
            ranged(lambda u, x: x + 0.0625),
            r"step gives x = 2.\d+: expected 0 to 2 m at t = .*, h = .*x = ",
        ),
        (
            ranged(lambda u, x: numerics.clip(u, -1.0, 1.0)),
            r"step gives x = -.*: expected 0 to 2 m at t = .*u = ",
        ),
        (ranged(lambda u, x: x, 3.0), r"initial_state gives x = 3.0: expected 0 to 2 m at t = 0.0$"),
        (
            ranged(lambda u, x: 0.1 / (x + 0.1) + 0.0 / x),
            r"step gives no finite number for a state in its range at .*x = 0.0",
        ),
    ],
)
def test_a_step_that_leaves_the_declared_range_of_a_state_is_refused(block: Block, message: str) -> None:
    with pytest.raises(ExportError, match=message):
        check_trace(trace(block))


@pytest.mark.parametrize(
    "block",
    [
        ranged(lambda u, x: numerics.clip(x + u, 0.0, 2.0)),
        # a state without a range may end a step
        block_of(lambda u, x, p: 1.0 / x),
    ],
)
def test_a_step_that_stays_in_the_declared_ranges_is_accepted(block: Block) -> None:
    check_trace(trace(block))

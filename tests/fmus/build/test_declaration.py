"""A mistake in the declaration of a block is one sentence with file, line, class and variable."""

from pathlib import Path

import pytest

from fmus.build import builder
from fmus.errors import ExportError

BLOCK = """\
import math
from dataclasses import dataclass, field

from fmus.block import Block, variable


@dataclass(frozen=True)
class Parameters:
    gain: float = variable(1.0, "Gain", unit="1/s", min=0.0)
    bias: tuple[float, ...] = variable((0.0, 1.0), "Bias", unit="m")


@dataclass(frozen=True)
class Calculated:
    total: float = variable(0.0, "Sum of the bias", unit="m")


@dataclass(frozen=True)
class Inputs:
    u: float = variable(0.0, "Input", unit="m")


@dataclass(frozen=True)
class State:
    x: float = 0.0
    past: tuple[float, ...] = (0.0, 0.0)


@dataclass(frozen=True)
class Outputs:
    y: float = variable(0.0, "Output", unit="m")


def calculate(p):
    return Calculated(p.bias[0] + p.bias[1])


def initial_state(t, u, p, c):
    return State(u.u)


def step(t, h, s, u, p, c):
    return State(s.x + h * p.gain * (u.u - s.x), (s.x, s.past[0]))


def output(t, s, p, c):
    return Outputs(s.x + c.total)


LAG = Block(
    "Lag", "A lag", parameters=Parameters, calculated=Calculated, inputs=Inputs, state=State, outputs=Outputs,
    calculate=calculate, initial_state=initial_state, step=step, output=output,
)
"""
GAIN, BIAS, U = (
    'gain: float = variable(1.0, "Gain", unit="1/s", min=0.0)',
    'bias: tuple[float, ...] = variable((0.0, 1.0), "Bias", unit="m")',
    'u: float = variable(0.0, "Input", unit="m")',
)
STEP = "return State(s.x + h * p.gain * (u.u - s.x), (s.x, s.past[0]))"

# what is written -> what is written instead, and what is said of it
MISTAKES = [
    (
        GAIN,
        'gain: str = variable("fast", "Gain")',
        "Parameters.gain: start 'fast' is of the type str: expected a",
    ),
    (
        GAIN,
        "gain: float",
        'Parameters.gain: expected a declaration, gain: float = variable(0.0, "What it is"',
    ),
    (GAIN, "gain: float = 1.0", "Parameters.gain: expected a declaration, gain: float = variable(0.0"),
    (
        GAIN,
        'gain: float = variable(1, "Gain")',
        "Parameters.gain: start 1 is an int, but the type is float: ",
    ),
    (
        GAIN,
        'gain: float = variable(math.nan, "Gain")',
        "Parameters.gain: start nan: expected a finite number",
    ),
    (
        GAIN,
        'gain: bool = variable(0, "Gain")',
        "Parameters.gain: start 0 is an int, but the type is bool: write True or False",
    ),
    (
        GAIN,
        'gain: int = variable(2.0, "Gain")',
        "Parameters.gain: start 2.0 is a float, but the type is int: write a whole number such as 1",
    ),
    (GAIN, 'gain: int = variable(True, "Gain")', "start True is a bool, but the type is int: "),
    (GAIN, 'gain: float = variable(True, "Gain")', "start True is a bool, but the type is float: "),
    (BIAS, 'bias: tuple[int, ...] = variable((0, 1.0), "Bias")', "start 1.0 is a float, but the type is int"),
    (
        GAIN,
        'gain: int = variable(1, "Gain", unit="m")',
        "Parameters.gain: unit 'm': expected none, only a Real has a unit; start 1 is no float",
    ),
    (
        BIAS,
        'bias: tuple[int, ...] = variable((0, 1), "Bias", unit=("m", "1"))',
        "Parameters.bias: unit 'm': expected none",
    ),
    ("x: float = 0.0", "x: bool = 0", "State.x: start 0 is an int, but the type is bool: "),
    (GAIN, 'gain: float = variable(1.0, "Gain", min=2.0)', "Parameters.gain: start 1.0: expected 2.0..inf"),
    (
        GAIN,
        'gain: float = variable(1.0, "Gain", min=2.0, max=0.0)',
        "Parameters.gain: min 2.0 is above max 0.0",
    ),
    (
        GAIN,
        'gain: float = variable(1.0, "Gain", unit="1/sek")',
        "Parameters.gain: unknown unit '1/sek': no unit 'sek'; nearest is 'sec'",
    ),
    (
        GAIN,
        'gain: float = variable(1.0, "Gain", unit="m", display_unit="s")',
        "Parameters.gain: display unit 's': expected one of the dimension of 'm'",
    ),
    (
        GAIN,
        'gain: float = variable(1.0, "Gain", variability="constant")',
        "Parameters.gain: variability 'constant': expected 'fixed' or 'tunable'",
    ),
    (GAIN, 'größe: float = variable(1.0, "Gain")', "Parameters.größe: expected ASCII letters"),
    (
        BIAS,
        'bias: tuple = variable((0.0, 1.0), "Bias", unit=("m",))',
        "Parameters.bias: unit ('m',): expected one value, or a tuple of the shape of (0.0, 1.0)",
    ),
    (
        BIAS,
        'bias: float = variable((0.0, 1.0), "Bias")',
        "Parameters.bias: start (0.0, 1.0) is a tuple, but the type is float",
    ),
    (
        BIAS,
        'bias: int = variable(2**31, "Bias")',
        "Parameters.bias: start 2147483648: expected -2147483648..2147483647, as in FMI",
    ),
    (
        BIAS,
        'bias: int = variable(1, "Bias", min=-(2**31) - 1)',
        "bias: min -2147483649: expected -214",
    ),
    (BIAS, 'bias: int = variable(1, "Bias", max=10**400)', "Parameters.bias: max 1000"),
    (BIAS, 'bias: list = variable([0.0, 1.0], "Bias")', "start [0.0, 1.0]: expected a tuple"),
    (U, 'gain: float = variable(0.0, "Input")', "Inputs.gain: expected another name, Parameters has it too"),
    ("x: float = 0.0", "x: float", "State.x: expected a value to start from, x: float = 0.0"),
    (
        "x: float = 0.0",
        'x: float = variable(0.0, "State")',
        "State.x: expected a plain value, x: float = 0.0",
    ),
    (
        "def step(t, h, s, u, p, c):",
        "def step(t, s, u, p, c):",
        "step(t, s, u, p, c): expected 6 arguments, step(t, h, state, inputs, parameters, calculated)",
    ),
    ("def calculate(p):", "def calculate():", "calculate(): expected 1 arguments, calculate(parameters)"),
    (
        "def initial_state(t, u, p, c):\n    return State(u.u)",
        "def initial_state(t, u, p, c):\n    return State(u.u, (0.0,))",
        "initial_state returns State.past as a tuple of 1: expected a tuple of 2",
    ),
    (
        "def initial_state(t, u, p, c):\n    return State(u.u)",
        "def initial_state(t, u, p, c):\n    pass",
        "initial_state returns NoneType: expected State(...)",
    ),
    (
        "def output(t, s, p, c):\n    return Outputs(s.x + c.total)",
        "def output(t, s, p, c):\n    return s.x",
        "output returns a number: expected Outputs(...)",
    ),
    (
        "x: float = 0.0",
        "x: float = field(default=0.0, init=False)",
        "State.x: expected a field without kw_only and init=False",
    ),
    (
        "x: float = 0.0",
        'x: tuple = type("Pair", (tuple,), {})((0.0, 1.0))',
        "State.x: (0.0, 1.0): expected a plain tuple or a frozen dataclass",
    ),
    (
        "x: float = 0.0",
        "x: float = 0.0; __post_init__ = lambda self: 1.0 if self.x < 9.0 else 2.0",
        "self.x < 9.0: a truth value is needed, but",
    ),
    (STEP, STEP.replace("State(", "State(math.nan * "), "step holds a constant that is not a number"),
    (STEP, STEP.replace("u.u", "u.v"), "'Inputs' object has no attribute 'v'"),
    ("state=State", "state=dict", "'Lag': state: expected a class with @dataclass(frozen=True)"),
    (
        '"A lag", param',
        '"A lag", requirements=lambda p, c: (p.gain > 0.0, "a gain"), param',
        """requirements: expected a tuple of pairs, ((condition, "what is expected"), ...), also for one""",
    ),
    ('"A lag"', "['A lag']", "'Lag': description ['A lag']: expected a text"),
    ('"A lag"', '"A lag", stop_time="2"', "'Lag': stop_time '2': expected a number of seconds"),
    (
        '"A lag"',
        '"A lag", stop_time=0.0',
        "'Lag': stop_time 0.0: expected a finite number of seconds above 0",
    ),
    ('"A lag"', '"A lag", step_size=None', "'Lag': step_size None: expected a number of seconds"),
    ('"A lag"', '"A lag", step_size=1e-9', "'Lag': step_size 1e-09: expected 1e-07..1000000.0 s, the range"),
    ("outputs=Outputs", "stop_time=2.0", "missing 1 required keyword-only argument: 'outputs'"),
]


@pytest.mark.parametrize(("right", "wrong", "message"), MISTAKES)
def test_a_mistake_is_named_with_the_line_of_the_file(
    right: str, wrong: str, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "lag.py"
    text = BLOCK.replace(right, wrong)
    path.write_text(text, encoding="utf-8")
    before = text.partition(wrong)[0]
    starts = [before, before.rpartition("\ndef ")[0] + "\n", before.rpartition("\nLAG")[0] + "\n"]
    lines = {start.count("\n") + 1 for start in starts}  # of the mistake, its function or its block
    with pytest.raises(ExportError) as refused, builder.loaded(str(path)):
        pass
    assert message in str(refused.value)
    assert any(f"{path}:{line}: " in str(refused.value) for line in lines), str(refused.value)


def test_the_block_without_a_mistake_is_accepted(tmp_path: Path) -> None:
    path = tmp_path / "lag.py"
    path.write_text(BLOCK)
    with builder.loaded(str(path)) as (block,):
        assert block.name == "Lag"


def test_a_step_size_may_be_a_whole_number_of_seconds(tmp_path: Path) -> None:
    path = tmp_path / "lag.py"
    path.write_text(BLOCK.replace('"A lag"', '"A lag", step_size=1'))
    with builder.loaded(str(path)) as (block,):
        assert {v.name: v.start for v in block.variables}["internal_step"] == 1.0

"""Every function, choice and type of a block has the bits of a single run, the signs of zeros included."""

import itertools
import math
import random
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus import numerics as n
from fmus.block import Block, variable
from fmus.block.random_points import drawn
from fmus.block.scalars import flatten
from fmus.generate.builder import load_block
from fmus.generate.trace import trace
from fmus.platforms import instruction_sets
from fmus.registry import block_names
from orchestration import Ensemble, Event, Experiment, Simulator, System
from orchestration.errors import EnsembleError, OrchestrationError, SimulationError, SystemDefinitionError
from orchestration.many.ensemble_loop import Device
from orchestration.many.lane_library import LANES
from tests.orchestration.many.instances import assert_same_bits, built_for_ensembles, instances
from tests.orchestration.places.host_device import HostDevice

pytestmark = pytest.mark.slow


Engine = tuple[str, Device | None]
ENGINES: list[Engine] = [
    *((name, None) for name in instruction_sets()),
    (instruction_sets()[0], HostDevice()),
]


class Gear(IntEnum):
    """A choice with a gap."""

    LOW = 1
    HIGH = 3


@dataclass(frozen=True)
class Parameters:
    a: float = variable(0.5, "A number")
    is_on: bool = variable(True, "A switch")
    gear: Gear = variable(Gear.LOW, "A choice")


@dataclass(frozen=True)
class Inputs:
    u: float = variable(0.5, "A number")
    asked: Gear = variable(Gear.LOW, "A choice")


@dataclass(frozen=True)
class Sample:
    value: float = 0.0
    clock: n.Clock = n.Clock()


@dataclass(frozen=True)
class State:
    """x: a number of 0..1 that never repeats; count: how often it was large; zero: stays 0"""

    x: float = 0.3
    sample: Sample = Sample()
    count: int = 0
    zero: float = 0.0


def of_one(x: float) -> tuple[float, ...]:
    """The functions of one number, of 0..1."""
    smooth = (n.exp, n.expm1, n.log1p, n.sin, n.cos, n.tan, n.asin, n.acos, n.atan, n.sinh, n.cosh, n.tanh)
    others = (n.sqrt, n.asinh, n.erf, n.floor, n.ceil, n.sign, n.cbrt, n.trunc, n.round, abs)
    return tuple(function(x) for function in (*smooth, *others))


def of_two(x: float, y: float) -> tuple[float, ...]:
    """The functions of two numbers, of 0..1 and any."""
    powers = [n.power(base, exponent) for base, exponent in ((2.0, y), (10.0, y), (x, y), (x, 0.5), (x, 3.0))]
    steps = (n.fmod(y, 0.3), n.fmod(1e6 * y, 7.0), n.fmod(n.floor(1e9 * x), 2147483563.0), n.remainder(y, x))
    limits = (n.minimum(y, 0.0), n.maximum(y, 0.0), n.minimum(-y, y), n.maximum(-y, y), n.clip(y, -0.5, x))
    return (*powers, *steps, *limits, n.atan2(y, x), n.atan2(x, y), n.copysign(x, y), n.hypot(x, y))


def of_zeros(zero: float, a: float) -> tuple[float, ...]:
    """The lesser and the larger of two zeros of any signs, where a is 0."""
    numbers = n.minimum(zero, a), n.minimum(a, zero), n.minimum(a, n.sin(-a))
    return (*numbers, n.maximum(zero, a), n.maximum(a, zero), n.maximum(a, n.sin(-a)))


FUNCTIONS = len(of_one(0.5)) + len(of_two(0.5, 0.5)) + len(of_zeros(0.5, 0.5))


@dataclass(frozen=True)
class Outputs:
    functions: tuple[float, ...] = variable((0.0,) * FUNCTIONS, "Functions of a number")
    chosen: float = variable(0.0, "What the choice and the switch leave")
    held: float = variable(0.0, "The last sample")
    count: int = variable(0, "How often a number was large")
    is_large: bool = variable(False, "Whether it is")
    taken: Gear = variable(Gear.LOW, "What is chosen")


def step(t: float, h: float, state: State, inputs: Inputs, p: Parameters, c: object) -> State:
    x = 3.9 * state.x * (1.0 - state.x)
    sample = n.sampled(t, 0.25, state.sample, Sample(n.log(x) + n.sin(inputs.u * x)))
    count = n.where(n.logical_and(p.is_on, x > 0.5), state.count + 1, state.count)
    return State(x, sample, count, state.zero)


def output(t: float, state: State, p: Parameters, c: object) -> Outputs:
    of_numbers = (*of_one(state.x), *of_two(state.x, p.a * (state.x - 0.5)))
    functions = (*of_numbers, *of_zeros(state.zero, p.a))
    is_high = n.logical_or(p.gear == Gear.HIGH, n.logical_not(p.is_on))
    chosen = n.where(
        is_high, lambda: n.exp(-p.a * state.x) / state.x, lambda: p.a * n.tanh(state.sample.value)
    )
    gear = n.where(is_high, Gear.HIGH, Gear.LOW)
    return Outputs(functions, chosen, state.sample.value, state.count, state.x > 0.5, gear)


BLOCK = Block.of_module(__name__, "Functions", "Functions of a number", step_size=0.1)


@dataclass(frozen=True)
class WaveOutputs:
    waves: tuple[float, ...] = variable((0.0,) * 4, "sin and cos of a number, and next to their zeros")


def wave_output(t: float, state: State, p: Parameters, c: object) -> WaveOutputs:
    angle, zero = p.a * state.x, n.floor(6.0 * p.a * state.x) * (math.pi / 2.0)
    return WaveOutputs((n.sin(angle), n.cos(angle), n.sin(zero), n.cos(zero)))


WAVES = Block(
    "Waves",
    "Waves of a number",
    parameters=Parameters,
    inputs=Inputs,
    state=State,
    outputs=WaveOutputs,
    step=step,
    output=wave_output,
    step_size=0.1,
)


def build(folder: Path, block: Block = BLOCK, **options: bool) -> System:
    return System({"block": built_for_ensembles(folder, block, **options)})


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> System:
    return build(tmp_path_factory.mktemp("functions"))


@pytest.mark.parametrize("engine", ENGINES)
def test_functions_choices_and_types_have_the_bits_of_single_runs(system: System, engine: Engine) -> None:
    numbers = (0.0, -0.0, 1.0, -2.5, 1e-310, 200.0)
    cases = list(itertools.product(numbers, (True, False), (Gear.LOW, Gear.HIGH), (0.5, -3.0)))
    names = ("block.a", "block.is_on", "block.gear", "block.u")
    experiment = Experiment(20.0, 0.1, open_inputs="start")
    with Ensemble(system, *engine) as ensemble, Simulator(system) as simulator:
        vary: dict[str, Any] = dict(zip(names, zip(*cases, strict=True), strict=True))
        experiments = instances(experiment, vary, inputs=["block.u"])
        assert_same_bits(ensemble.run(experiments), simulator, experiments)


@pytest.mark.parametrize("name", block_names())
def test_every_shipped_block_has_the_bits_of_single_runs(
    name: str, built: Mapping[str, Path], device: Device | None
) -> None:
    """At random parameters and inputs, and up to where a run ends early."""
    block, rng = load_block(name), random.Random(1)
    traced = trace(block)
    names = [f"block.{v.name}" for v in (*block.of_causality("parameter"), *block.of_causality("input"))]
    rows: list[list[Any]] = []
    while len(rows) < 2 * LANES:
        p = drawn(block, "parameter", block.parameters, rng.choice((0.0, 0.1, 0.3)), rng)
        p = flatten(replace(p, internal_step=block.step_size))
        c = traced.calculate(p).full()
        if np.isfinite(c).all() and np.all(traced.requirements(p, c).full()):
            rows.append([*p, *flatten(drawn(block, "input", block.inputs, 0.5, rng))])
    vary = dict(zip(names, zip(*rows, strict=True), strict=True))
    experiment = Experiment(50 * block.step_size, block.step_size, open_inputs="start")
    experiments = instances(experiment, vary, names[len(flatten(block.parameters())) :])
    system = System({"block": built[name]})
    with Ensemble(system, device=device) as ensemble, Simulator(system) as simulator:
        recorded = ensemble.run(experiments)
        assert len(recorded.failures) < LANES
        for instance, experiment in enumerate(experiments):
            try:
                one = simulator.run(experiment)
            except SimulationError as error:
                one = error.recording
            assert (len(one.time) < 51) == (instance in recorded.failures)
            assert recorded.run(instance).values.tobytes() == one.values.tobytes()


@pytest.mark.parametrize("instructions", instruction_sets())
def test_sin_and_cos_have_the_bits_of_single_runs(tmp_path: Path, instructions: str) -> None:
    """Of small and large angles, of zeros, and where a result lies in the middle between two numbers.

    The first two groups have small angles alone.
    """
    small = [0.0, 1e-300, 1e-9, -1e-2, *np.linspace(1e-4, 0.0624, 12)]
    factors = [*small, 1e-4, -1e-2, 0.1, 1e5, 1e10, 1e300, *np.linspace(-9.0, 9.0, 58)]
    system, experiment = build(tmp_path, WAVES), Experiment(150.0, 0.1, open_inputs="start")
    with Ensemble(system, instructions) as ensemble, Simulator(system) as simulator:
        experiments = instances(experiment, {"block.a": factors})
        assert_same_bits(ensemble.run(experiments), simulator, experiments)


@pytest.mark.parametrize(
    "more",
    [
        {"events": (Event(10.0, {"block.asked": 2}),)},
        {"signals": {"block.asked": lambda t: 1.0 + (t > 10.0)}},
    ],
)
def test_what_is_no_item_is_refused(system: System, more: dict[str, Any]) -> None:
    experiment = Experiment(20.0, 0.1, open_inputs="start", **more)
    with Ensemble(system) as ensemble, pytest.raises(SystemDefinitionError, match=r"2: .*one of|is 2 at t"):
        ensemble.run([experiment])


def test_a_varied_signal_sets_an_enumeration_and_one_that_is_no_item_is_refused(system: System) -> None:
    """At the start time too."""
    signals = [lambda t: 1.0 + 2.0 * (t > 10.0), lambda t: 3.0 - 2.0 * (t > 5.0)]
    experiment = Experiment(20.0, 0.1, open_inputs="start", signals={"block.asked": signals[0]})
    with Ensemble(system) as ensemble, Simulator(system) as simulator:
        experiments = instances(experiment, {"block.asked": signals})
        assert_same_bits(ensemble.run(experiments), simulator, experiments)
        no_item = {"block.asked": [signals[0], lambda t: 1.0 + (t > 10.0)]}
        with pytest.raises(SystemDefinitionError, match=r"block.asked is 2 at t = 10.1 s: expected one of"):
            ensemble.run(instances(experiment, no_item))


def test_an_fmu_of_reals_alone_is_refused(tmp_path: Path) -> None:
    system = build(tmp_path, reals_only=True)
    with pytest.raises(EnsembleError, match=r"block: .* Reals"):
        Ensemble(system)


def test_an_fmu_that_is_built_again_is_not_mixed_with_the_old_one(tmp_path: Path) -> None:
    with Ensemble(build(tmp_path)) as ensemble:
        build(tmp_path, replace(BLOCK, description="Others"))
        with pytest.raises(OrchestrationError, match="GUID"):
            ensemble.run([Experiment(20.0, 0.1, open_inputs="start")])

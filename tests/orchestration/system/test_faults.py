"""Faults: the arrays that the master applies, against what a receiver would get sample by sample."""

import inspect
import math
import re
import runpy
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestration.errors import SystemDefinitionError
from orchestration.run import simulate
from orchestration.system.experiment import Algorithm, Experiment
from orchestration.system.faults import (
    KINDS,
    Delay,
    Drift,
    DropOut,
    Fault,
    Freeze,
    InterpolatedDelay,
    Noise,
    Offset,
    Scale,
    Stuck,
    compose,
)
from orchestration.system.prepared_run import prepare
from orchestration.system.signals import Cosine
from orchestration.system.system import System
from tests.orchestration.fault_model import received
from tests.shared_builds import Build

STEP = 0.25  # s: a power of two, so that times and their differences are exact


def arrives(faults: list[Fault], times: np.ndarray, sent: np.ndarray) -> np.ndarray:
    """As the master's loop does it."""
    pattern = compose(faults, times)
    arriving = np.where(pattern.source >= 0, pattern.weight * sent[pattern.source], 0.0)
    return arriving.sum(axis=1) + pattern.addition


seconds = st.integers(-4, 60).map(lambda i: i * STEP)
numbers = st.floats(-1e3, 1e3)
seeds = st.integers(0, 2**64)
passing_on = st.one_of(
    st.just(Freeze()),
    st.builds(DropOut, st.floats(0.0, 1.0), seeds),
    st.builds(Delay, st.integers(1, 40).map(lambda i: i * STEP / 2)),
)
effects = st.one_of(
    passing_on,
    st.builds(Stuck, numbers),
    st.builds(Offset, numbers),
    st.builds(Drift, numbers),
    st.builds(Noise, st.floats(0.0, 1e3), seeds),
    st.builds(InterpolatedDelay, st.floats(0.0, 10.0)),
    st.builds(Scale, st.floats(-2.0, 2.0)),
)


@st.composite
def faults_on_one_input(draw: st.DrawFn, effect: st.SearchStrategy) -> list[Fault]:
    drawn = []
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.one_of(st.just(-math.inf), seconds))
        length = draw(st.one_of(st.just(math.inf), st.integers(1, 40).map(lambda i: i * STEP)))
        drawn.append(Fault("a.u", draw(effect), start, start + length if start > -math.inf else math.inf))
    return drawn


grids = st.lists(st.integers(0, 50), min_size=1, max_size=40, unique=True).map(
    lambda numbers: np.array(sorted(numbers)) * STEP
)


@given(faults_on_one_input(effects), grids)
def test_faults_do_what_a_receiver_would_see(faults: list[Fault], times: np.ndarray) -> None:
    """Up to rounding: additions are summed before they are added to the sample."""
    sent = np.random.default_rng(0).standard_normal(len(times))
    expected = sent.tolist()
    for fault in faults:
        expected = received(fault, times.tolist(), expected)
    size = 1e3 * 60 * len(faults)  # the largest drift, about
    assert arrives(faults, times, sent) == pytest.approx(expected, rel=1e-12, abs=1e-15 * size)


def test_a_delay_of_half_a_step_is_the_same_at_every_point() -> None:
    times = 0.01 * np.arange(1000)
    late = np.arange(1000) - Fault("a.u", Delay(0.015)).pattern(times).source.ravel()
    assert set(late[2:].tolist()) == {2}


def test_an_event_beside_a_communication_point_moves_no_fault() -> None:
    times = 0.3 * np.arange(201)
    more = np.insert(times, 101, times[100] + 3e-8)
    fault = Fault("a.u", Stuck(9.0), start=0.9, end=15.0)
    for grid in (times, more):
        stuck = np.flatnonzero(fault.pattern(grid).source.ravel() < 0)
        assert (stuck[0], stuck[-1]) == (3, 49)


@given(faults_on_one_input(passing_on), grids)
def test_values_that_are_passed_on_stay_exact(faults: list[Fault], times: np.ndarray) -> None:
    sent = np.random.default_rng(0).standard_normal(len(times))
    expected = sent.tolist()
    for fault in faults:
        expected = received(fault, times.tolist(), expected)
    assert arrives(faults, times, sent).tolist() == expected


@given(faults_on_one_input(effects), grids)
def test_nothing_arrives_before_it_is_sent(faults: list[Fault], times: np.ndarray) -> None:
    source = compose(faults, times).source
    assert np.all(source <= np.arange(len(times))[:, np.newaxis])
    assert np.all(source >= -1)


def test_windows_begin_and_end_on_communication_points_despite_rounding() -> None:
    times = np.arange(10) * 0.7
    assert times[3] < 2.1
    assert times[6] < 4.2
    addition = compose([Fault("a.u", Offset(1.0), start=2.1, end=4.2)], times).addition
    assert np.flatnonzero(addition).tolist() == [3, 4, 5]


def test_random_faults_are_the_same_everywhere() -> None:
    """Written down once: another machine or version must give the same."""
    times = np.arange(6) * 1.0
    noise = compose([Fault("a.u", Noise(2.0, seed=7))], times).addition
    source = compose([Fault("a.u", DropOut(0.5, seed=7))], times).source[:, 0]
    written = [2.3710838050445804, -2.1434666553250183, -0.40526788571715033, 1.54014610811233]
    assert noise[:4] == pytest.approx(written, rel=1e-15)
    assert source.tolist() == [0, 1, 1, 3, 3, 5]


def test_noise_has_its_deviation_and_differs_by_input_and_seed() -> None:
    times = np.arange(20_000) * 0.01

    def noise(name: str, seed: int) -> np.ndarray:
        return compose([Fault(name, Noise(3.0, seed))], times).addition

    first = noise("a.u", 1)
    bound = 5.0 / math.sqrt(
        len(times)
    )  # five standard errors: the seeds are fixed, so it holds always or never
    assert abs(np.mean(first)) < 3.0 * bound
    assert np.std(first) == pytest.approx(3.0, rel=bound)
    for other in (noise("a.u", 2), noise("b.u", 1)):
        assert abs(np.corrcoef(first, other)[0, 1]) < bound


def test_a_late_window_of_drop_outs_may_lose_its_first_sample() -> None:
    """The one before the window holds then; of a run the first sample arrives in any case."""

    def source(**window: float) -> list[int]:
        return compose([Fault("a.u", DropOut(1.0), **window)], np.arange(7) * 1.0).source[:, 0].tolist()

    assert source(start=3.0, end=5.0) == [0, 1, 2, 2, 2, 5, 6]
    assert source(end=3.0) == [0, 0, 0, 3, 4, 5, 6]


def test_drop_out_loses_its_share() -> None:
    times = np.arange(20_000) * 0.01
    source = compose([Fault("a.u", DropOut(0.3))], times).source[:, 0]
    lost = np.mean(source != np.arange(len(times)))
    assert lost == pytest.approx(0.3, abs=5.0 * math.sqrt(0.3 * 0.7 / len(times)))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Stuck(math.nan), r"value = nan: expected a finite number"),
        (lambda: Offset(True), r"value = True: expected a finite number"),
        (lambda: Drift(math.inf), r"rate = inf: expected a finite number"),
        (lambda: Noise(-1.0), r"standard_deviation = -1.0: expected a finite number, 0 or more"),
        (lambda: Noise(1.0, -1), r"seed = -1: expected an integer, 0 or more"),
        (lambda: DropOut(1.5), r"probability = 1.5: expected 0..1"),
        (lambda: DropOut(0.5, True), r"seed = True: expected an integer"),
        (lambda: Delay(0.0), r"delay = 0.0: expected a finite number of seconds, more than 0"),
        (lambda: InterpolatedDelay(-0.1), r"delay = -0.1: expected a finite number of seconds, 0 or more"),
        (lambda: Scale(math.nan), r"factor = nan: expected a finite number"),
    ],
)
def test_a_wrong_argument_is_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(SystemDefinitionError, match=message):
        make()


@pytest.mark.parametrize(
    ("faults", "message"),
    [
        ([Fault("b.u[2]", Freeze())], r"fault on b.u\[2\]: no variable 'b.u\[2\]'; nearest is"),
        ([Fault("a.y[1]", Freeze())], r"a.y\[1\]: expected an input that a connection or a signal drives"),
        ([Fault("a.u[1]", Freeze())], r"a.u\[1\]: expected an input that a connection or a signal drives"),
        ([Fault("b.integer_in", Offset(1.0))], "Offset: expected an input of type Real, got Integer"),
        ([Fault("b.integer_in", Noise(1.0))], "Noise: expected an input of type Real, got Integer"),
        ([Fault("b.integer_in", Scale(2.0))], "Scale: expected an input of type Real, got Integer"),
        ([Fault("b.integer_in", InterpolatedDelay(0.1))], "InterpolatedDelay: expected .* Real, got Integer"),
        ([Fault("b.integer_in", Stuck(1.5))], "b.integer_in = 1.5: expected a value of type Integer"),
        ([Fault("b.boolean_in", Stuck(1.0))], "b.boolean_in = 1.0: expected a value of type Boolean"),
        ([Fault("b.u[1]", Freeze(), start=1.0)], r"no communication step begins at 1..inf s: .* 0..1 s"),
        ([Fault("b.u[1]", Freeze(), end=0.0)], r"no communication step begins at -inf..0 s"),
        ([Fault("b.u[1]", Freeze(), 0.11, 0.19)], r"no communication step begins at 0.11..0.19 s"),
    ],
)
def test_a_fault_must_fit_the_system(linear: Build, faults: list[Fault], message: str) -> None:
    through = linear(passes_discrete=True)
    kinds = ("integer", "boolean")
    connections = (("a.y[1]", "b.u[1]"), *((f"a.{k}_out", f"b.{k}_in") for k in kinds))
    inputs = {"a.u[1]": 0.0, "a.integer_in": 0, "a.boolean_in": False}
    experiment = Experiment(1.0, 0.1, inputs=inputs, faults=tuple(faults))
    system = System({"a": through, "b": through}, connections)
    with pytest.raises(SystemDefinitionError, match=message):
        prepare(system, experiment)


# What the master makes of them


FAULTS = [
    Fault("b.u[1]", Freeze(), 0.3, 0.6),
    Fault("b.u[1]", Stuck(4.0), 0.3, 0.6),
    Fault("b.u[1]", Offset(-0.5), start=0.3),
    Fault("b.u[1]", Drift(2.0), 0.3, 0.6),
    Fault("b.u[1]", Noise(0.1, seed=2)),
    Fault("b.u[1]", DropOut(0.5, seed=2)),
    Fault("b.u[1]", Delay(0.2)),
    Fault("b.u[1]", InterpolatedDelay(0.13)),
    Fault("b.u[1]", Scale(-1.5), 0.3, 0.6),
]


@pytest.mark.parametrize("algorithm", list(Algorithm))
@pytest.mark.parametrize("one", FAULTS, ids=[type(fault.effect).__name__ for fault in FAULTS])
def test_the_master_passes_on_what_a_receiver_would_see(
    linear: Build, one: Fault, algorithm: Algorithm
) -> None:
    """The output of a goes to b under a fault, and to c as it is."""
    through = linear(b=(0.0,), c=(0.0,), d=((1.0,),))
    components = dict.fromkeys("abc", through)
    experiment = Experiment(
        1.0, 0.1, algorithm=algorithm, signals={"a.u[1]": Cosine(1.0, 3.0)}, faults=(one,),
        record=("a.y[1]", "b.u[1]", "c.u[1]"),
    )  # fmt: skip
    run = simulate(System(components, (("a.y[1]", "b.u[1]"), ("a.y[1]", "c.u[1]"))), experiment)
    assert run["c.u[1]"].tolist() == run["a.y[1]"].tolist()
    assert np.ptp(run["a.y[1]"]) > 0.5
    expected = received(one, (np.arange(11) * 0.1).round(1).tolist(), run["a.y[1]"].tolist())
    assert run["b.u[1]"] == pytest.approx(expected, rel=1e-12)


def test_a_signal_can_fail_and_faults_act_in_their_order(linear: Build) -> None:
    through = linear(b=(0.0,), c=(0.0,), d=((1.0,),))
    both = (Fault("a.u[1]", Offset(1.0)), Fault("a.u[1]", Freeze(), start=0.5))
    experiment = Experiment(
        1.0, 0.1, signals={"a.u[1]": Cosine(1.0, 3.0)}, faults=both, record=("a.u[1]",)
    )  # fmt: skip
    run = simulate(System({"a": through}), experiment)
    times = np.minimum(run.time, 0.5)
    assert run["a.u[1]"] == pytest.approx(1.0 + np.cos(3.0 * times), rel=1e-12)


def test_whole_numbers_and_switches_can_be_stuck(linear: Build) -> None:
    through = linear(passes_discrete=True)
    kinds = ("integer", "boolean")
    connections = (("a.y[1]", "b.u[1]"), *((f"a.{k}_out", f"b.{k}_in") for k in kinds))
    inputs = {"a.u[1]": 0.0, "a.integer_in": 3, "a.boolean_in": False}
    faults = (Fault("b.integer_in", Stuck(-7), 0.5, 0.8), Fault("b.boolean_in", Stuck(True), 0.5, 0.8))
    experiment = Experiment(1.0, 0.1, inputs=inputs, faults=faults, record=("b.integer_out", "b.boolean_out"))
    run = simulate(System({"a": through, "b": through}, connections), experiment)
    stuck = [False] * 6 + [True] * 3 + [False] * 2  # seen in the output a step later
    assert run["b.integer_out"].tolist() == [-7 if is_stuck else 3 for is_stuck in stuck]
    assert run["b.boolean_out"].tolist() == [float(is_stuck) for is_stuck in stuck]


@pytest.mark.parametrize("algorithm", list(Algorithm))
def test_a_slow_component_holds_its_output_also_for_a_fault(linear: Build, algorithm: Algorithm) -> None:
    """a steps every 0.3 s, b every 0.1 s: what is delayed by 0.2 s is what a gave 0.2 s before."""
    through = linear(b=(0.0,), c=(0.0,), d=((1.0,),))
    experiment = Experiment(
        1.2, 0.1, algorithm=algorithm, signals={"a.u[1]": Cosine(1.0, 3.0)}, step_sizes={"a": 0.3},
        faults=(Fault("b.u[1]", Delay(0.2)),), record=("a.y[1]", "b.u[1]"),
    )  # fmt: skip
    run = simulate(System({"a": through, "b": through}, (("a.y[1]", "b.u[1]"),)), experiment)
    sent = run["a.y[1]"].tolist()
    assert run["b.u[1]"].tolist() == [sent[0], sent[0], *sent[:-2]]


def test_every_kind_has_its_arguments_on_the_page_of_keys() -> None:
    text = runpy.run_path(str(Path(__file__).parents[3] / ".ci" / "keys_page.py"))["page"]()
    for kind, table in KINDS.items():
        (row,) = re.findall(rf'^\| `kind = "{kind}"` \| \*\*`input`\*\*, (.*?) \|', text, re.M)
        assert {*inspect.signature(table).parameters} <= set(re.findall(r"`(\w+)`", row))

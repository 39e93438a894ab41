"""Whatever is combined: all loops agree, and a run that is interrupted twice goes on, to the last bit."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from orchestration.errors import SimulationError
from orchestration.results.recording import Recording
from orchestration.run import Simulator, simulate
from orchestration.run.checkpoint import Checkpoint, Checkpoints, read_checkpoint
from orchestration.scenarios.declarations import fault
from orchestration.system.experiment import Algorithm, Event, Experiment
from orchestration.system.signals import Cosine
from orchestration.system.system import System
from tests.foreign_fmus import Misdeed
from tests.orchestration.linear_systems import RESUMABLE
from tests.orchestration.python_loop import LoopInPython
from tests.orchestration.runs import assert_same_bits, interrupt_at
from tests.shared_builds import Build

Versions = tuple[int, int, int]  # of FMI, of one, two and three
OLD: Versions = (2, 2, 2)
NAMES = ("one", "two", "three", "rogue")
RUN = 1.0  # s; of the longest step, at least 14 communication steps
MOST_UNTIL_INTERRUPT = 6  # points, twice: the run is not yet over
EVERY_POINT = 1e-9  # s between checkpoints

# times since the start
FAULTS: list[dict[str, Any]] = [
    {"kind": "freeze", "start": 0.2, "end": 0.4},
    {"kind": "delay", "start": 0.0, "delay": 0.07},
    {"kind": "noise", "start": 0.0, "standard_deviation": 0.1, "seed": 3},
    {"kind": "drop-out", "start": 0.1, "probability": 0.3, "seed": 4},
    {"kind": "drift", "start": 0.3, "end": 0.8, "rate": 0.5},
]
EVENTS = [(0.0, -1.5), (0.33, -0.2), (0.7, -3.0), (1.0, -0.7)]


def chain(
    linear: Build, rogue: Build, order: list[str], through: float, interpolates: bool, versions: Versions
) -> System:
    """one <-> two -> rogue -> three, which a signal drives too, listed in this order.

    through: of every output, at once; with it one and two form an algebraic loop.
    """
    options: dict[str, Any] = {"passes_discrete": True, "interpolates_inputs": interpolates, **RESUMABLE}
    feed = ((through,),)
    fmus = {
        "one": linear(fmi=versions[0], a=-1.0, b=(0.5,), d=feed, **options),
        "two": linear(fmi=versions[1], a=-2.0, b=(-3.0,), d=feed, initial_state=0.5, **options),
        "three": linear(fmi=versions[2], a=-4.0, b=(1.0, 2.0), d=((through, through),), **options),
        "rogue": rogue(**RESUMABLE),
    }
    connections = (
        ("one.y[1]", "two.u[1]"),
        ("two.y[1]", "one.u[1]", {"factor": 0.9, "offset": 0.1}),
        ("two.y[1]", "rogue.u"),
        ("rogue.y", "three.u[2]"),
        ("one.integer_out", "two.integer_in"),
        ("two.boolean_out", "three.boolean_in"),
    )
    return System({name: fmus[name] for name in order}, connections)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("combinations") / "checkpoint"


def interrupted(
    simulator: Simulator, experiment: Experiment, path: Path, at: int, resume: Checkpoint | None = None
) -> tuple[Checkpoint, Recording]:
    """Run until communication point `at`; what was saved and recorded."""
    checkpoints = Checkpoints(path, every=EVERY_POINT)
    with pytest.raises(SimulationError, match=r"^interrupted; saved in ") as caught:
        simulator.run(experiment, interrupt_at(at), checkpoints=checkpoints, resume=resume)
    saved = read_checkpoint(path)
    assert saved.position == at
    return saved, caught.value.recording


STEPPING = st.one_of(
    st.just({}),
    st.just({"tolerance": 2e-2}),
    st.builds(
        lambda periods: {"periods": dict(zip(NAMES, periods, strict=True))},
        st.tuples(*[st.integers(1, 4)] * 4),
    ),
)
UNTIL_INTERRUPT = st.integers(1, MOST_UNTIL_INTERRUPT)
EXTRAPOLATED: dict[str, Any] = {
    "algorithm": Algorithm.JACOBI,
    "extrapolation": 1,
    "through": 0.0,
    "order": [*NAMES],
    "start": 0.0,
    "step": 0.07,
    "faulty": [],
    "events": [],
    "misdeed": Misdeed.NONE,
    "points": (2, 3),
}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::orchestration.errors.FmuWarning")
@given(
    algorithm=st.sampled_from(Algorithm),
    extrapolation=st.sampled_from([0, 1]),
    interpolates=st.booleans(),
    through=st.sampled_from([0.0, 0.1]),
    order=st.permutations(NAMES),
    start=st.sampled_from([0.0, -3.0, 1000.0]),
    step=st.sampled_from([0.05, 0.07]),
    stepping=STEPPING,
    faulty=st.lists(
        st.tuples(st.sampled_from(["one.u[1]", "two.u[1]", "rogue.u"]), st.sampled_from(FAULTS)),
        max_size=3,
        unique_by=lambda pair: (pair[0], pair[1]["kind"]),  # twice the noise jumps by more than the tolerance
    ),
    events=st.lists(st.sampled_from(EVENTS), unique=True),
    misdeed=st.sampled_from([Misdeed.NONE, Misdeed.WARNING, Misdeed.DISCARD]),
    points=st.tuples(UNTIL_INTERRUPT, UNTIL_INTERRUPT),
    versions=st.tuples(*[st.sampled_from([2, 3])] * 3),
)
@example(
    **EXTRAPOLATED, stepping={"periods": {"two": 2, "three": 3}}, interpolates=True, versions=(2, 2, 2, 2)
)
@example(**EXTRAPOLATED, stepping={"tolerance": 2e-2}, interpolates=False, versions=(3, 3, 2))
@example(**{**EXTRAPOLATED, "misdeed": Misdeed.DISCARD}, stepping={}, interpolates=False, versions=OLD)
def test_all_loops_agree_and_interrupts_change_nothing(
    linear: Build,
    rogue: Build,
    checkpoint: Path,
    algorithm: Algorithm,
    extrapolation: int,
    interpolates: bool,
    through: float,
    order: list[str],
    start: float,
    step: float,
    stepping: dict[str, Any],
    faulty: list[tuple[str, dict[str, Any]]],
    events: list[tuple[float, float]],
    misdeed: Misdeed,
    points: tuple[int, int],
    versions: Versions,
) -> None:
    """The compiled loop, that in Python, and that on threads, with components of both standards."""
    periods = stepping.get("periods", {})
    if periods and misdeed is Misdeed.DISCARD:
        misdeed = Misdeed.NONE  # with step sizes of its own no component goes back
    if "tolerance" in stepping:
        # a drop-out holds the noise on its input, which then jumps by more than the tolerance
        faulty = [*dict(faulty).items()]
    experiment = Experiment(
        start + RUN,
        step,
        start,
        algorithm,
        parameters={
            "rogue.misdeed": misdeed.name.lower(),
            "rogue.misdeed_time": start + 0.3,
            "rogue.longest_step": 0.03,
        },
        inputs={"one.integer_in": 7, "three.integer_in": -3, "two.boolean_in": True, "one.boolean_in": False},
        signals={"three.u[1]": Cosine(1.0, 6.0)},
        events=tuple(Event(start + time, {"one.a": value}) for time, value in events),
        extrapolation=extrapolation,
        step_sizes={name: count * step for name, count in periods.items()},
        tolerance=stepping.get("tolerance"),
        faults=tuple(fault({"input": name, **_later(declared, start)}, "here") for name, declared in faulty),
    )
    system = chain(linear, rogue, order, through, interpolates, versions)
    with Simulator(system) as compiled, LoopInPython(system) as plain:
        uninterrupted = compiled.run(experiment)
        assert_same_bits(plain.run(experiment), uninterrupted)
        with Simulator(system, threads=3) as shared:
            assert_same_bits(shared.run(experiment), uninterrupted)
        if not interpolates:  # which FMI 3.0 has no function for
            of_fmi_2 = chain(linear, rogue, order, through, interpolates, OLD)
            assert_same_bits(simulate(of_fmi_2, experiment), uninterrupted)
        first, begun = interrupted(compiled, experiment, checkpoint, points[0])
        assert_same_bits(begun, uninterrupted, points[0] + 1)
        second, begun = interrupted(plain, experiment, checkpoint, sum(points), first)
        assert_same_bits(begun, uninterrupted, sum(points) + 1)
        assert_same_bits(compiled.run(experiment, resume=second), uninterrupted)
    assert uninterrupted["two.integer_out"][-1] == 7.0
    assert len(np.unique(uninterrupted["three.y[1]"])) > 3


def _later(declared: dict[str, Any], by: float) -> dict[str, Any]:
    return {key: value + by if key in ("start", "end") else value for key, value in declared.items()}

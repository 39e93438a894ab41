"""What the master makes of an FMU that misbehaves: `rogue.c`, an integrator, feeds a lag and is fed by it."""

import sys
import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from orchestration.errors import FmuWarning, SimulationError
from orchestration.results.recording import Recording
from orchestration.run import Simulator, simulate
from orchestration.system.experiment import Algorithm, Event, Experiment
from orchestration.system.faults import Delay, DropOut, Effect, Fault, Noise
from orchestration.system.system import System
from tests.foreign_fmus import Misdeed
from tests.orchestration.fault_model import received
from tests.orchestration.rogue_systems import doing, pair, run
from tests.shared_builds import Build

ROUNDING = 1e-12  # relative: communication points, and sums of steps, differ in the last digits
POINTS = 11
DISCARDS = (Misdeed.DISCARD, Misdeed.TELLS_NOTHING)


@pytest.fixture(params=[2, 3], ids=["FMI 2", "FMI 3"])
def rogue(rogue: Build, request: pytest.FixtureRequest) -> Build:
    """The rogue in each standard; in FMI 3.0 a step that it discards leaves it as it was."""
    return partial(rogue, fmi=request.param)


FMI_2_ALONE = pytest.mark.parametrize("rogue", [2], ids=["FMI 2"], indirect=True)


@pytest.fixture
def system(linear: Build, rogue: Build) -> System:
    return pair(linear, rogue)


def failure(system: System, experiment: Experiment, message: str) -> Recording:
    """What was recorded until the failure of this message."""
    with pytest.raises(SimulationError, match=message) as caught:
        run(system, experiment)
    return caught.value.recording


def check_recorded_until(recording: Recording, points: int, system: System) -> None:
    """The points before the misdeed, as a run without one gives them."""
    without = run(system, doing(Misdeed.NONE))
    assert recording.time.tolist() == without.time[:points].tolist()
    assert np.array_equal(recording.values, without.values[:points])


SET = "fmi(2SetReal|3SetFloat64)"
ENDS = [
    (Misdeed.ERROR, "rogue at t = 0.5 s: fmi.DoStep returned error: the rudder is stuck"),
    (Misdeed.FATAL, "rogue at t = 0.5 s: fmi.DoStep returned fatal: the hull is breached"),
    (Misdeed.REFUSE_INPUT, f"rogue at t = 0.5 s: {SET} returned discard: no input is taken any more"),
    (Misdeed.NO_STATUS_OF_STEP, "rogue at t = 0.5 s: fmi.DoStep returned status -5: it logged nothing"),
    (Misdeed.BIG_STATUS_OF_STEP, "rogue at t = 0.5 s: fmi.DoStep returned status 6: it logged nothing"),
    (Misdeed.NO_STATUS_OF_INPUT, f"rogue at t = 0.5 s: {SET} returned status -5: it logged nothing"),
]


@pytest.mark.parametrize("saves_state", [True, False])
@pytest.mark.parametrize(("misdeed", "message"), ENDS, ids=[misdeed.name for misdeed, _ in ENDS])
def test_what_an_fmu_refuses_ends_the_run_and_keeps_the_record(
    linear: Build,
    rogue: Build,
    temporary: Path,
    misdeed: Misdeed,
    message: str,
    saves_state: bool,
) -> None:
    """After a fatal error the rogue ends the process if it is called once more."""
    system = pair(linear, rogue, saves_state)
    recording = failure(system, doing(misdeed), message)
    check_recorded_until(recording, 6, system)
    assert not list(temporary.iterdir())


@pytest.mark.parametrize(
    ("misdeed", "complaint"),
    [
        (Misdeed.REFUSE_STATE, "error: the state is not given away"),
        (Misdeed.NO_STATUS_OF_STATE, "status -5: it logged nothing"),
    ],
)
def test_a_state_that_is_refused_ends_the_run(system: System, misdeed: Misdeed, complaint: str) -> None:
    """A state is saved at each change of a parameter; when else, depends on how fast the steps are."""
    message = f"rogue at t = 0.5 s: fmi.GetFMU[sS]tate returned {complaint}"
    experiment = replace(doing(misdeed), events=(Event(0.5, {"lag.a": -1.0}),))
    recording = failure(system, experiment, message)
    assert len(recording.time) == 5


def test_a_warning_is_passed_on_and_the_run_goes_on(system: System) -> None:
    with pytest.warns(FmuWarning, match="rogue at t = .* s: fmi.DoStep: .*the battery is low"):
        warned = run(system, doing(Misdeed.WARNING))
    assert np.array_equal(warned.values, run(system, doing(Misdeed.NONE)).values)


# Outputs that are no numbers


@pytest.mark.parametrize(("misdeed", "word"), [(Misdeed.NAN_OUTPUT, "nan"), (Misdeed.INFINITE_OUTPUT, "inf")])
def test_an_output_that_is_no_number_stops_where_it_goes_on(
    system: System, misdeed: Misdeed, word: str
) -> None:
    message = rf"rogue.y is {word} at t = 0.6 s: expected a finite number, as it goes to lag.u\[1\]"
    recording = failure(system, doing(misdeed), message)
    assert recording.time[-1] == pytest.approx(0.6)
    before = replace(recording, time=recording.time[:6], values=recording.values[:6])
    check_recorded_until(before, 6, system)


@pytest.mark.parametrize(
    ("misdeed", "value"), [(Misdeed.NAN_OUTPUT, np.nan), (Misdeed.INFINITE_OUTPUT, np.inf)]
)
def test_an_output_that_is_no_number_and_goes_nowhere_is_recorded(
    rogue: Build, misdeed: Misdeed, value: float
) -> None:
    experiment = replace(doing(misdeed), inputs={"rogue.u": 1.0})
    recording = run(System({"rogue": rogue()}), experiment)
    assert recording["rogue.y"][:6] == pytest.approx(np.arange(6) * 0.1)
    assert np.array_equal(recording["rogue.y"][6:], [value] * 5, equal_nan=True)


# Steps that are too long


@pytest.mark.parametrize("algorithm", list(Algorithm))
@pytest.mark.parametrize("misdeed", DISCARDS)
def test_a_discarded_step_is_done_in_shorter_ones(
    system: System, misdeed: Misdeed, algorithm: Algorithm
) -> None:
    """With a longest step of h / 2 from the start on: as a run with that step size."""
    halved = run(system, replace(doing(Misdeed.NONE, h=0.05), algorithm=algorithm))
    discarding = replace(doing(misdeed, 0.0, 0.05), algorithm=algorithm)
    recording = run(system, discarding)
    assert recording.time == pytest.approx(np.arange(POINTS) * 0.1, rel=1e-15)
    for name in recording.names:
        assert recording[name] == pytest.approx(halved[name][::2], rel=ROUNDING, abs=ROUNDING)
    assert recording.provenance["steps_between_points"] == 20


@FMI_2_ALONE
def test_the_part_of_a_step_that_succeeded_is_taken(system: System) -> None:
    """0.1 s fails and gives 0.04 s, the rest fails and gives 0.04 s, then the rest."""
    recording = run(system, doing(Misdeed.DISCARD, 0.5, 0.04))
    assert recording.provenance["steps_between_points"] == 3 * 5
    assert recording.provenance["discarded_steps"] == 2 * 5
    assert len(recording.time) == POINTS


def test_a_discarded_step_leaves_no_trace_before_it(system: System) -> None:
    discarded, without = (
        run(system, doing(misdeed, 0.5, 0.04)) for misdeed in (Misdeed.DISCARD, Misdeed.NONE)
    )
    assert np.array_equal(discarded.values[:6], without.values[:6])
    assert not np.array_equal(discarded.values[6:], without.values[6:])


@FMI_2_ALONE
@pytest.mark.parametrize("algorithm", list(Algorithm))
@pytest.mark.parametrize(
    "effect", [Delay(0.2), DropOut(0.5), Noise(0.1)], ids=lambda effect: type(effect).__name__
)
def test_a_fault_acts_once_a_communication_point_also_where_steps_are_shorter(
    system: System, effect: Effect, algorithm: Algorithm
) -> None:
    fault = Fault("lag.u[1]", effect)
    recorded = ("rogue.y", "lag.u[1]")
    experiment = replace(doing(Misdeed.DISCARD, 0.3, 0.04), faults=(fault,), algorithm=algorithm)
    recording = run(system, replace(experiment, record=recorded))
    arrived = received(fault, recording.time.round(1).tolist(), recording["rogue.y"].tolist())
    assert recording["lag.u[1]"] == pytest.approx(arrived, rel=ROUNDING)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"saves_state": False}, r"rogue, lag cannot go back \(canGetAndSetFMUstate\)"),
        ({"varies_step_size": False}, r"lag cannot vary the step \(canHandleVariableCommunicationStepSize\)"),
    ],
)
def test_a_step_that_cannot_be_repeated_ends_the_run(
    linear: Build, rogue: Build, options: dict[str, Any], reason: str
) -> None:
    system = pair(linear, rogue, **options)
    message = f"rogue at t = 0.5 s: fmi.DoStep returned discard: a step of 0.1 s is too long.*; {reason}"
    message = message.replace("; ", "; no shorter step was tried, as ")
    recording = failure(system, doing(Misdeed.DISCARD, 0.5, 0.04), message)
    check_recorded_until(recording, 6, system)


@pytest.mark.parametrize("misdeed", DISCARDS)
def test_a_step_that_is_discarded_however_short_ends_the_run(system: System, misdeed: Misdeed) -> None:
    message = r"rogue at t = 0.5 s: fmi.DoStep returned discard: a step of .*e-1. s is too long"
    recording = failure(system, doing(misdeed), message)
    assert recording.time[-1] == pytest.approx(0.5)


LIES = [(Misdeed.TELLS_BEFORE, "0.4"), (Misdeed.TELLS_AFTER, "0.7"), (Misdeed.TELLS_NAN, "nan")]


@FMI_2_ALONE
@pytest.mark.parametrize(("misdeed", "reported"), LIES)
def test_a_last_successful_time_outside_the_step_ends_the_run(
    system: System, misdeed: Misdeed, reported: str
) -> None:
    message = (
        rf"rogue discarded the step from 0.5 to 0.6 s and returned LastSuccessfulTime = {reported} s: "
        "expected a time within the step"
    )
    failure(system, doing(misdeed, 0.5, 0.04), message)


# In a process of its own


# in Windows, ctypes makes an exception of Python from an access violation
SEGFAULT = "exit status 70" if sys.platform == "win32" else "SIGSEGV"
ENDS_APART = [
    (Misdeed.HANG, "rogue at t = 0.5 s: did not return within 1 s, and its process was ended"),
    (Misdeed.SEGFAULT, f"rogue at t = 0.5 s: ended its process with {SEGFAULT}"),
    ENDS[0],  # what is refused otherwise ends a run in the same way
]


@FMI_2_ALONE
@pytest.mark.parametrize(("misdeed", "message"), ENDS_APART)
def test_a_process_of_its_own_ends_with_the_fmu_and_keeps_the_record(
    system: System, temporary: Path, misdeed: Misdeed, message: str
) -> None:
    before = {*psutil.Process().children(recursive=True)}
    with pytest.raises(SimulationError, match=message) as caught:
        simulate(system, doing(misdeed), timeout=1.0)
    check_recorded_until(caught.value.recording, 6, system)
    assert not list(temporary.iterdir())
    assert {*psutil.Process().children(recursive=True)} <= before


# Afterwards


@pytest.mark.parametrize(
    "misdeed",
    [Misdeed.ERROR, Misdeed.FATAL, Misdeed.NAN_OUTPUT, Misdeed.TELLS_NAN],
    ids=lambda misdeed: misdeed.name,
)
def test_the_next_run_of_a_simulator_is_as_if_nothing_had_happened(system: System, misdeed: Misdeed) -> None:
    with warnings.catch_warnings(), Simulator(system) as simulator:
        warnings.simplefilter("error")
        with pytest.raises(SimulationError):
            simulator.run(doing(misdeed))
        again = simulator.run(doing(Misdeed.NONE))
    assert np.array_equal(again.values, run(system, doing(Misdeed.NONE)).values)

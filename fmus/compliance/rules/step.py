"""Steps: their times, their sizes, the stop time, and what a step does."""

import itertools
import math
from collections.abc import Iterator

from fmus.compliance import actions as do
from fmus.compliance.differential import Row, differential
from fmus.compliance.fmu_file import CO_SIMULATION, FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, NotJudgedError, behaviour_rule
from fmus.compliance.rules.session import LARGE_TOLERANCE, TOLERANCE, run_with_tolerance
from fmus.compliance.script import Reading, Reply, Script
from fmus.compliance.values import continuous_reals, refused_reference, texts, unless_claimed
from fmus.fmi.binding import DISCARD, ERROR

_SETUP = "2.1.6 Initialization, Termination, and Resetting an FMU (fmi2SetupExperiment)"
_COMPUTATION = "4.2.2 Computation (fmi2DoStep)"
_FLAGS = "4.3.1 Co-Simulation FMU (CoSimulation)"
_ANY_STEP = "canHandleVariableCommunicationStepSize"
_MORE_STEPS = (13, 47, 211)  # instead of two: for each internal step from the usual size to a hundredth
_APART = 0.4  # of the change over two steps: a rough solver, but not half a step


@behaviour_rule(_SETUP, needs="reset-in-every-state")
def step_beyond_the_stop_time_is_an_error(probe: Probe) -> Iterator[str]:
    """If a stop time is defined, steps up to it succeed and a step past it returns error; fmi2Reset brings
    the instance back, where the same holds of another stop time with a tolerance.
    """
    tolerance = TOLERANCE if run_with_tolerance(probe).succeeded else None
    script = probe.script(logging=True).set_up(stop=probe.point(3))
    script.enter_initialization_mode().exit_initialization_mode().step(3)
    beyond = script.call("do_step", probe.point(3), probe.step_size)
    script.reset()
    script.set_up(stop=probe.point(1), tolerance=tolerance)
    script.enter_initialization_mode().exit_initialization_mode().step()
    again = script.call("do_step", probe.point(1), probe.step_size)
    script.play(keep_going=True)
    after = script.replies[script.replies.index(beyond) + 1 : -1]
    failed = next((reply for reply in after if reply.status is not None and not reply.ok), None)
    if script.failure not in (None, beyond, failed):
        yield f"with the stop time {probe.point(3):g} s, before it: {script.failure.problem}"
    elif beyond.status != ERROR:
        yield (
            f"{beyond.function} to {probe.point(4):g} s {beyond.status_name}: expected error beyond the "
            f"stop time {probe.point(3):g} s"
        )
    elif failed and _recovers(probe):
        yield f"after fmi2Reset from a step beyond the stop time: {failed.problem}"
    elif not failed and again.status != ERROR:
        yield (
            f"after fmi2Reset {again.function} to {probe.point(2):g} s {again.status_name}: expected error "
            f"beyond the stop time {probe.point(1):g} s"
        )


def _recovers(probe: Probe) -> bool:
    """Whether fmi2Reset brings an instance back after another error."""
    script = probe.script().begin().step()
    script.call("get", "Real", [refused_reference(probe)])
    first = len(script.replies)
    script.reset()
    script.begin().step().play(keep_going=True)
    return all(reply.ok for reply in script.replies[first:])


@differential(_SETUP)
def undefined_arguments_are_ignored(probe: Probe) -> Iterator[Row]:
    """A tolerance or a stop time that is not defined is not looked at."""
    set_up = do.call("set_up_experiment_with", [], probe.start_time, [], probe.start_time - 1.0)
    varied = set_up, do.enter_initialization_mode, do.exit_initialization_mode, do.run(2)
    failing = "with neither tolerance nor stop time defined"
    yield Row("where an undefined stop time lies before the start time", varied, failing=failing)


@behaviour_rule(_SETUP)
def tolerance_is_accepted(probe: Probe) -> Iterator[str]:
    """A tolerance that is defined is accepted."""
    if failure := run_with_tolerance(probe).failure:
        yield f"with the tolerance {TOLERANCE:g}: {failure.problem}"


def _without_independent(fmu: FmuFile) -> str:
    return "" if any(v.causality == "independent" for v in fmu.variables) else "no variable is independent"


@behaviour_rule(
    "2.2.7 Definition of Model Variables (ModelVariables), independent",
    condition=_without_independent,
    needs="reset-in-every-state",
)
def time_is_the_communication_point(probe: Probe) -> Iterator[str]:
    """The independent variable is the start time after initialisation, and then the end of the last step,
    also of its multiples: after a fraction, an FMU of fixed internal steps may be behind. So it is after
    fmi2Reset, with a tolerance, a stop time and another start time.
    """
    independent = [v for v in probe.fmu.variables if v.causality == "independent"]
    if not probe.states_step_size:
        raise NotJudgedError("no step size is stated, and an internal step may be longer than others")
    factors = (1.0, 2.0, 3.0) if probe.fmu.claims(_ANY_STEP) else (1.0, 1.0, 1.0)
    tolerance = LARGE_TOLERANCE if run_with_tolerance(probe).succeeded else None
    for start in (probe.start_time, probe.start_time + 3 * probe.step_size):
        script, t = probe.script(), start
        if start == probe.start_time:
            script.begin()
        else:
            script.begin().step().reset()
            script.set_up(start, probe.point(1000), tolerance).enter_initialization_mode()
            script.exit_initialization_mode()
        rows = [(script.replies[-1], script.read(independent), start)]
        for factor in factors:
            step = script.call("do_step", t, factor * probe.step_size)
            t += factor * probe.step_size
            rows.append((step, script.read(independent), t))
        script.play(keep_going=True)
        for _, reading, t in itertools.takewhile(lambda row: row[0].ok and row[1].ok, rows):
            (got,) = reading.values.values()
            if not abs(got - t) <= 1e-3 * probe.step_size + 1e-9 * abs(t):
                yield (
                    f"{independent[0].name} is {texts(got, t)[0]} at the communication point "
                    f"{texts(got, t)[1]} s"
                )
                return


@behaviour_rule(_COMPUTATION, interface=CO_SIMULATION)
def communication_points_may_be_rounded(probe: Probe) -> Iterator[str]:
    """Communication points may be sums of step sizes or multiples of one: their rounding is no error."""
    script = probe.script(logging=True).begin()
    t, h = probe.start_time, probe.step_size
    for i in range(30):
        script.call("do_step", t if i % 2 else probe.point(i), h)
        t += h
    script.play(keep_going=True)
    if script.failure and script.failure.status != DISCARD:
        yield script.failure.problem


@differential(_COMPUTATION, needs="variables-can-be-read")
def no_set_state_flag_changes_nothing(probe: Probe) -> Iterator[Row]:
    """noSetFMUStatePriorToCurrentPoint = fmi2True is accepted, and the values are the same."""
    read = do.read([v for v in probe.fmu.variables if v.causality != "independent"])
    varied = do.begin, *(do.step(no_going_back=True), read) * 3
    when = "with noSetFMUStatePriorToCurrentPoint"
    yield Row(when, varied, (do.begin, *(do.step(), read) * 3), failing="")


@behaviour_rule(f"{_FLAGS}: {_ANY_STEP}", condition=unless_claimed(_ANY_STEP))
def variable_step_size(probe: Probe) -> Iterator[str]:
    """Steps of different sizes succeed one after the other; one that is discarded says how far it came."""
    script = probe.script(logging=True).begin()
    t, ends = probe.start_time, []
    for factor in (1.0, 0.5, 2.0, 0.25, 1.5):
        ends.append((t, t + factor * probe.step_size))
        script.call("do_step", t, factor * probe.step_size)
        t = ends[-1][1]
    script.play(keep_going=True)
    failure = script.failure
    if failure and failure.status != DISCARD:
        yield failure.problem
    elif failure:
        yield from _discarded(probe, script, failure, ends)


def _discarded(
    probe: Probe, script: Script, failure: Reply, ends: list[tuple[float, float]]
) -> Iterator[str]:
    """Yields what is wrong with a discarded step: the master cannot know where it ended."""
    steps = [reply for reply in script.replies if reply.function == "fmi2DoStep"]
    number = steps.index(failure)
    again = probe.script(logging=True).begin()
    for t, end in ends[: number + 1]:
        again.call("do_step", t, end - t)
    last = again.call("status_of", "Real", 2)
    again.play(keep_going=True)
    t, end = ends[number]
    if end - t < 0.9 * probe.step_size:
        yield f"a step of {end - t:g} s after one of {probe.step_size:g} s: {failure.problem}"
    if last.ok and not t - 1e-9 * abs(t) <= last.value < end:
        yield f"a step from {t:g} to {end:g} s is discarded, and fmi2LastSuccessfulTime is {last.value:g} s"


@behaviour_rule(f"{_FLAGS}: {_ANY_STEP}", condition=unless_claimed(_ANY_STEP), needs="variable-step-size")
def two_steps_are_one_of_twice_the_size(probe: Probe) -> Iterator[str]:
    """A step reaches its end: after a step, two more bring continuous outputs about as far as one of twice
    the size, or many of no simple fraction of it.
    """
    chosen = continuous_reals(probe, "output")
    small, others = probe.script().begin(), [(n, probe.script().begin()) for n in (1, *_MORE_STEPS)]
    before = small.step().read(chosen)
    two = small.step(2).read(chosen)
    readings = [_in_steps(probe, script, n).read(chosen) for n, script in others]
    small.play()
    probe.play_each([script for _, script in others])
    if not chosen or not any(script.succeeded for _, script in others):
        raise NotJudgedError("there is no continuous output, or no step of twice the size")
    names = [v.name for v in chosen if abs(_change(before, two, v.name)) > 1e-9 * abs(two.values[v.name])]
    for (n, script), got in zip(others, readings, strict=True):
        if script.succeeded and names and all(_is_elsewhere(before, two, got, name) for name in names):
            shown = texts(got.values[names[0]], two.values[names[0]])
            steps = "one step" if n == 1 else f"{n} steps"
            yield (
                f"{names[0]} is {shown[0]} after {steps} of {2 * probe.step_size / n:g} s: expected about "
                f"{shown[1]}, as after two of {probe.step_size:g} s"
            )
            return


def _in_steps(probe: Probe, script: Script, count: int) -> Script:
    """Returns a script that goes two usual steps further, after the first, in equal steps of a number."""
    h = 2 * probe.step_size / count
    script.step()
    for i in range(count):
        script.call("do_step", probe.point(1) + i * h, h)
    return script


def _is_elsewhere(before: Reading, two: Reading, got: Reading, name: str) -> bool:
    return abs(got.values[name] - two.values[name]) > _APART * abs(_change(before, two, name))


def _change(before: Reading, after: Reading, name: str) -> float:
    return after.values[name] - before.values[name]


@behaviour_rule(
    "advice: 2.2.5, what a user runs first",
    needs="communication-points-may-be-rounded variables-can-be-read",
)
def default_experiment_runs(probe: Probe) -> Iterator[str]:
    """The steps of DefaultExperiment succeed up to its stop time, as far as they take about a second."""
    if not probe.states_step_size or not math.isfinite(probe.stop_time):
        raise NotApplicableError("no stop time and step size are stated")
    failure = do.over_the_experiment(probe).script.failure
    if failure and failure.status != DISCARD:
        yield failure.problem

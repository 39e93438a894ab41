"""Steps: their times and sizes, their effect, the stop time, and pending steps."""

import itertools
import math
from collections.abc import Iterator, Sequence
from contextlib import suppress

from fmus.compliance import actions as do
from fmus.compliance import values
from fmus.compliance.differential import Row, differences, differential
from fmus.compliance.fmu_file import CO_SIMULATION, FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, NotJudgedError, behaviour_rule
from fmus.compliance.rules.derivatives import NOISE, values_of
from fmus.compliance.script import Script
from fmus.compliance.texts import PENDED
from fmus.compliance.traces import table
from fmus.compliance.variable import Variable
from fmus.fmi.binding import DISCARD, ERROR, FATAL, PENDING

_ASYNCHRONOUS = "canRunAsynchronuously"
_MORE_STEPS = (13, 47, 211)  # instead of two: for each internal step from the usual size to a hundredth
_LEAST_TOLERANCE = 1e-12  # a slave may ignore it (2.1.6)
_LONG = 100  # usual steps in one
_MOST_READ = 100  # steps after each of which the time is read
_APART = 0.4  # of the change over two steps: a rough solver, but not half a step


@differential("2.1.6")
def undefined_arguments_are_ignored(probe: Probe) -> Iterator[Row]:
    """A tolerance or a stop time that is not defined has no effect."""
    before, early = probe.start_time - 1.0, probe.point(1)
    for tolerance, stop_time, when, over in (
        (0.0, before, "where an undefined stop time lies before the start time", [do.run(2)]),
        (0.0, early, "where an undefined stop time is the end of the first step", [do.run(4)]),
        (0.1, before, "where an undefined tolerance is 0.1", [do.leap(1), do.read_all()] * 3),
    ):
        arguments = 0, tolerance, probe.start_time, 0, stop_time
        begin = do.call("fmi2SetupExperiment", *arguments), do.enter_initialization_mode
        varied = *begin, do.exit_initialization_mode, *over
        yield Row(when, varied, (do.begin, *over), "with neither tolerance nor stop time defined")


@differential("2.1.6")
def tolerance_is_accepted(_: Probe) -> Iterator[Row]:
    """A tolerance that is defined is accepted, also one that the FMU does not reach."""
    yield Row(f"with the tolerance {table.TOLERANCE:g}", table.WITH_TOLERANCE, ())
    varied = *do.begin_until(1000, _LEAST_TOLERANCE), do.step()
    yield Row(f"with the tolerance {_LEAST_TOLERANCE:g}", varied, ())


def _without_independent(fmu: FmuFile) -> str:
    return "" if any(v.causality == "independent" for v in fmu.variables) else "no variable is independent"


@behaviour_rule("2.2.7", condition=_without_independent)
def time_is_the_communication_point(probe: Probe) -> Iterator[str]:
    """The independent variable is the start time after initialisation, and then the end of the last step,
    also of its multiples: after a fraction, an FMU of fixed internal steps may be behind. So it is after
    fmi2Reset, with a tolerance, a stop time and another start time, and in the default experiment.
    """
    (v,) = [v for v in probe.fmu.variables if v.causality == "independent"][:1]
    if not probe.states_step_size and not probe.fmu.is_model_exchange:
        raise NotJudgedError("no step size is stated, and an internal step may be longer than others")
    for script, times in _runs(probe, v):
        failure = script.failure
        # a discarded step may leave values of a time within the step
        if failure and failure.status == DISCARD:
            continue
        readings = zip(times, script.readings, strict=True)
        for (t, where), reading in itertools.takewhile(lambda row: row[1].ok, readings):
            got = reading.values[v.name]
            if not abs(got - t) <= 1e-3 * probe.step_size + 1e-9 * abs(t):
                shown = values.texts(got, t)
                yield f"{v.name} is {shown[0]} {where.format(t)}: expected {shown[1]}"
                return


def _runs(probe: Probe, v: Variable) -> Iterator[tuple[Script, Sequence[tuple[float, str]]]]:
    """Yields runs in which a variable is read, with the reading times as numbers and in words."""
    initialised, point = "after initialisation with startTime {:g} s", "at the communication point {:g} s"
    # a slave of fixed internal steps may be behind after a fraction
    exchanged = (1.0, 2.0, 0.30901699) if probe.fmu.is_model_exchange else (1.0, 1.0, 1.0)
    factors = (0.0, *((1.0, 2.0, 3.0) if probe.fmu.claims(values.ANY_STEP) else exchanged))
    tolerance = table.LARGE_TOLERANCE if table.run_with_tolerance(probe).succeeded else None
    again = do.begin, do.step(), do.reset, *do.begin_until(1000, tolerance, start=3)
    for start, begin in ((0, (do.begin,)), (3, again)):
        times = [probe.point(start) + x * probe.step_size for x in itertools.accumulate(factors)]
        steps = (do.call("do_step", t, end - t) for t, end in itertools.pairwise(times))
        read = itertools.chain(*((step, do.read([v])) for step in steps))
        words = itertools.chain([initialised], itertools.repeat(point))
        yield do.played(probe, [*begin, do.read([v]), *read]), [*zip(times, words, strict=False)]
    # 4.2.4 does not list it among what is read
    below = -3 - int(probe.start_time / probe.step_size)
    for start in (3, below):
        at_first = do.forbidden, do.set_up(1000, start=start), do.enter_initialization_mode, do.read([v])
        when = probe.point(start), "in initialization mode with startTime {:g} s"
        yield do.played(probe, at_first), [when]
    # without a long run, only the times before are judged
    with suppress(NotApplicableError, NotJudgedError):
        whole = do.over_the_experiment(probe)
        count, steps = len(whole.observed), do.steps_of_experiment(probe)
        yield whole, [(probe.point(steps * i // count), point) for i in range(1, count + 1)]
        count = min(steps, _MOST_READ)
        each = do.played(probe, [do.begin, *(do.step(), do.read([v])) * count])
        yield each, [(probe.point(i), point) for i in range(1, count + 1)]


@behaviour_rule("4.2.2", interface=CO_SIMULATION)
def communication_points_may_be_rounded(probe: Probe) -> Iterator[str]:
    """Communication points may be sums of step sizes or multiples of one: their rounding is no error."""
    sums = itertools.accumulate([probe.step_size] * 29, initial=probe.start_time)
    points = (t if i % 2 else probe.point(i) for i, t in enumerate(sums))
    steps = (do.call("do_step", t, probe.step_size) for t in points)
    failure = do.played(probe, [do.begin, *steps], logging=True).failure
    if failure and failure.status != DISCARD:
        yield failure.problem


@differential("4.2.2")
def no_set_state_flag_changes_nothing(probe: Probe) -> Iterator[Row]:
    """noSetFMUStatePriorToCurrentPoint = fmi2True is accepted, and the values are the same."""
    read = do.read([v for v in probe.fmu.variables if v.causality != "independent"])
    varied = do.start, *(do.step(no_going_back=True), read) * 3
    when = "with noSetFMUStatePriorToCurrentPoint"
    yield Row(when, varied, (do.start, *(do.step(), read) * 3), failing="")


@behaviour_rule("4.3.1", condition=values.unless_claimed(values.ANY_STEP))
def variable_step_size(probe: Probe) -> Iterator[str]:
    """Steps of different sizes succeed one after the other; one that is longer may be discarded."""
    script = probe.script(do.begin, logging=True)
    ends = [probe.start_time]
    for factor in (1.0, 0.5, 2.0, 0.25, 1.5):
        script.call("do_step", ends[-1], factor * probe.step_size)
        ends.append(ends[-1] + factor * probe.step_size)
    script.play(keep_going=True)
    if failure := script.failure:
        number = sum(reply.is_step and reply.ok for reply in script.replies)
        size = ends[number + 1] - ends[number]
        if failure.status != DISCARD or size < 0.9 * probe.step_size:
            yield f"a step of {size:g} s after one of {probe.step_size:g} s: {failure.problem}"


@behaviour_rule("4.3.1", condition=values.unless_claimed(values.ANY_STEP))
def two_steps_are_one_of_twice_the_size(probe: Probe) -> Iterator[str]:
    """A step reaches its end: after a step, two more bring continuous outputs about as far as one of twice
    the size, or many of no simple fraction of it.
    """
    if not (chosen := values.continuous_reals(probe, "output")):
        raise NotApplicableError("there is no continuous output")
    counts, span, read = (2, 1, *_MORE_STEPS), 2 * probe.step_size, do.read(chosen)
    steps = ([do.call("do_step", probe.point(1) + i * span / n, span / n) for i in range(n)] for n in counts)
    usual, *others = values_of(probe, [(do.begin, do.step(), read, *equal, read) for equal in steps])
    if not usual or not any(others):
        raise NotJudgedError("no step of twice the size succeeds")
    before, two = usual
    changes = {name: x - before[name] for name, x in two.items() if abs(x - before[name]) > NOISE * abs(x)}
    for n, run in zip(counts[1:], others, strict=True):
        # variables with the same digits follow time alone
        errors = {name: abs(run[1][name] - two[name]) for name in changes if run}
        apart = {name: x for name, x in errors.items() if x > NOISE * abs(two[name])}
        if apart and all(x > _APART * abs(changes[name]) for name, x in apart.items()):
            name = min(apart)
            shown = values.texts(run[1][name], two[name])
            what = f"{name} is {shown[0]} after {n} step{'s' * (n > 1)} of {span / n:g} s"
            yield f"{what}: expected about {shown[1]}, as after two of {probe.step_size:g} s"
            return


@behaviour_rule("2.2.5, 4.1.1")
def default_experiment_runs(probe: Probe) -> Iterator[str]:
    """The steps of DefaultExperiment succeed up to its stop time, or up to a limit of CPU time."""
    if not probe.states_step_size or not math.isfinite(probe.stop_time):
        raise NotApplicableError("no stop time and step size are stated")
    failure = do.over_the_experiment(probe).failure
    if failure and failure.status != DISCARD:
        yield failure.problem


@differential("2.1.6", interface=CO_SIMULATION)
def steps_past_the_stop_time_are_refused(_: Probe) -> Iterator[Row]:
    """A step past a stop time that is defined returns error."""
    finding = "{reply.function} past the stop time {reply.status_name}: expected error"
    varied = *do.begin_until(0.5), do.error(do.step(), finding, ERROR, FATAL)
    yield Row("", varied, (), may_fail=True)


# steps that are pending


@behaviour_rule("4.2.2", condition=values.if_not_claimed(_ASYNCHRONOUS), interface=CO_SIMULATION)
def steps_are_not_pending(probe: Probe) -> Iterator[str]:
    """Without canRunAsynchronuously, fmi2DoStep does not return pending, in the default experiment either."""
    finding = "{reply.function} {reply.status_name}: expected no pending step"
    for count in (1, _LONG):
        step = do.call("fmi2DoStep", probe.start_time, count * probe.step_size, 0)
        refused = do.error(step, finding, *range(PENDING))
        yield from differences(probe, table.in_states(probe, "B", refused))
    with suppress(NotApplicableError, NotJudgedError):
        replies = do.over_the_experiment(probe).replies
        if PENDED in {what for reply in replies for what, *_ in reply.changed}:
            yield "fmi2DoStep returned pending in the default experiment: expected no pending step"

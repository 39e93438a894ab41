"""Several instances in one process: what one does changes nothing in another."""

import itertools
import time
from collections.abc import Iterator

from fmus.compliance.comparison import differing, failing_or_differing
from fmus.compliance.fmu_file import ONLY_ONCE
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotJudgedError, behaviour_rule
from fmus.compliance.values import if_not_claimed, other_values, settable_before
from fmus.fmi.binding import ERROR

_STATUS = "2.1.3 Status Returned by Functions"
_CREATION = "2.1.5 Creation, Destruction and Logging of FMU Instances"
_FLAGS = "4.3.1 Co-Simulation FMU (CoSimulation)"
_STEPS, _INSTANCES = 5, 10
_MOST_CHANGED = 50  # variables
_LARGEST_REFERENCE = 2**32 - 1


@behaviour_rule(f"{_FLAGS}: {ONLY_ONCE}", condition=if_not_claimed(ONLY_ONCE))
def several_instances(probe: Probe) -> Iterator[str]:
    """Instances live side by side: values and steps of one change nothing in another."""
    alone = probe.script().begin()
    expected = alone.run(_STEPS)
    alone.play()
    one, other, changed = (probe.script(name=f"instance {i}") for i in range(3))
    one.begin()
    first = one.run(2)
    one.pause()
    for v, x in other_values(settable_before(probe.fmu)[:_MOST_CHANGED]):
        changed.set(v, x)
    changed.initialise()
    second = other.begin().run(_STEPS)
    first += one.run(_STEPS - 2)
    probe.play(one, changed, other, keep_going=True)
    for script in (one, other):
        if script.failure:
            yield f"beside another instance: {script.failure.problem}"
            return
    yield from differing(expected, second, "beside another instance")
    yield from differing(expected, first, "beside another instance")


@behaviour_rule(_CREATION, condition=if_not_claimed(ONLY_ONCE))
def instances_follow_each_other(probe: Probe) -> Iterator[str]:
    """After some instances that were used and freed, fewer of a slow FMU, another one takes a step."""
    half = (time.monotonic() + probe.process.deadline) / 2
    for _ in range(_INSTANCES):
        probe.script().begin().step().play()
        if time.monotonic() > half:
            break
    yield from ()


@behaviour_rule(_STATUS, needs="several-instances reset-gives-the-start-values")
def error_leaves_other_instances_unchanged(probe: Probe) -> Iterator[str]:
    """After an error, other instances go on as before, and fmi2Reset brings the instance back."""
    alone = probe.script().begin()
    expected = alone.run(3)
    alone.play()
    failing = probe.script().begin().step()
    failing.pause()
    error = failing.call("get", "Real", [unknown_reference(probe)])
    failing.pause()
    failing.reset()
    failing.begin()
    again = failing.run(3)
    others = [] if probe.fmu.claims(ONLY_ONCE) else [probe.script().begin()]
    readings = others[0].run(1) + others[0].pause().pause().run(2) if others else []
    probe.play(failing, *others, keep_going=True)
    if error.status != ERROR:
        raise NotJudgedError("no call that returns error is known")
    for script in others:
        if script.failure:
            yield f"beside an instance in error: {script.failure.problem}"
            return
        yield from differing(expected, readings, "beside an instance in error")
    failure = next((r for r in failing.replies[failing.replies.index(error) + 1 :] if not r.ok), None)
    if failure:
        yield f"after an error: {failure.problem}"
    else:
        yield from differing(expected, again, "after an error and fmi2Reset", probe.tolerance)


def unknown_reference(probe: Probe) -> int:
    """Returns a value reference far from the variables': some without an entry may lie between."""
    used = {v.reference or 0 for v in probe.fmu.variables}
    far = max(used, default=0) + 1000
    return far if far <= _LARGEST_REFERENCE else next(i for i in itertools.count() if i not in used)


@behaviour_rule(_CREATION, condition=if_not_claimed(ONLY_ONCE), needs="several-instances")
def freed_instance_changes_no_other(probe: Probe) -> Iterator[str]:
    """Others go on as before where one instance is freed."""
    alone, freed, other = probe.script().begin(), probe.script().begin(), probe.script(name="other").begin()
    expected = alone.run(3)
    alone.play()
    got = other.run(1)
    freed.step()
    other.pause()
    freed.pause().pause()
    freed.call("free")
    other.pause().pause()
    got += other.run(2)
    probe.play(freed, other, keep_going=True)
    yield from failing_or_differing(other, expected, got, "after another instance was freed")

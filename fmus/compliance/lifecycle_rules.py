"""Behaviour that every FMU for co-simulation owes: it is loaded, created, initialised, stepped, reset
and freed.
"""

import itertools
import math
from collections.abc import Callable, Iterator

from fmus.binding import ERROR
from fmus.compliance.probe import Probe, refusal
from fmus.compliance.rule import Level, NotJudgedError, Stage, rule
from fmus.compliance.script import CallError, Reading, Script
from fmus.compliance.values import (
    differing,
    if_not_claimed,
    other_value,
    readable_in_initialization,
    settable_before,
    start_value,
    texts,
)  # fmt: skip
from fmus.compliance.variable import Variable

_NAMING = "2.1.1 Header Files and Naming of Functions"
_STATUS = "2.1.3 Status Returned by Functions"
_CREATION = "2.1.5 Creation, Destruction and Logging of FMU Instances"
_INITIALIZATION = "2.1.6 Initialization, Termination, and Resetting an FMU"
_FLAGS = "4.3.1 Co-Simulation FMU (CoSimulation)"
_ONLY_ONCE = "canBeInstantiatedOnlyOncePerProcess"
_OWN_MEMORY = "canNotUseMemoryManagementFunctions"
_WRONG_GUID = "{00000000-0000-0000-0000-000000000000}"
_ROUNDED = 1e-6  # relative: tools write start values with as few as seven digits
_LARGEST_REFERENCE = 2**32 - 1
_STEPS = 5
_MOST_CHANGED = 50  # variables
_CYCLES, _LEAST_LEAK = 8, 512  # lives of an instance; bytes that each of them leaves


@rule(_NAMING, Stage.BEHAVIOUR)
def library_loads(probe: Probe) -> Iterator[str]:
    """The library of this platform loads, and has every function of FMI 2.0 for co-simulation."""
    probe.ask("load")
    yield from ()


@rule(_CREATION, Stage.BEHAVIOUR)
def instantiates_and_frees(probe: Probe) -> Iterator[str]:
    """An instance is created, freed, and created and freed again."""
    for _ in range(2):
        created, messages = probe.creates(logging=True)
        if not created:
            yield refusal(messages)
            return


@rule("2.1.4 Inquire Platform and Version Number of Header Files", Stage.BEHAVIOUR)
def library_version(probe: Probe) -> Iterator[str]:
    """fmi2GetVersion is 2.0 and fmi2GetTypesPlatform default."""
    for function, expected in (("GetVersion", "2.0"), ("GetTypesPlatform", "default")):
        got = probe.ask("text", f"fmi2{function}")
        if got != expected:
            yield f"fmi2{function} is {got!r}: expected {expected!r}"


@rule(_CREATION, Stage.BEHAVIOUR)
def free_of_null_is_ignored(probe: Probe) -> Iterator[str]:
    """fmi2FreeInstance of NULL does nothing."""
    probe.ask("free_of_null")
    yield from ()


@rule("4.2.2 Computation (fmi2DoStep)", Stage.BEHAVIOUR)
def steps_and_terminates(probe: Probe) -> Iterator[str]:
    """It is initialised; equal steps of the default experiment's size succeed, then fmi2Terminate."""
    script = probe.script(logging=True).begin().step(_STEPS)
    script.terminate()
    probe.play_usual_steps(script)
    yield from ()


@rule("4.2.4 State Machine of Calling Sequence from Master to Slave", Stage.BEHAVIOUR)
def frees_in_every_state(probe: Probe) -> Iterator[str]:
    """fmi2FreeInstance is allowed when instantiated, in initialization mode, and while stepping."""
    for script in (probe.script(), probe.script().initialise(), probe.script().begin().step()):
        script.play()
    yield from ()


@rule("4.1.2 Mathematical Model", Stage.BEHAVIOUR)
def runs_are_repeatable(probe: Probe) -> Iterator[str]:
    """The same calls give the same outputs in every instance."""
    one, other = probe.script().begin(), probe.script(visible=False).begin()
    first, second = one.run(5), other.run(5)
    one.play()
    other.play()
    yield from differing(first, second, "in a second instance")


@rule(_CREATION, Stage.BEHAVIOUR, Level.WARNING)
def wrong_guid_is_refused(probe: Probe) -> Iterator[str]:
    """fmi2Instantiate returns NULL for a GUID that is not the description's."""
    if probe.creates(guid=_WRONG_GUID)[0]:
        yield "fmi2Instantiate gave an instance for a wrong GUID: expected NULL"


@rule(_CREATION, Stage.BEHAVIOUR)
def failed_instantiation_is_logged(probe: Probe) -> Iterator[str]:
    """If fmi2Instantiate returns NULL, the logger was called with the reason."""
    created, messages = probe.creates(guid=_WRONG_GUID, logging=True)
    if created:
        raise NotJudgedError("fmi2Instantiate returns an instance for a wrong GUID")
    if not any(message.text.strip() for message in messages):
        yield "fmi2Instantiate returned NULL for a wrong GUID and logged nothing: expected the reason"


@rule(_CREATION, Stage.BEHAVIOUR)
def resource_locations_of_both_forms(probe: Probe) -> Iterator[str]:
    """The location of the resources may be a URI with or without authority: file:///path and file:/path."""
    usual = probe.ask("resource_location")
    expected = probe.script(location=usual).begin()
    first = expected.run(2)
    expected.play()
    yield from _with_location(probe, usual.replace("file:///", "file:/", 1), first)


@rule(_CREATION, Stage.BEHAVIOUR, Level.WARNING)
def resource_location_is_decoded(probe: Probe) -> Iterator[str]:
    """The location of the resources is a URI of RFC 3986: %20 in it is a space of the path."""
    script = probe.script().begin()
    first = script.run(2)
    script.play()
    try:
        location = probe.ask("link", "a folder")
    except CallError as error:  # an operating system without links
        raise NotJudgedError(str(error)) from error
    yield from _with_location(probe, location, first)


def _with_location(probe: Probe, location: str, expected: list[Reading]) -> Iterator[str]:
    script = probe.script(location=location, logging=True).begin()
    got = script.run(len(expected))
    try:
        script.play()
    except CallError as error:
        yield (
            "with the resource location "
            f"{location.split('/', maxsplit=1)[0]}{'/' * location[5:].count('/', 0, 3)}...: {error}"
        )
        return
    yield from differing(expected, got, f"with the resource location {location}")


@rule(_FLAGS + ": needsExecutionTool", Stage.BEHAVIOUR, condition=if_not_claimed("needsExecutionTool"))
def needs_no_tool(probe: Probe) -> Iterator[str]:
    """Without needsExecutionTool, the FMU runs here although no program can be found by the search path."""
    before = probe.ask("set_search_path", "")
    try:
        probe.script(logging=True).begin().step().play()
    finally:
        probe.ask("set_search_path", before)
    yield from ()


@rule("2.1.7 Getting and Setting Variable Values", Stage.BEHAVIOUR)
def start_values_are_as_declared(probe: Probe) -> Iterator[str]:
    """In initialization mode, variables with initial exact and inputs have their start values."""
    yield from _not_at_start(probe, lambda: probe.script().initialise(), keep_going=False)


def _with_start(probe: Probe) -> list[Variable]:
    chosen = (
        v
        for v in probe.fmu.variables
        if v.variability != "constant" and (v.initial == "exact" or v.causality == "input")
    )
    return [v for v in chosen if start_value(v) is not None]


def _not_at_start(probe: Probe, initialise: Callable[[], Script], keep_going: bool) -> Iterator[str]:
    """Messages of values that are not the start values.

    initialise: a new script, up to initialization mode; keep_going: whether its calls may fail
    """
    script = initialise()
    reading = script.read(_with_start(probe))
    script.play(keep_going=True)
    if reading.ok:
        yield from _other_values(probe, reading)
        return
    readable = readable_in_initialization(probe.fmu)  # 4.2.4 lets only these be read there
    script = initialise()
    at_first = script.read(v for v in _with_start(probe) if v in readable)
    script.play(keep_going=True)
    script = initialise().exit_initialization_mode()
    later = script.read(v for v in _with_start(probe) if v.causality in ("parameter", "input"))
    script.play(keep_going=keep_going)
    for reading in (at_first, later):
        if reading.ok:
            yield from _other_values(probe, reading)


def _other_values(probe: Probe, reading: Reading) -> Iterator[str]:
    variables = {v.name: v for v in probe.fmu.variables}
    for name, got in reading.values.items():
        expected = start_value(variables[name])
        if isinstance(got, bytes):
            if got.decode("utf-8", "replace") != expected:
                yield (
                    f"{name} is {got.decode('utf-8', 'replace')!r} at first: expected its start "
                    f"value {expected!r}"
                )
        elif got is None or not math.isclose(got, expected, rel_tol=_ROUNDED, abs_tol=1e-300):
            shown = texts(got, expected)
            yield f"{name} is {shown[0]} at first: expected its start value {shown[1]}"


@rule("4.2.4 State Machine of Calling Sequence from Master to Slave", Stage.BEHAVIOUR)
def reset_in_every_state(probe: Probe) -> Iterator[str]:
    """fmi2Reset is allowed when instantiated, in initialization mode, while stepping and after
    fmi2Terminate.
    """
    for state in range(4):
        script = probe.script(logging=True)
        if state == 1:
            script.initialise()
        elif state > 1:
            script.begin().step()
        if state == 3:
            script.terminate()
        name = script.state
        script.reset()
        script.begin().step()
        try:
            script.play()
        except CallError as error:
            yield f"after fmi2Reset in the state {name!r}: {error}"


@rule(_INITIALIZATION, Stage.BEHAVIOUR, needs=["start-values-are-as-declared", "reset-in-every-state"])
def reset_gives_the_start_values(probe: Probe) -> Iterator[str]:
    """After other values, steps and fmi2Reset, start values are back and the same steps give the same
    outputs.
    """
    script = probe.script(logging=True).begin()
    first = script.run(_STEPS)
    script.reset()
    script.begin()
    again = script.run(_STEPS)
    script.play()
    yield from differing(first, again, "after fmi2Reset")
    yield from _not_at_start(probe, lambda: _reset_after_other_values(probe), keep_going=True)


def _reset_after_other_values(probe: Probe) -> Script:
    """A script that sets other values, resets and enters initialization mode."""
    script = probe.script(logging=True)
    for v in settable_before(probe.fmu)[:_MOST_CHANGED]:
        if (value := other_value(v)) is not None:
            script.set(v, value)
    script.reset()
    return script.initialise()


@rule(f"{_FLAGS}: {_ONLY_ONCE}", Stage.BEHAVIOUR, condition=if_not_claimed(_ONLY_ONCE))
def several_instances(probe: Probe) -> Iterator[str]:
    """Instances live side by side: values and steps of one change nothing in another."""
    alone = probe.script().begin()
    expected = alone.run(_STEPS)
    alone.play()
    one, other, changed = (probe.script(name=f"instance {i}") for i in range(3))
    one.begin()
    first = one.run(2)
    one.pause()
    for v in settable_before(probe.fmu)[:_MOST_CHANGED]:
        if (value := other_value(v)) is not None:
            changed.set(v, value)
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


@rule(_STATUS, Stage.BEHAVIOUR, needs=["several-instances", "reset-gives-the-start-values"])
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
    others = [] if probe.fmu.claims(_ONLY_ONCE) else [probe.script().begin()]
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
        yield from differing(expected, again, "after an error and fmi2Reset")


def unknown_reference(probe: Probe) -> int:
    """A value reference that no variable has, far from others: variables without an entry may lie between."""
    used = {v.reference or 0 for v in probe.fmu.variables}
    far = max(used, default=0) + 1000
    return far if far <= _LARGEST_REFERENCE else next(i for i in itertools.count() if i not in used)


@rule(f"{_FLAGS}: {_OWN_MEMORY}", Stage.BEHAVIOUR, condition=if_not_claimed(_OWN_MEMORY))
def memory_is_freed(probe: Probe) -> Iterator[str]:
    """What an instance takes by allocateMemory it gives back by freeMemory, and nothing else."""
    held_before, frees_before = probe.ask("held_blocks"), probe.ask("foreign_frees")
    script = probe.script().begin().step()
    if probe.fmu.claims("canGetAndSetFMUstate"):
        script.call("get_fmu_state", 0)
        script.call("free_fmu_state", 0)
    script.terminate()
    script.play()
    held, foreign_frees = probe.ask("held_blocks"), probe.ask("foreign_frees")
    if held > held_before:
        yield f"{held - held_before} blocks are still held after fmi2FreeInstance: expected none"
    if foreign_frees > frees_before:
        yield f"{foreign_frees - frees_before} addresses were freed that were never given: expected none"


def _lives(probe: Probe) -> list[dict[str, int]]:
    """Resources in use after each of several lives of an instance."""

    def live() -> list[dict[str, int]]:
        counts = []
        for _ in range(_CYCLES + 2):
            probe.script().begin().step().play()
            counts.append(probe.ask("resources_in_use"))
        return counts[2:]

    return probe.once("life of several instances", live)


@rule(_CREATION, Stage.BEHAVIOUR)
def resources_are_freed(probe: Probe) -> Iterator[str]:
    """fmi2FreeInstance closes the files and ends the threads of an instance."""
    counts = _lives(probe)
    for name in ("open files", "threads"):
        numbers = [count.get(name, 0) for count in counts]
        if all(b > a for a, b in itertools.pairwise(numbers)):
            more = numbers[-1] - numbers[0]
            yield f"{more} more {name} after {_CYCLES - 1} instances were created and freed: expected none"


@rule(_CREATION, Stage.BEHAVIOUR, Level.WARNING)
def memory_does_not_grow(probe: Probe) -> Iterator[str]:
    """fmi2FreeInstance frees all memory: the heap does not grow with each instance that is created and
    freed.
    """
    heap = [count["heap"] for count in _lives(probe)]
    growth = [b - a for a, b in itertools.pairwise(heap)]
    if min(growth) >= _LEAST_LEAK:
        yield (
            f"the heap grows by {min(growth)} bytes with each instance that is created and freed: "
            "expected none"
        )

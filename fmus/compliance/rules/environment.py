"""Surroundings of instances: callbacks, arguments of fmi2Instantiate, memory, files, threads, locations."""

import itertools
from collections.abc import Iterator
from statistics import median
from typing import Any

from fmus.compliance import actions as do
from fmus.compliance import values
from fmus.compliance.differential import Row, differences, differential
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotJudgedError, behaviour_rule
from fmus.compliance.script import Action, CallError
from fmus.compliance.traces.table import tour
from fmus.fmi.binding import DISCARD

_OWN_MEMORY = "canNotUseMemoryManagementFunctions"
_NAME = "system.subsystem[2].'instance with its name'.part"
_CYCLES, _PARTS = 8, 4  # instances; parts of a second look, of as many
LEAST_LEAK = 64  # bytes that each instance leaves
_WARM_UP = 18  # instances before: memory that the heap keeps for reuse hides the first leaks


def _with_a_state(probe: Probe) -> tuple[Action, ...]:
    """Returns actions that set values, take a step, and save a state and free it, if the FMU claims that."""
    set_values = do.set_values(values.start_values(probe.fmu.settable_in_initialization))
    saved = (do.save(), do.free_state()) if probe.fmu.claims(values.SAVES) else ()
    return do.initialise, set_values, do.exit_initialization_mode, do.step(), *saved


@behaviour_rule("2.1.5")
def arguments_of_instantiation_are_copied(probe: Probe) -> Iterator[str]:
    """Name, GUID and resource location are not used after fmi2Instantiate returned; a long name is kept
    whole.
    """
    actions = do.set_debug_logging(True), do.begin, do.run(2), do.reset, do.begin, do.step()
    when = "after the arguments of fmi2Instantiate were overwritten"
    options: dict[str, Any] = {"name": _NAME, "overwritten": True}
    yield from differences(probe, [Row(when, actions, (do.begin, do.run(2)), options=options)])
    script = do.played(probe, actions, logging=True, **options)
    names = {m.instance or "" for reply in script.replies for m in reply.messages}
    if any({*name} == {"#"} for name in names):
        yield "messages carry the overwritten instance name: expected a copy of it"
    elif cut := sorted(name for name in names - {_NAME, ""} if _NAME.startswith(name)):
        yield f"messages carry the instance name {cut[0]!r}: expected {_NAME!r}"


@behaviour_rule("2.1.5")
def optional_callbacks_may_be_null(probe: Probe) -> Iterator[str]:
    """stepFinished and componentEnvironment may be NULL, over the default experiment."""
    actions, options = (do.start, do.run(2), do.terminate), {"callbacks": "fewest"}
    when = "without stepFinished and environment"
    yield from differences(probe, [Row(when, actions, actions, options=options)])
    failure = do.played(probe, (do.begin, do.leap(3, True)), logging=True, **options).failure
    if failure and failure.status != DISCARD:
        yield f"{when}: {failure.problem}"


@behaviour_rule("4.3.1", condition=values.unless_claimed(_OWN_MEMORY))
def memory_functions_may_be_null(probe: Probe) -> Iterator[str]:
    """With canNotUseMemoryManagementFunctions, allocateMemory and freeMemory may be NULL, and are not
    called.
    """
    tour(probe)
    if probe.ask("blocks")["given"]:
        yield f"allocateMemory was called: expected no call, as {_OWN_MEMORY} is claimed"
    varied, options = (*_with_a_state(probe), do.terminate), {"callbacks": "no memory"}
    yield from differences(probe, [Row("without memory functions", varied, varied, options=options)])


# resources that fmi2FreeInstance frees


@behaviour_rule("4.3.1", condition=values.if_not_claimed(_OWN_MEMORY))
def memory_is_freed(probe: Probe) -> Iterator[str]:
    """An instance frees all memory of allocateMemory by freeMemory, and no other memory, also if it is
    initialised again after fmi2Reset.
    """
    before = probe.ask("blocks")
    actions = *_with_a_state(probe), do.terminate, do.reset, do.begin, do.step()
    probe.script(do.ignore(*actions)).play(keep_going=True)
    more = {name: count - before[name] for name, count in probe.ask("blocks").items()}
    if more["held"] > 0:
        yield f"{more['held']} blocks are still held after fmi2FreeInstance: expected none"
    if more["foreign frees"] > 0:
        yield f"{more['foreign frees']} addresses were freed that were never given: expected none"


def _resources_in_use(probe: Probe) -> list[dict[str, int]]:
    """Resources in use after each of several instances was created, used and freed."""
    return probe.once("use of several instances", lambda: _used_instances(probe, _CYCLES))


def _used_instances(probe: Probe, cycles: int) -> list[dict[str, int]]:
    """Uses some instances, the first of which warm the process up: in each, an instantiation fails, then
    values, steps, states and fmi2Reset are called.
    """
    by_bytes = do.call("state_bytes", 0), do.copy(0, 1), do.free_state(1)
    copied = by_bytes if probe.fmu.claims(values.SERIALISES) else ()
    states = do.save(), do.save(), *copied, do.restore(), do.free_state()
    actions = (
        *do.set_at_once(values.start_values(probe.fmu.settable_before[:do.MOST_VARIABLES])),
        do.begin, do.step(3),
        *(states if probe.fmu.claims(values.SAVES) else ()), do.terminate, do.reset, do.begin, do.step(2),
    )  # fmt: skip
    counts = []
    for _ in range(cycles + _WARM_UP):
        probe.creates(guid="no GUID of this FMU")
        probe.script(do.ignore(*actions)).play(keep_going=True)
        counts.append(probe.ask("resources_in_use"))
    return counts[_WARM_UP:]


@behaviour_rule("2.1.5")
def resources_are_freed(probe: Probe) -> Iterator[str]:
    """fmi2FreeInstance closes the files and ends the threads of an instance."""
    counts = _resources_in_use(probe)
    for name in ("open files", "threads"):
        numbers = [count.get(name, 0) for count in counts]
        if all(b > a for a, b in itertools.pairwise(numbers)):
            more = numbers[-1] - numbers[0]
            yield f"{more} more {name} after {_CYCLES - 1} instances were created and freed: expected none"


# in a new process the heap keeps memory for reuse, which hides small leaks
@behaviour_rule("2.1.5", last=True)
def memory_does_not_grow(probe: Probe) -> Iterator[str]:
    """fmi2FreeInstance frees all memory: the heap does not grow with each instance that is created and
    freed.
    """
    growth = growth_of_the_heap(_resources_in_use(probe))
    if growth >= LEAST_LEAK:
        growth = min(growth, growth_of_the_heap(_used_instances(probe, _PARTS * _CYCLES)))
    if growth >= LEAST_LEAK:
        yield f"an instance that is created and freed leaves {growth:g} bytes in the heap: expected none"


def growth_of_the_heap(counts: list[dict[str, int]]) -> float:
    """Returns the heap growth per instance in bytes: the median slope within each part of the counts, then
    the smallest part.
    """

    # a leak grows in every part, a cache once; the median passes over memory that is taken and freed by turns
    def slope(part: list[dict[str, int]]) -> float:
        pairs = itertools.combinations(enumerate(count["heap"] for count in part), 2)
        return median((later - earlier) / (j - i) for (i, earlier), (j, later) in pairs)

    return min(slope(counts[i : i + _CYCLES]) for i in range(0, len(counts), _CYCLES))


# locations


@differential("2.1.5")
def resource_locations_of_both_forms(probe: Probe) -> Iterator[Row]:
    """The location of the resources may be a URI with or without authority: file:///path and file:/path."""
    yield _with_location(probe.ask("resource_location").replace("file:///", "file:/", 1))


@differential("2.1.5")
def resource_location_is_decoded(probe: Probe) -> Iterator[Row]:
    """The location of the resources is a URI of RFC 3986: %20 in it is a space of the path."""
    yield _with_location(_link(probe, "a folder"))


def _link(probe: Probe, name: str) -> str:
    try:
        return probe.ask("link", name)
    except CallError as error:
        # the operating system may have no links
        raise NotJudgedError(str(error)) from error


def _with_location(location: str) -> Row:
    when = f"with the resource location {location}"
    return Row(when, (do.begin, do.run(2)), options={"location": location})

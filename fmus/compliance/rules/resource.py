"""Memory, files and threads of instances, which fmi2FreeInstance frees."""

import itertools
from collections.abc import Iterator
from statistics import median

from fmus.compliance.probe import Probe
from fmus.compliance.rule import behaviour_rule
from fmus.compliance.values import if_not_claimed, settable_before, start_value

_CREATION = "2.1.5 Creation, Destruction and Logging of FMU Instances"
_FLAGS = "4.3.1 Co-Simulation FMU (CoSimulation)"
_OWN_MEMORY = "canNotUseMemoryManagementFunctions"
_USED = "serialised-state-restores state-restores reset-in-every-state"
_MOST_SET = 50  # variables
_CYCLES, _LEAST_LEAK = 8, 1024  # instances; bytes that each of them leaves


@behaviour_rule(f"{_FLAGS}: {_OWN_MEMORY}", condition=if_not_claimed(_OWN_MEMORY))
def memory_is_freed(probe: Probe) -> Iterator[str]:
    """An instance gives back by freeMemory what it took by allocateMemory, and nothing else, also if it is
    initialised again after fmi2Reset.
    """
    held_before, frees_before = probe.ask("held_blocks"), probe.ask("foreign_frees")
    script = probe.script().begin().step()
    if probe.fmu.claims("canGetAndSetFMUstate"):
        script.call("get_fmu_state", 0)
        script.call("free_fmu_state", 0)
    script.terminate()
    script.reset()
    script.begin().step().play(keep_going=True)
    held, foreign_frees = probe.ask("held_blocks"), probe.ask("foreign_frees")
    if held > held_before:
        yield f"{held - held_before} blocks are still held after fmi2FreeInstance: expected none"
    if foreign_frees > frees_before:
        yield f"{foreign_frees - frees_before} addresses were freed that were never given: expected none"


def _resources_in_use(probe: Probe) -> list[dict[str, int]]:
    """Resources in use after each of several instances was created, used and freed."""

    return probe.once("use of several instances", lambda: _used_instances(probe)[2:])


def _used_instances(probe: Probe) -> list[dict[str, int]]:
    counts = []
    for _ in range(_CYCLES + 2):
        _use_an_instance(probe)
        counts.append(probe.ask("resources_in_use"))
    return counts


def _use_an_instance(probe: Probe) -> None:
    """Plays an instantiation that fails, and an instance that is used and freed: values, steps, states and
    fmi2Reset.
    """
    probe.creates(guid="no GUID of this FMU")
    script = probe.script()
    for v in settable_before(probe.fmu)[:_MOST_SET]:
        if (value := start_value(v)) is not None:
            script.set(v, value)
    script.begin().step(3)
    if probe.fmu.claims("canGetAndSetFMUstate"):
        script.call("get_fmu_state", 0)
        script.call("get_fmu_state", 0)
        if probe.fmu.claims("canSerializeFMUstate"):
            script.call("serialize_fmu_state", 0)
            script.call("copy_fmu_state", 0, 1)
            script.call("free_fmu_state", 1)
        script.call("set_fmu_state", 0)
        script.call("free_fmu_state", 0)
    script.terminate()
    script.reset()
    script.begin().step(2).play(keep_going=True)


@behaviour_rule(_CREATION, needs=_USED)
def resources_are_freed(probe: Probe) -> Iterator[str]:
    """fmi2FreeInstance closes the files and ends the threads of an instance."""
    counts = _resources_in_use(probe)
    for name in ("open files", "threads"):
        numbers = [count.get(name, 0) for count in counts]
        if all(b > a for a, b in itertools.pairwise(numbers)):
            more = numbers[-1] - numbers[0]
            yield f"{more} more {name} after {_CYCLES - 1} instances were created and freed: expected none"


@behaviour_rule(_CREATION, needs=f"resources-are-freed {_USED}")
def memory_does_not_grow(probe: Probe) -> Iterator[str]:
    """fmi2FreeInstance frees all memory: the heap does not grow with each instance that is created and
    freed.
    """
    growth = _growth_of_the_heap(_resources_in_use(probe))
    if growth >= _LEAST_LEAK:  # a leak goes on; what this process itself comes to hold does not
        growth = min(growth, _growth_of_the_heap(_used_instances(probe)))
    if growth >= _LEAST_LEAK:
        yield f"an instance that is created and freed leaves {growth:g} bytes in the heap: expected none"


def _growth_of_the_heap(counts: list[dict[str, int]]) -> float:
    """Bytes from one count to the next: the median, as this process frees memory at times."""
    return median(b["heap"] - a["heap"] for a, b in itertools.pairwise(counts))

"""Behaviour that every FMU for co-simulation owes: it lives, steps, is reset and dies as FMI says."""

import math
from collections.abc import Iterator
from typing import Any

from fmus.compliance.probe import Instance, Probe
from fmus.compliance.rule import Condition, Stage, rule

_CREATION = "2.1.5 Creation, Destruction and Logging of FMU Instances"
_INITIALIZATION = "2.1.6 Initialization, Termination, and Resetting an FMU"
_FLAGS = "4.3.1 Co-Simulation FMU (CoSimulation)"
_ONLY_ONCE = "canBeInstantiatedOnlyOncePerProcess"
_OWN_MEMORY = "canNotUseMemoryManagementFunctions"
_ANY_STEP = "canHandleVariableCommunicationStepSize"
_ROUNDED = 1e-6  # relative: tools write start values with as few as seven digits
_STEPS = 5


def unless_claimed(capability: str) -> Condition:
    """The condition of rules about a capability."""
    return lambda fmu: "" if fmu.claims(capability) else f"{capability} is not claimed"


def _if_claimed(flag: str) -> Condition:
    """The condition of rules that a flag takes back."""
    return lambda fmu: f"{flag} is claimed" if fmu.claims(flag) else ""


@rule("2.1.4 Inquire Platform and Version Number of Header Files", Stage.BEHAVIOUR)
def library_says_version(probe: Probe) -> Iterator[str]:
    """The library loads; fmi2GetVersion is 2.0 and fmi2GetTypesPlatform default."""
    for function, expected in (("GetVersion", "2.0"), ("GetTypesPlatform", "default")):
        got = probe.ask("text", f"fmi2{function}")
        if got != expected:
            yield f"fmi2{function} is {got!r}: expected {expected!r}"


@rule(_CREATION, Stage.BEHAVIOUR)
def instantiates_and_frees(probe: Probe) -> Iterator[str]:
    """An instance is created, freed, and created and freed again."""
    for _ in range(2):
        with probe.instance():
            pass
    yield from ()


@rule(_CREATION, Stage.BEHAVIOUR)
def refuses_a_wrong_guid(probe: Probe) -> Iterator[str]:
    """fmi2Instantiate returns NULL for a GUID that is not the description's."""
    if probe.accepts("{00000000-0000-0000-0000-000000000000}"):
        yield "fmi2Instantiate gave an instance for a wrong GUID: expected NULL"


@rule("2.1.7 Getting and Setting Variable Values", Stage.BEHAVIOUR)
def start_values_are_as_declared(probe: Probe) -> Iterator[str]:
    """In initialization mode, variables with initial exact and inputs have their start values."""
    with probe.instance() as instance:
        instance.initialise(probe.start_time)
        yield from _differences(probe, instance)


def _differences(probe: Probe, instance: Instance) -> Iterator[str]:
    chosen = [v for v in probe.fmu.variables if v.initial == "exact" or v.causality == "input"]
    starts: dict[str, str] = {v.name: v.start for v in chosen if v.start is not None}
    for name, got in instance.get(v for v in chosen if v.name in starts).items():
        start = starts[name]
        expected = float({"true": "1", "false": "0"}.get(start, start))
        if not math.isclose(got, expected, rel_tol=_ROUNDED, abs_tol=1e-300):
            yield f"{name} is {got:.12g} at first: expected its start value {expected:.12g}"


@rule("2.1.7 Getting and Setting Variable Values", Stage.BEHAVIOUR)
def variables_can_be_read(probe: Probe) -> Iterator[str]:
    """After a step every number can be read by its value reference and type; outputs are finite."""
    with probe.instance() as instance:
        instance.enter_step_mode(probe.start_time)
        probe.run(instance, 1)
        instance.get(probe.fmu.variables)
        for name, value in instance.get(probe.outputs).items():
            if not math.isfinite(value):
                yield f"{name} is {value} after the first step: expected a finite number"


@rule("4.2.2 Computation (fmi2DoStep)", Stage.BEHAVIOUR)
def steps_and_terminates(probe: Probe) -> Iterator[str]:
    """Equal steps of the default experiment's size succeed, then fmi2Terminate."""
    with probe.instance() as instance:
        instance.enter_step_mode(probe.start_time)
        probe.run(instance, _STEPS)
        instance.call("fmi2Terminate")
    yield from ()


@rule(_FLAGS + ": needsExecutionTool", Stage.BEHAVIOUR, condition=_if_claimed("needsExecutionTool"))
def needs_no_tool(probe: Probe) -> Iterator[str]:
    """Without needsExecutionTool, the FMU runs here although no program can be found by the search path."""
    before = probe.ask("set_search_path", "")
    try:
        with probe.instance() as instance:
            instance.enter_step_mode(probe.start_time)
            probe.run(instance, 1)
    finally:
        probe.ask("set_search_path", before)
    yield from ()


@rule(_INITIALIZATION, Stage.BEHAVIOUR)
def reset_gives_the_start_values(probe: Probe) -> Iterator[str]:
    """After steps and fmi2Reset, start values are back and the same steps give the same outputs."""
    with probe.instance() as instance:
        instance.enter_step_mode(probe.start_time)
        first = probe.run(instance, _STEPS)
        instance.call("fmi2Reset")
        instance.initialise(probe.start_time)
        yield from _differences(probe, instance)
        instance.exit_initialization_mode()
        yield from differing(first, probe.run(instance, _STEPS), "after fmi2Reset")


def differing(expected: list[dict[str, Any]], got: list[dict[str, Any]], when: str) -> Iterator[str]:
    """The first value of each output that is not exactly the same."""
    named = set()
    for i, (row, other) in enumerate(zip(expected, got, strict=True), 1):
        for name, value in row.items():
            same = other[name] == value or (math.isnan(value) and math.isnan(other[name]))
            if not same and name not in named:
                named.add(name)
                yield f"{name} is {other[name]!r} {when}, step {i}: expected {value!r} again"


@rule(f"{_FLAGS}: {_ONLY_ONCE}", Stage.BEHAVIOUR, condition=_if_claimed(_ONLY_ONCE))
def several_instances(probe: Probe) -> Iterator[str]:
    """Instances live side by side: steps of one change nothing in another."""
    with probe.instance() as alone:
        alone.enter_step_mode(probe.start_time)
        expected = probe.run(alone, _STEPS)
    with probe.instance() as one, probe.instance() as other:
        one.enter_step_mode(probe.start_time)
        other.enter_step_mode(probe.start_time)
        first = probe.run(one, 2)
        yield from differing(expected, probe.run(other, _STEPS), "beside another instance")
        yield from differing(expected, first + probe.run(one, _STEPS - 2, 2), "beside another instance")


@rule(f"{_FLAGS}: {_ANY_STEP}", Stage.BEHAVIOUR, condition=unless_claimed(_ANY_STEP))
def variable_step_size(probe: Probe) -> Iterator[str]:
    """Steps of different sizes succeed one after the other."""
    with probe.instance() as instance:
        instance.enter_step_mode(probe.start_time)
        t = probe.start_time
        for factor in (1.0, 0.5, 2.0, 0.25, 1.5):
            instance.do_step(t, factor * probe.step_size)
            t += factor * probe.step_size
    yield from ()


@rule(f"{_FLAGS}: {_OWN_MEMORY}", Stage.BEHAVIOUR, condition=_if_claimed(_OWN_MEMORY))
def memory_is_given_back(probe: Probe) -> Iterator[str]:
    """What an instance takes by allocateMemory it gives back by freeMemory, and nothing else."""
    held_before, frees_before = probe.ask("memory")
    with probe.instance() as instance:
        instance.enter_step_mode(probe.start_time)
        probe.run(instance, 1)
        instance.call("fmi2Terminate")
    held, foreign_frees = probe.ask("memory")
    if held > held_before:
        yield f"{held - held_before} blocks are still held after fmi2FreeInstance: expected none"
    if foreign_frees > frees_before:
        yield f"{foreign_frees - frees_before} addresses were freed that were never given: expected none"

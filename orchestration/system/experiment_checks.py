"""Checks that an experiment fits a system: signals, events and faults, and what FMUs and machine can do."""

import math
from collections import Counter
from collections.abc import Collection
from typing import Any

import numpy as np

from fmus.errors import nearest
from fmus.fmi.variable_types import FmiValue
from fmus.operating_system import memory_size
from orchestration.errors import SystemDefinitionError
from orchestration.system.experiment import Experiment
from orchestration.system.faults import Stuck
from orchestration.system.system import CheckedSystem, Port
from orchestration.system.time_grid import within
from orchestration.system.values import fmi_value

Setting = tuple[Port, FmiValue]


def check_signals(system: CheckedSystem, experiment: Experiment) -> None:
    """Raises SystemDefinitionError for a signal that is no function, or whose input is a String."""
    for name, signal in experiment.signals.items():
        if not callable(signal):
            raise SystemDefinitionError(
                f"signal {name} = {signal!r}: expected a function of time; a constant is given as an input",
                ("signals", name),
            )
        if system.ports[name].variable.type == "String":
            raise SystemDefinitionError(
                f"signal {name}: expected an input that is a number, got a String; give it a constant value",
                ("signals", name),
            )


def check_faults(system: CheckedSystem, experiment: Experiment, driven: set[str]) -> None:
    """Raises SystemDefinitionError for a fault on an input that it cannot act on, or at no time of the run.

    driven: inputs that a connection or a signal drives
    """
    step_starts = experiment.time_grid()[:-1] if experiment.faults else np.empty(0)
    for fault in experiment.faults:
        steps = within(step_starts, fault.start, fault.end)
        port, effect = system.port(fault.input, f"fault on {fault.input}"), fault.effect
        if fault.input not in driven:
            problem = (
                "expected an input that a connection or a signal drives; "
                f"{nearest(fault.input, sorted(driven))}"
            )
        elif port.variable.type != "Real" and not effect.for_every_type:
            problem = f"{type(effect).__name__}: expected an input of type Real, got {port.variable.type}"
        elif port.variable.type == "String" and isinstance(effect, Stuck):
            problem = "Stuck: expected an input that is a number, got a String"
        elif not len(steps):
            problem = (
                f"no communication step begins at {fault.start:g}..{fault.end:g} s: "
                f"expected a part of the run, {experiment.start_time:g}..{experiment.stop_time:g} s"
            )
        else:
            if isinstance(effect, Stuck):
                fmi_value(port, effect.value)
            continue
        raise SystemDefinitionError(f"fault on {fault.input}: {problem}", fault.input)


def check_capabilities(system: CheckedSystem, experiment: Experiment) -> None:
    """Raises SystemDefinitionError for an experiment that needs a capability that an FMU does not declare."""
    for name in experiment.step_sizes:
        if name not in system.components:
            raise SystemDefinitionError(
                f"step size of {name!r}: no such component; {nearest(name, system.components)}",
                ("step_sizes", name),
            )
    missing = experiment.step_count * experiment.step_size - (experiment.stop_time - experiment.start_time)
    last_is_shorter = missing > experiment.time_resolution()
    instances = Counter(system.components.values())
    for name, description in system.descriptions.items():
        interface: Any = description.coSimulation
        can_vary_step = interface.canHandleVariableCommunicationStepSize
        if experiment.tolerance and not (interface.canGetAndSetFMUstate and can_vary_step):
            raise SystemDefinitionError(
                f"tolerance: {name} cannot repeat a step in two halves: expected an FMU with "
                "canGetAndSetFMUstate and canHandleVariableCommunicationStepSize",
                ("experiment", "tolerance"),
            )
        if (last_is_shorter or experiment.step_count % experiment.period(name)) and not can_vary_step:
            raise SystemDefinitionError(
                f"{name} cannot vary its step size: expected a stop time that is a multiple of the step size",
                ("experiment", "stop_time"),
            )
        path = system.components[name]
        if instances[path] > 1 and interface.canBeInstantiatedOnlyOncePerProcess:
            copies = [other for other in system.components if system.components[other] == path]
            raise SystemDefinitionError(
                f"{', '.join(copies)}: expected one instance, the FMU can be instantiated only once",
                ("components", name),
            )


def checked_events(
    system: CheckedSystem, experiment: Experiment, driven: Collection[str]
) -> list[tuple[float, list[Setting]]]:
    """Returns the time [s] and the settings of each event, in the order of time.

    driven: inputs that a connection or a signal drives
    Raises SystemDefinitionError for an event that sets what cannot be set during a run.
    """
    events = []
    for event in experiment.events:
        settings = []
        for name, value in event.values.items():
            port = system.port(name, f"event at {event.time} s")
            settings.append((port, fmi_value(port, value)))
            check_changeable(port, f"event at {event.time} s", driven)
        events.append((event.time, settings))
    return sorted(events, key=lambda event: event[0])


def check_changeable(port: Port, purpose: str, driven: Collection[str]) -> None:
    """Raises SystemDefinitionError for a variable that cannot be set during a run.

    driven: inputs that a connection or a signal drives
    """
    variable = port.variable
    if variable.causality not in ("parameter", "input"):
        problem = f"does not fit: expected a parameter or an input, got {variable.causality}"
    elif variable.variability == "fixed":
        problem = "is fixed: only tunable parameters may change"
    elif port.name in driven:
        problem = "is driven already, by a connection or signal"
    else:
        return
    raise SystemDefinitionError(f"{purpose}: {port.name} {problem}", port.name)


def check_memory(system: CheckedSystem, experiment: Experiment) -> None:
    """Raises SystemDefinitionError for a recording that does not fit into the memory of this machine."""
    points = math.ceil((experiment.stop_time - experiment.start_time) / experiment.step_size) + 1
    outputs = (port for port in system.ports.values() if port.variable.causality == "output")
    columns = len(experiment.record) or sum(1 for _ in outputs)
    check_fits(
        8 * points * (1 + columns),
        f"{points:.3g} communication points of {columns} variables",
        "record fewer variables, or take longer steps",
    )


def check_fits(size: int, what: str, advice: str, of_device: int | None = None) -> None:
    """Raises SystemDefinitionError for more bytes than the memory of this machine has, or of a device."""
    memory, owner = (memory_size(), "this machine") if of_device is None else (of_device, "the device")
    if memory and size > memory:
        raise SystemDefinitionError(
            f"{what} take {size / 1e9:.3g} GB: expected at most the {memory / 1e9:.3g} GB of {owner}; "
            f"{advice}"
        )

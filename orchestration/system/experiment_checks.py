"""Whether an experiment fits a system: its signals, its faults, and what the FMUs are able to do."""

from typing import Any

from fmus.errors import nearest
from orchestration.errors import SystemDefinitionError
from orchestration.system.experiment import Experiment
from orchestration.system.faults import Fault, Stuck
from orchestration.system.system import CheckedSystem
from orchestration.system.time_grid import GRID_TOLERANCE, within
from orchestration.system.values import fmi_value


def check_signals(system: CheckedSystem, experiment: Experiment) -> None:
    """SystemDefinitionError for a signal that is no function, or whose input is not Real."""
    for name, signal in experiment.signals.items():
        if not callable(signal):
            raise SystemDefinitionError(
                f"signal {name} = {signal!r}: expected a function of time; a constant is given as an input"
            )
        input_type = system.ports[name].variable.type
        if input_type != "Real":
            raise SystemDefinitionError(f"signal {name}: expected an input of type Real, got {input_type}")


def check_faults(system: CheckedSystem, experiment: Experiment) -> None:
    """SystemDefinitionError for a fault on an input that it cannot act on, or at no time of the run."""
    driven = {target.name for _, target in system.connections} | set(experiment.signals)
    step_starts = experiment.time_grid()[:-1]
    for fault in experiment.faults:
        _check_faulted_input(system, fault, driven)
        if not len(within(step_starts, fault.start, fault.end)):
            raise SystemDefinitionError(
                f"fault on {fault.input}: no communication step begins at {fault.start:g}..{fault.end:g} s: "
                f"expected a part of the run, {experiment.start_time:g}..{experiment.stop_time:g} s"
            )


def _check_faulted_input(system: CheckedSystem, fault: Fault, driven: set[str]) -> None:
    purpose, kind = f"fault on {fault.input}", type(fault.effect).__name__
    port = system.port(fault.input, purpose)
    if fault.input not in driven:
        raise SystemDefinitionError(
            f"{purpose}: expected an input that a connection or a signal drives; "
            f"{nearest(fault.input, driven)}"
        )
    if port.variable.type != "Real" and not fault.effect.for_every_type:
        raise SystemDefinitionError(
            f"{purpose}: {kind}: expected an input of type Real, got {port.variable.type}"
        )
    if isinstance(fault.effect, Stuck):
        fmi_value(port, fault.effect.value)


def check_capabilities(system: CheckedSystem, experiment: Experiment) -> None:
    """SystemDefinitionError for an experiment that needs a capability that an FMU does not declare."""
    for name in experiment.step_sizes:
        if name not in system.components:
            raise SystemDefinitionError(
                f"step size of {name!r}: no such component; {nearest(name, system.components)}"
            )
    step_count = len(experiment.time_grid()) - 1
    ratio = (experiment.stop_time - experiment.start_time) / experiment.step_size
    last_is_shorter = abs(ratio - round(ratio)) > GRID_TOLERANCE * ratio
    for name, description in system.descriptions.items():
        interface: Any = description.coSimulation
        can_vary_step = interface.canHandleVariableCommunicationStepSize
        if experiment.tolerance and not (interface.canGetAndSetFMUstate and can_vary_step):
            raise SystemDefinitionError(
                f"tolerance: {name} cannot repeat a step in two halves: expected an FMU with "
                "canGetAndSetFMUstate and canHandleVariableCommunicationStepSize"
            )
        if (last_is_shorter or step_count % experiment.period(name)) and not can_vary_step:
            raise SystemDefinitionError(
                f"{name} cannot vary its step size: expected a stop time that is a multiple of the step size"
            )
        copies = [other for other, path in system.components.items() if path == system.components[name]]
        if len(copies) > 1 and interface.canBeInstantiatedOnlyOncePerProcess:
            raise SystemDefinitionError(
                f"{', '.join(copies)}: expected one instance, the FMU can be instantiated only once"
            )

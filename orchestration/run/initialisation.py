"""Initial values: parameters and inputs are set, and outputs exchanged until every connection is consistent.

The groups of connections (`CheckedSystem.connection_groups`) follow each other: a connection outside of any
loop is exchanged once, a loop is solved by `algebraic_loop.py`.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence

from fmus.fmi.instance import FmuInstance
from fmus.fmi.model_description import ScalarVariable
from fmus.fmi.variable_types import FmiValue
from orchestration.errors import OrchestrationError
from orchestration.run.algebraic_loop import Loop, NoSolutionError
from orchestration.system.experiment import Initialisation
from orchestration.system.prepared_run import PreparedRun, Setting
from orchestration.system.system import CheckedSystem


def initialise(
    prepared: PreparedRun, instances: Mapping[str, FmuInstance], settings: Sequence[Setting] | None = None
) -> None:
    """Brings new instances to step mode with consistent initial values.

    settings: in place of `prepared.initial_settings`
    """
    experiment = prepared.experiment
    sorted_settings: dict[tuple[str, bool], list[tuple[ScalarVariable, FmiValue]]] = defaultdict(list)
    for port, value in prepared.initial_settings if settings is None else settings:
        is_input = port.variable.causality == "input"
        sorted_settings[port.component, is_input].append((port.variable, value))
    for name, instance in instances.items():
        instance.set_all(sorted_settings[name, False])
    for instance in instances.values():
        instance.initialise(experiment.start_time, experiment.stop_time, experiment.fmu_tolerance)
    for name, instance in instances.items():
        instance.set_all(sorted_settings[name, True])
    solve_initial_values(prepared.system, instances, Initialisation(experiment.initialisation))
    for instance in instances.values():
        instance.exit_initialization_mode()


def solve_initial_values(
    system: CheckedSystem, instances: Mapping[str, FmuInstance], method: Initialisation
) -> None:
    """Exchanges values, in initialization mode, until every connected input equals its output.

    Raises OrchestrationError for a loop without a solution, FmuError for a call that an FMU refuses.
    """
    for group in system.connection_groups:
        loop = Loop(group.connections, system.transformations, instances)
        if group.is_loop:
            loop.solve(method)
            continue
        try:
            loop.exchange()
        except NoSolutionError as reason:
            raise OrchestrationError(f"initial values: {reason}") from reason

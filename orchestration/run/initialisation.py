"""Initial values: parameters and inputs are set, and outputs exchanged until every connection is consistent.

Each connected input follows an output, which depends on inputs of its component as the model description
declares (`InitialUnknowns`; an output without declaration depends on every input). The strongly connected
components of this graph are solved one after another in topological order: a connection outside of any loop
is exchanged once, a loop is solved by `algebraic_loop.py`.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter

import numpy as np

from fmus.fmi.instance import FmuInstance
from fmus.fmi.model_description import ScalarVariable
from fmus.fmi.variable_types import FmiValue
from orchestration.errors import OrchestrationError
from orchestration.run.algebraic_loop import (
    Connection,
    NoSolutionError,
    Transformations,
    exchange_once,
    solve_loop,
)
from orchestration.system.experiment import Initialisation
from orchestration.system.prepared_run import PreparedRun, Setting
from orchestration.system.system import CheckedSystem


@dataclass(frozen=True)
class ConnectionGroup:
    """The connections of an algebraic loop, or one connection that is in no loop.

    transformations: of the system's connections, by their input
    """

    connections: tuple[Connection, ...]
    is_loop: bool
    transformations: Transformations = field(default_factory=dict)


def initialise(
    prepared: PreparedRun,
    groups: Sequence[ConnectionGroup],
    instances: Mapping[str, FmuInstance],
    settings: Sequence[Setting] | None = None,
) -> None:
    """Brings new instances to step mode with consistent initial values; groups: of `connection_groups`.

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
    solve_initial_values(groups, instances, Initialisation(experiment.initialisation))
    for instance in instances.values():
        instance.exit_initialization_mode()


def solve_initial_values(
    groups: Sequence[ConnectionGroup], instances: Mapping[str, FmuInstance], method: Initialisation
) -> None:
    """Exchanges values, in initialization mode, until every connected input equals its output.

    Raises OrchestrationError for a loop without a solution, FmuError for a call that an FMU refuses.
    """
    for group in groups:
        if group.is_loop:
            solve_loop(group.connections, instances, group.transformations, method)
            continue
        try:
            exchange_once(group.connections, instances, group.transformations)
        except NoSolutionError as reason:
            raise OrchestrationError(f"initial values: {reason}") from reason


def connection_groups(system: CheckedSystem) -> tuple[ConnectionGroup, ...]:
    """Returns the strongly connected components of the connected inputs, in the order of the flow."""
    connections, declared = system.connections, system.declared_dependencies
    index = {target.name: i for i, (_, target) in enumerate(connections)}
    # One more node for each component: all its connected inputs, for the outputs that declare nothing.
    nodes = {name: len(connections) + c for c, name in enumerate(system.components)}
    dependencies: dict[int, set[int]] = {}
    for i, (source, _) in enumerate(connections):
        names = declared.get(source.name)
        inputs = {nodes[source.component]} if names is None else {index[n] for n in names if n in index}
        dependencies[i] = inputs
    for name, node in nodes.items():
        dependencies[node] = {index[n] for n in system.inputs[name] if n in index}
    try:
        TopologicalSorter(dependencies).prepare()
        labels = list(dependencies)
    except CycleError:
        labels = _component_labels(dependencies)
    members: dict[int, list[int]] = {}
    for i, label in enumerate(labels):
        members.setdefault(label, []).append(i)
    graph = {
        label: {labels[earlier] for i in inside for earlier in dependencies[i]} - {label}
        for label, inside in members.items()
    }
    groups = (members[label] for label in TopologicalSorter(graph).static_order())
    return tuple(
        ConnectionGroup(
            connections=tuple(connections[i] for i in group if i < len(connections)),
            is_loop=len(group) > 1 or group[0] in dependencies[group[0]],
            transformations=system.transformations,
        )
        for group in groups
        if group[0] < len(connections)
    )


def _component_labels(dependencies: Mapping[int, set[int]]) -> list[int]:
    """Returns the strongly connected component of each node."""
    from scipy.sparse import coo_array  # only for loops: it takes as long to import as all the rest
    from scipy.sparse.csgraph import connected_components

    edges = [(earlier, i) for i, all_earlier in dependencies.items() for earlier in all_earlier]
    rows, columns = np.array(edges, dtype=int).reshape(-1, 2).T
    matrix = coo_array((np.ones(len(edges)), (rows, columns)), shape=(len(dependencies),) * 2)
    return connected_components(matrix.tocsr(), connection="strong")[1].tolist()

"""The layout of the bus: an index for every value that components exchange or that is recorded."""

from collections.abc import Mapping
from dataclasses import dataclass

from fmpy.model_description import ScalarVariable

from fmus.fmi_types import TRANSFER_TYPE
from orchestration.system.prepared_run import PreparedRun

SIGNAL = "signal "  # prefix of the name of a signal on the bus


@dataclass(frozen=True)
class VariableGroup:
    """Variables of one component and one type, read or set in one call.

    bus_index: of the first variable; integer_index: of the first in `Wiring.integers`, -1 for Real
    """

    component: str
    type: str
    variables: tuple[ScalarVariable, ...]
    bus_index: int
    integer_index: int

    @property
    def names(self) -> list[str]:
        return [f"{self.component}.{variable.name}" for variable in self.variables]


@dataclass(frozen=True)
class BusLayout:
    """connections: (source, target) of connections and signals, in the order of the target's component

    outputs, inputs: the variables that are read and set; integer_count: how many of them are not Real
    index: name -> index on the bus
    """

    connections: tuple[tuple[str, str], ...]
    outputs: tuple[VariableGroup, ...]
    inputs: tuple[VariableGroup, ...]
    integer_count: int
    index: Mapping[str, int]


def lay_out_bus(prepared: PreparedRun) -> BusLayout:
    """Outputs come first, then inputs, then signals."""
    connections = _sorted_connections(prepared)
    sources, targets = {source for source, _ in connections}, {target for _, target in connections}
    outputs = _variables_by_type(prepared, "output", {*prepared.recorded, *sources})
    inputs = _variables_by_type(prepared, "input", targets)
    groups: list[VariableGroup] = []
    size = integer_count = 0
    for component, fmi_type, variables in (*outputs, *inputs):
        is_real = fmi_type == "Real"
        groups.append(VariableGroup(component, fmi_type, variables, size, -1 if is_real else integer_count))
        size += len(variables)
        integer_count += 0 if is_real else len(variables)
    names = [name for group in groups for name in group.names]
    names += [f"{SIGNAL}{name}" for name in prepared.experiment.signals]
    return BusLayout(
        connections=connections,
        outputs=tuple(groups[: len(outputs)]),
        inputs=tuple(groups[len(outputs) :]),
        integer_count=integer_count,
        index={name: i for i, name in enumerate(names)},
    )


def component_of(name: str) -> str:
    """The component of "component.variable"."""
    return name.partition(".")[0]


def _sorted_connections(prepared: PreparedRun) -> tuple[tuple[str, str], ...]:
    pairs = [(source.name, target.name) for source, target in prepared.system.connections]
    pairs += [(f"{SIGNAL}{name}", name) for name in prepared.experiment.signals]
    order = list(prepared.system.components)
    return tuple(sorted(pairs, key=lambda pair: order.index(component_of(pair[1]))))


def _variables_by_type(
    prepared: PreparedRun, causality: str, names: set[str]
) -> list[tuple[str, str, tuple[ScalarVariable, ...]]]:
    """(component, type of getter and setter, variables) of the variables of these names."""
    groups: dict[tuple[str, str], list[ScalarVariable]] = {}
    for component, description in prepared.system.descriptions.items():
        for variable in description.modelVariables:
            if variable.causality == causality and f"{component}.{variable.name}" in names:
                groups.setdefault((component, TRANSFER_TYPE[variable.type]), []).append(variable)
    return [(component, fmi_type, tuple(members)) for (component, fmi_type), members in groups.items()]

"""The communication loop of an ensemble: its arrays, and the compiled loop over them."""

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from orchestration.master.bus import component_of
from orchestration.master.lane_library import LaneLibrary, load_compiled
from orchestration.system.experiment import Algorithm
from orchestration.system.prepared_run import PreparedRun
from orchestration.system.transformation import LinearTransformation

Array = np.ndarray
_UNCHANGED = LinearTransformation()


class EnsembleData(NamedTuple):
    """All data of the loop of an ensemble, which `ensemble.c` declares member by member.

    n_points .. n_groups: of communication points, components, signals, recorded variables, groups
    lanes: instances of a group; gauss_seidel: 1 for Gauss-Seidel, 0 for Jacobi; points: [s]
    step, memory: of each component the address of its function and of its groups; size: of a group, in words

    A variable is a component and a value reference. Connections into component c are first[c]..first[c+1]-1:
    source_component, source, target; factor, offset: as in `Connections`; minimum, maximum: of the target
    signal_values: one row for each signal, one column for each point; signal_component, signal: its input
    column_component, column: the recorded variables
    rows: their values, shape (groups, columns, points, lanes)
    recorded: points that are recorded of each instance; failure: 0, or 1 + the component whose step it
    refused, or -1 - the connection whose value its target cannot have
    """

    n_points: int
    n_components: int
    n_signals: int
    n_columns: int
    n_groups: int
    lanes: int
    gauss_seidel: int
    points: Array
    step: Array
    memory: Array
    size: Array
    first: Array
    source_component: Array
    source: Array
    target: Array
    minimum: Array
    maximum: Array
    factor: Array
    offset: Array
    signal_values: Array
    signal_component: Array
    signal: Array
    column_component: Array
    column: Array
    rows: Array
    recorded: Array
    failure: Array


@dataclass(frozen=True)
class EnsembleLoop:
    """The groups of an ensemble, ready to run.

    connections: names of their targets, in the order of the data
    """

    prepared: PreparedRun
    libraries: Mapping[str, LaneLibrary]
    memory: Mapping[str, Array]
    data: EnsembleData
    connections: Sequence[str]

    def run_group(self, group: int) -> None:
        """Run a group from the first communication point to the last, with the changes of events."""
        members = [
            member.ctypes.data if isinstance(member, np.ndarray) else member for member in self.data
        ]
        data = np.array(members, np.int64)
        last = len(self.data.points) - 1
        starts = sorted({0, *(point for point in self.prepared.changes if point <= last)})
        for start, end in zip(starts, [*starts[1:], last], strict=True):
            self._change(group, start)
            _library().ensemble_run(data.ctypes.data, group, start, end)

    def _change(self, group: int, point: int) -> None:
        """Set what events change at a communication point."""
        for port, value in self.prepared.changes.get(point, ()):
            library, memory = self.libraries[port.component], self.memory[port.component]
            broken = library.set(memory[group], port.variable.valueReference, float(value))
            number = 1 + list(self.libraries).index(port.component)
            for lane in range(library.lanes):
                instance = group * library.lanes + lane
                if broken >> lane & 1 and not self.data.failure[instance]:
                    self.data.failure[instance], self.data.recorded[instance] = number, point


def build_loop(prepared: PreparedRun, libraries: Mapping[str, LaneLibrary], initial: Mapping[str, Array]) -> EnsembleLoop:
    """The arrays of an ensemble at its start time.

    initial: component -> what its instances begin with, shape (groups * lanes, words); see `LaneLibrary.begin`
    """
    numbers = {name: c for c, name in enumerate(libraries)}
    lanes = next(iter(libraries.values())).lanes
    n_instances = len(next(iter(initial.values())))
    groups = n_instances // lanes
    memory = {name: library.memory(groups) for name, library in libraries.items()}
    for name, library in libraries.items():
        library.begin(memory[name], initial[name])
    ports, system = prepared.system.ports, prepared.system
    connections = sorted(system.connections, key=lambda ends: numbers[ends[1].component])
    targets = [target.name for _, target in connections]
    per_component = [sum(component_of(name) == component for name in targets) for component in libraries]
    changes = [system.transformations.get(name, _UNCHANGED) for name in targets]

    def variables(names: Sequence[str]) -> tuple[Array, Array]:
        """Component and value reference of each."""
        components = [numbers[ports[name].component] for name in names]
        return _integers(components), _integers([ports[name].variable.valueReference for name in names])

    source_component, source = variables([source.name for source, _ in connections])
    ranges = [prepared.input_ranges[name] for name in targets]
    largest = np.finfo(float).max
    signals = list(prepared.experiment.signals)
    shape = groups, len(prepared.recorded), len(prepared.points), lanes
    data = EnsembleData(
        len(prepared.points),
        len(libraries),
        len(signals),
        len(prepared.recorded),
        groups,
        lanes,
        int(prepared.experiment.algorithm is Algorithm.GAUSS_SEIDEL),
        prepared.points,
        _integers([library.step for library in libraries.values()]),
        _integers([memory[name].ctypes.data for name in libraries]),
        _integers([library.words for library in libraries.values()]),
        _integers(np.cumsum([0, *per_component])),
        source_component,
        source,
        variables(targets)[1],
        np.array([max(low, -largest) for low, _ in ranges], float),
        np.array([min(high, largest) for _, high in ranges], float),
        np.array([change.factor for change in changes], float),
        np.array([change.offset or -0.0 for change in changes], float),
        np.ascontiguousarray(prepared.signal_values),
        *variables(signals),
        *variables(prepared.recorded),
        np.empty(shape),
        np.full(n_instances, len(prepared.points), np.int64),
        np.zeros(n_instances, np.int64),
    )
    return EnsembleLoop(prepared, libraries, memory, data, targets)


def _integers(values: Sequence[int] | Array) -> Array:
    return np.array(values, np.int64)


@cache
def _library() -> ctypes.CDLL:
    library = load_compiled(Path(__file__).with_name("ensemble.c"), [])
    library.ensemble_run.argtypes = [ctypes.c_void_p, *[ctypes.c_int64] * 3]
    library.ensemble_run.restype = None
    return library

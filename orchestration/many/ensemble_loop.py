"""The communication loop of an ensemble: its arrays, and the compiled loop over them."""

import ctypes
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from fmus.errors import ExportError
from orchestration.errors import EnsembleError
from orchestration.many.lane_library import LANES, aligned, load_compiled
from orchestration.system.experiment import Algorithm
from orchestration.system.prepared_run import PreparedRun
from orchestration.system.system import ConnectionGroup, LinearTransformation, Port

Array = np.ndarray
_UNCHANGED = LinearTransformation()
_LARGEST = np.finfo(float).max


class EnsembleLoop:
    """The groups of `count` instances, ready to run.

    functions: of `loop_library`
    values: component -> its variables by value reference, which all instances have in common
    varied: driven input -> the signal of each instance at each point, shape (groups, points, lanes)

    memory: component -> its groups; see `LaneLibrary.memory`
    connections: source and target, those into the first component first
    rows: recorded values, shape (groups, columns, points, lanes)
    recorded: points that are recorded of each instance; failure: 0, or 1 + the component whose step it
    refused, or -1 - the connection whose value its target cannot have; both of shape (groups, lanes)
    """

    def __init__(
        self,
        functions: Any,
        prepared: PreparedRun,
        libraries: Mapping[str, Any],
        values: Mapping[str, Array],
        varied: Mapping[str, Array],
        count: int,
    ) -> None:
        self._functions, self.prepared, self.libraries = functions, prepared, libraries
        self._varied, self._count = varied, count
        order = list(libraries)
        ends = sorted(prepared.system.connections, key=lambda ends: order.index(ends[1].component))
        self.connections = [(source.name, target.name) for source, target in ends]
        self._allocate(values)

    def _allocate(self, values: Mapping[str, Array]) -> None:
        groups, (points, columns) = -(-self._count // LANES), self.prepared.shape
        self.memory = {name: library.memory(groups, values[name]) for name, library in self.libraries.items()}
        self.rows = aligned(groups, columns, points, LANES)
        self.recorded, self.failure = np.full((groups, LANES), points), np.zeros((groups, LANES), np.int64)
        self._groups = [self._group(group) for group in range(groups)]

    @staticmethod
    def words(prepared: PreparedRun, libraries: Mapping[str, Any], count: int, varied: int) -> int:
        """Returns how many words of eight bytes so many instances take, with the recording made of them.

        varied: signals that differ between the instances
        """
        groups, (points, columns) = -(-count // LANES), prepared.shape
        memory = sum(library.words for library in libraries.values())
        return groups * (LANES * points * (2 * columns + varied) + memory)

    def exchange(self, point: int) -> None:
        """Sets what signals and connections drive at a communication point, and records it."""
        for group, _ in self._groups:
            self._functions.ensemble_exchange(group, point)

    def run_points(self, first: int, last: int) -> None:
        """Runs all from one communication point to another, with the changes of events."""
        for group in range(len(self._groups)):
            self._run_group(group, first, last)

    def _run_group(self, group: int, first: int, last: int) -> None:
        is_end = last + 1 == len(self.prepared.points)
        changes = (p for p in self.prepared.changes if first < p and (p < last or (is_end and p == last)))
        starts = sorted({first, *changes})
        for start, end in zip(starts, [*starts[1:], last], strict=True):
            self._change(group, start)
            self._functions.ensemble_run(self._groups[group][0], start, end)

    def _group(self, group: int) -> tuple[ctypes.Array[ctypes.c_int64], list[Any]]:
        """Returns the structure `Group` of ensemble.c, and what its addresses refer to."""
        members = self._members(group)
        values = [m.ctypes.data if isinstance(m, np.ndarray) else m for m in members.values()]
        return (ctypes.c_int64 * len(values))(*values), list(members.values())

    def _members(self, group: int) -> dict[str, Any]:
        """Returns the members of the structure `Group` of ensemble.c by their names, in their order.

        Counts, then arrays. step, memory: of each component the address of its function and of the group.
        Variables are addresses of their lanes. Connections into component c are first[c]..first[c+1]-1, with
        the range of the target, and factor and offset as in `Connections`. signal_values has a row for each
        signal and a column for each point; varied_values, which are set after these, are of shape
        (points, lanes). column: the recorded variables, and rows their values, shape (columns, points, lanes)
        """
        prepared, experiment = self.prepared, self.prepared.experiment
        components, connections = list(self.libraries), self.connections
        owners = [prepared.system.ports[target].component for _, target in connections]
        sources = [components.index(prepared.system.ports[source].component) for source, _ in connections]
        changes = [prepared.system.transformations.get(target, _UNCHANGED) for _, target in connections]
        limits = np.array([prepared.input_ranges[target] for _, target in connections]).reshape(-1, 2)
        minimum, maximum = np.ascontiguousarray(limits.T).clip(-_LARGEST, _LARGEST)
        return {
            "n_points": len(prepared.points),
            "n_components": len(components),
            "n_signals": len(experiment.signals),
            "n_varied": len(self._varied),
            "n_columns": len(prepared.recorded),
            "gauss_seidel": int(experiment.algorithm is Algorithm.GAUSS_SEIDEL),
            "points": prepared.points,
            **self._components(group),
            "first": _integers([0, *np.cumsum([owners.count(name) for name in components])]),
            "source_component": _integers(sources),
            "source": self._addresses(group, [source for source, _ in connections]),
            "target": self._addresses(group, [target for _, target in connections]),
            "minimum": minimum,
            "maximum": maximum,
            "factor": np.array([change.factor for change in changes], float),
            "offset": np.array([change.offset or -0.0 for change in changes], float),
            "signal_values": prepared.signal_values,
            "signal": self._addresses(group, list(experiment.signals)),
            "varied_values": self._addresses_of([values[group] for values in self._varied.values()]),
            "varied": self._addresses(group, list(self._varied)),
            "column": self._addresses(group, prepared.recorded),
            "rows": self.rows[group],
            "recorded": self.recorded[group],
            "failure": self.failure[group],
        }

    def _components(self, group: int) -> dict[str, Array]:
        steps = [library.step for library in self.libraries.values()]
        memory = self._addresses_of([self.memory[name][group] for name in self.libraries])
        return {"step": _integers(steps), "memory": memory}

    def _addresses_of(self, arrays: Sequence[Array]) -> Array:
        return _integers([array.ctypes.data for array in arrays])

    def _addresses(self, group: int, names: Sequence[str]) -> Array:
        """Returns the addresses of the lanes of variables."""
        ports = [self.prepared.system.ports[name] for name in names]
        first = {name: memory[group].ctypes.data for name, memory in self.memory.items()}
        return _integers([first[p.component] + 8 * LANES * int(p.variable.valueReference) for p in ports])

    def reason(self, count: int, failure: int) -> str:
        """Returns why an instance ended early, of its values of `ends`."""
        time = f"t = {self.prepared.points[count - 1]:.9g} s"
        if failure < 0:
            source, target = self.connections[-1 - failure]
            return f"{source} -> {target} at {time}: a value that the input cannot have"
        component = list(self.libraries)[failure - 1]
        return f"{component} at {time}: the step is refused; Simulator.run of this instance says why"

    def values(self, port: Port) -> Array:
        """Returns a variable of all instances, shape (groups, lanes): a view of the memory."""
        return self.of_reference(port.component, int(port.variable.valueReference))

    def of_reference(self, component: str, reference: int) -> Array:
        """Returns the variable of a value reference, as `values`."""
        return self.memory[component][:, LANES * reference : LANES * (reference + 1)]

    def put(self, port: Port, values: Array) -> None:
        """Sets a variable of all instances; values: shape (instances,)."""
        lanes = self.values(port)
        lanes[:] = np.resize(values, lanes.shape)

    def signals(self, count: int) -> Array:
        """Returns the first values that were recorded, shape (columns, instances, count).

        A signal of a run is contiguous, so that a sum along time rounds as in the run alone.
        """
        of_signals = self.rows[:, :, :count].transpose(1, 0, 3, 2).copy()
        return of_signals.reshape(len(of_signals), self.failure.size, count)[:, : self._count]

    def ends(self) -> tuple[Array, Array]:
        """Returns `recorded` and `failure`, shape (instances,)."""
        return self.recorded.ravel()[: self._count], self.failure.ravel()[: self._count]

    def initialise(self, group: ConnectionGroup | None = None) -> None:
        """Computes what follows from parameters and inputs, and exchanges it over connections.

        group: of `connection_groups`, one connection; without one, every component is computed
        """
        connections = group.connections if group else ()
        for component in {source.component for source, _ in connections} or self.libraries:
            self._initialise(component)
        for source, target in connections:
            value = self.values(source)
            transformation = self.prepared.system.transformations.get(target.name)
            with np.errstate(over="ignore", invalid="ignore"):  # such a value is refused below
                arriving = transformation.factor * value + transformation.offset if transformation else value
            low, high = self.prepared.input_ranges[target.name]
            number = 1 + list(self.libraries).index(target.component)
            self.values(target)[:] = arriving
            bad = ~((arriving >= low) & (arriving <= high) & np.isfinite(arriving))
            self.failure[bad], self.recorded[bad] = number, 0

    def _initialise(self, component: str) -> None:
        for index, memory in enumerate(self.memory[component]):
            refused = self.libraries[component].initialise(memory, float(self.prepared.points[0]))
            self._note_refused(index, component, refused)

    def _change(self, group: int, point: int) -> None:
        """Sets what events change at a communication point."""
        changes = self.prepared.changes.get(point, ())
        for port, value in changes:
            self.values(port)[group] = float(value)
        for component in {port.component for port, _ in changes}:
            self._parameters_changed(group, component)

    def _parameters_changed(self, group: int, component: str) -> None:
        self.libraries[component].parameters_changed(self.memory[component][group])

    def _note_refused(self, group: int, component: str, refused: int) -> None:
        """Notes that the instances of the refused lanes do not begin."""
        for lane in range(LANES) if refused else ():
            if refused >> lane & 1 and not self.failure[group, lane]:
                self.failure[group, lane] = 1 + list(self.libraries).index(component)
                self.recorded[group, lane] = 0


def _integers(values: Sequence[int]) -> Array:
    return np.array(values, np.int64)


@lru_cache
def loop_library(instructions: str) -> ctypes.CDLL:
    """Returns the compiled loop for these instructions; EnsembleError if it cannot be compiled."""
    try:
        library = load_compiled(Path(__file__).with_name("ensemble.c"), instructions)
    except (ExportError, OSError) as error:
        raise EnsembleError(f"no ensemble: {error}; a Simulator runs the system") from error
    library.ensemble_run.argtypes = [ctypes.c_void_p, *[ctypes.c_int64] * 2]
    library.ensemble_exchange.argtypes = [ctypes.c_void_p, ctypes.c_int64]
    library.ensemble_run.restype = library.ensemble_exchange.restype = None
    return library


class Device(Protocol):
    """Device on which an ensemble steps in place of this processor, such as a GPU.

    name: in messages; loop: class of the instances there
    arrays: a module of arrays with the interface of NumPy, and `get` for a copy of it as one of NumPy
    """

    name: str
    loop: type[EnsembleLoop]
    arrays: Any

    def program(self, components: Mapping[str, Path]) -> Any:
        """Returns the functions of `loop_library` for a system, with `components`: its libraries by name."""
        ...

    def free_bytes(self) -> int:
        """Returns how many bytes arrays may take."""
        ...

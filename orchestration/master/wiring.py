"""A checked system with live components and an experiment -> the arrays that the loop works on."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from fmpy.model_description import ScalarVariable

from orchestration.fmi.instance import CallInProgress, FmuInstance
from orchestration.master.loop import (
    AT_THE_MIDDLE,
    BUSY,
    BY_THE_FMU,
    CALLS,
    HELD,
    READ,
    REPORT_SIZE,
    SLOPES,
    STEP,
    WRITE,
    Calls,
    Faults,
    Links,
    Storage,
    Wiring,
)
from orchestration.system.experiment import Algorithm
from orchestration.system.prepared_run import PreparedRun
from orchestration.system.values import TRANSFER_TYPE, value_range

# How much longer than usual a step may be than the one that its slope was taken from. Where a tolerance
# judges the outcome, it follows half a step and may be five times as long as the whole.
_REACH, _JUDGED_REACH = 2.0, 10.0


@dataclass
class _Bus:
    """Places for every value that travels, before their number is known."""

    names: list[str] = field(default_factory=list)
    places: dict[str, int] = field(default_factory=dict)
    whole: int = 0

    def add(self, names: Iterable[str]) -> int:
        """Consecutive places; the first of them."""
        first = len(self.names)
        for name in names:
            self.places[name] = len(self.names)
            self.names.append(name)
        return first


@dataclass
class _Group:
    """Variables of one component and type that are read or written in one call."""

    component: str
    kind: str
    variables: list[ScalarVariable]
    place: int
    whole: int


class Loom:
    """Weaves the wiring of one run.

    wiring: what the loop takes; recorded: names of the columns of its rows; links: (source, target) of its
    connections; functions: what its calls call
    """

    def __init__(
        self,
        prepared: PreparedRun,
        components: Mapping[str, FmuInstance],
        storage: Storage | None = None,
    ) -> None:
        checked, experiment, points = prepared.system, prepared.experiment, prepared.points
        self._prepared = prepared
        self._checked, self._experiment, self._components = checked, experiment, components
        self._names = list(components)
        self._bus, self._kept = _Bus(), []
        self.functions: dict[int, list[str]] = {STEP: ["fmi2DoStep"]}
        self.links = self._sorted_links()
        self.recorded = prepared.recorded
        wanted = {*self.recorded, *(source for source, _ in self.links)}
        driven = {target for _, target in self.links}
        self.outputs = [name for name in checked.ports if name in wanted and self._is_output(name)]
        reads = [group for name in components for group in self._groups(name, "output", wanted)]
        writes = [group for name in components for group in self._groups(name, "input", driven)]
        signals = self._bus.add(f"signal {name}" for name in experiment.signals)
        columns = [self._bus.places[name] for name in self.recorded]
        self._values, self._slopes = np.zeros(len(self._bus.names)), np.zeros(len(self._bus.names))
        self._whole = np.zeros(self._bus.whole, np.int32)
        count = len(components)
        ones = self._keep(np.ones(len(self._values), np.int32))
        carried = [self._carried(*link) for link in self.links]
        storage = storage or Storage(np.empty(prepared.shape), np.zeros(REPORT_SIZE, np.int64))
        heard = np.zeros(count, np.int64)
        for c, component in enumerate(components.values()):
            component.log.error_logged = heard[c : c + 1]
            component.call_in_progress = CallInProgress(
                c + 1, *(storage.report[i : i + 1] for i in (BUSY, CALLS))
            )
        self.wiring = Wiring(
            gauss_seidel=int(experiment.algorithm is Algorithm.GAUSS_SEIDEL),
            whole_steps=int(not experiment.tolerance),
            points=points,
            bus=self._values,
            slopes=self._slopes,
            whole=self._whole,
            orders=ones.ctypes.data,
            instance=np.array([each.address for each in components.values()], np.int64),
            do_step=np.array([each.function("fmi2DoStep") for each in components.values()], np.int64),
            period=np.array([prepared.periods[name] for name in components], np.int64),
            only_step=np.array([self._only_step(name) for name in components]),
            begun=np.full(count, experiment.start_time),
            heard=heard,
            warned=np.zeros(count, np.int64),
            warned_at=np.zeros(count),
            writes=self._calls(writes, WRITE, "fmi2Set"),
            derivatives=self._derivatives(writes, carried),
            reads=self._calls(reads, READ, "fmi2Get"),
            links=self._links(carried),
            faults=self._faults(points),
            signals=prepared.signal_values,
            signal_places=np.arange(signals, signals + len(experiment.signals)),
            record=np.array(columns, np.int64),
            rows=storage.rows,
            report=storage.report,
        )

    def _sorted_links(self) -> list[tuple[str, str]]:
        """(source, target) of every connection and signal, in the order of the target's component."""
        pairs = [(a.name, b.name) for a, b in self._checked.connections]
        pairs += [(f"signal {name}", name) for name in self._experiment.signals]
        return sorted(pairs, key=lambda pair: self._names.index(_component(pair[1])))

    def place(self, name: str) -> int:
        """On the bus."""
        return self._bus.places[name]

    def _is_output(self, name: str) -> bool:
        return self._checked.ports[name].variable.causality == "output"

    def _groups(self, component: str, causality: str, only: set[str]) -> list[_Group]:
        """The variables that are needed, a group a type."""
        by_kind: dict[str, list[ScalarVariable]] = {}
        for variable in self._checked.descriptions[component].modelVariables:
            if variable.causality == causality and f"{component}.{variable.name}" in only:
                by_kind.setdefault(TRANSFER_TYPE[variable.type], []).append(variable)
        groups = []
        for kind, variables in by_kind.items():
            place = self._bus.add(f"{component}.{v.name}" for v in variables)
            whole = -1
            if kind != "Real":
                whole = self._bus.whole
                self._bus.whole += len(variables)
            groups.append(_Group(component, kind, variables, place, whole))
        return groups

    def _keep(self, array: np.ndarray) -> np.ndarray:
        """The FMUs are given addresses in it: it must live as long as the wiring."""
        self._kept.append(array)
        return array

    def _references(self, variables: list[ScalarVariable]) -> int:
        return self._keep(np.array([v.valueReference for v in variables], np.uint32)).ctypes.data

    def _calls(self, groups: list[_Group], call: int, verb: str) -> Calls:
        names = [f"{verb}{group.kind}" for group in groups]
        buffers = [
            _address(self._whole, group.whole) if group.whole >= 0 else _address(self._values, group.place)
            for group in groups
        ]
        return self._rows(call, groups, names, buffers)

    def _derivatives(self, groups: list[_Group], carried: list[int]) -> Calls:
        """fmi2SetRealInputDerivatives for the inputs that their FMU carries on itself."""
        there = {target for (_, target), how in zip(self.links, carried, strict=True) if how == BY_THE_FMU}
        groups = [each for each in groups if f"{each.component}.{each.variables[0].name}" in there]
        names = ["fmi2SetRealInputDerivatives"] * len(groups)
        return self._rows(SLOPES, groups, names, [_address(self._slopes, each.place) for each in groups])

    def _rows(self, call: int, groups: list[_Group], names: list[str], buffers: list[int]) -> Calls:
        self.functions[call] = names
        rows = [
            (
                self._components[group.component].function(name),
                self._references(group.variables),
                buffer,
                len(group.variables),
                group.place,
                group.whole,
            )
            for group, name, buffer in zip(groups, names, buffers, strict=True)
        ]
        columns = np.array(rows, np.int64).reshape(-1, 6).T
        first = _starts([group.component for group in groups], self._names)
        return Calls(first, *(np.ascontiguousarray(column) for column in columns))

    def _only_step(self, component: str) -> float:
        """The step size [s] of one that cannot vary it; otherwise 0."""
        interface: Any = self._checked.descriptions[component].coSimulation
        if interface.canHandleVariableCommunicationStepSize:
            return 0.0
        return self._prepared.periods[component] * self._experiment.step_size

    def _carried(self, source: str, target: str) -> int:
        port = self._checked.ports[target]
        ends = [port, *([] if source.startswith("signal ") else [self._checked.ports[source]])]
        is_continuous = all(
            each.variable.type == "Real" and each.variable.variability in (None, "continuous")
            for each in ends
        )
        if not (self._experiment.extrapolation and is_continuous):
            return HELD
        interface: Any = self._checked.descriptions[port.component].coSimulation
        return BY_THE_FMU if interface.canInterpolateInputs else AT_THE_MIDDLE

    def _links(self, carried: list[int]) -> Links:
        faulted = list(self._prepared.fault_patterns)
        count = len(self.links)

        def giver(source: str) -> int:
            return -1 if source.startswith("signal ") else self._names.index(_component(source))

        usual = _JUDGED_REACH if self._experiment.tolerance else _REACH
        givers = [giver(source) for source, _ in self.links]
        periods = [self._prepared.periods[name] for name in self._names]
        ranges = [value_range(self._checked.ports[target]) for _, target in self.links]
        return Links(
            first=_starts([_component(target) for _, target in self.links], self._names),
            source=np.array([self._bus.places[source] for source, _ in self.links], np.int64),
            target=np.array([self._bus.places[target] for _, target in self.links], np.int64),
            giver=np.array(givers, np.int64),
            fault=np.array([faulted.index(t) if t in faulted else -1 for _, t in self.links], np.int64),
            carried=np.array(carried, np.int64),
            low=np.array([low for low, _ in ranges]),
            high=np.array([high for _, high in ranges]),
            value=np.zeros(count),
            slope=np.zeros(count),
            stamp=np.full(count, -np.inf),
            given=np.zeros(count),
            interval=np.zeros(count),
            reach=np.array(
                [
                    usual * self._prepared.periods[_component(target)] / (periods[c] if c >= 0 else 1)
                    for c, (_, target) in zip(givers, self.links, strict=True)
                ]
            ),
        )

    def _faults(self, points: np.ndarray) -> Faults:
        patterns = self._prepared.fault_patterns
        shape = len(patterns), len(points)
        source, addition = np.zeros(shape, np.int64), np.zeros(shape)
        for row, pattern in enumerate(patterns.values()):
            source[row], addition[row] = pattern
        return Faults(source, addition, np.zeros(shape))


def _component(name: str) -> str:
    return name.partition(".")[0]


def _address(array: np.ndarray, place: int) -> int:
    return array.ctypes.data + place * array.itemsize


def _starts(owners: list[str], names: list[str]) -> np.ndarray:
    """Where the entries of each component begin, and behind the last; `owners` are in order."""
    counts = [owners.count(name) for name in names]
    return np.array([0, *np.cumsum(counts)], np.int64)

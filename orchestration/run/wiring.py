"""A prepared run and its FMU instances as the arrays of the communication loop."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fmus.fmi.description import is_independent
from fmus.fmi.instance import FmuInstance
from orchestration.run.bus import SIGNAL, BusLayout, Strings, VariableGroup, component_of, lay_out_bus
from orchestration.run.compiled_loop import compiled_loop
from orchestration.run.loop_data import (
    CHANGING_OF_CONNECTIONS,
    Call,
    Calls,
    Connections,
    Faults,
    LoopFunctions,
    Report,
    Storage,
    Wiring,
)
from orchestration.system.experiment import Algorithm
from orchestration.system.faults import Pattern
from orchestration.system.prepared_run import PreparedRun
from orchestration.system.system import LinearTransformation

_UNCHANGED = LinearTransformation()
_NOTHING_TO_TAKE = 2**32 - 1  # `ticket` of loop.c
# How much longer than usual a step may be than the interval from which its slope was taken. With a tolerance
# the error is estimated, and a step may follow half a step and be five times as long as the whole.
_SLOPE_VALIDITY, _SLOPE_VALIDITY_WITH_TOLERANCE = 2.0, 10.0


@dataclass(frozen=True)
class WiredRun:
    """A prepared run, its FMU instances and their wiring, and the names of the wiring's elements.

    references: value references and orders, whose addresses are in the wiring
    strings: the values of Strings
    loop_of: makes the loop of a wiring
    """

    prepared: PreparedRun
    instances: Mapping[str, FmuInstance]
    wiring: Wiring
    bus: BusLayout
    references: Sequence[np.ndarray]
    strings: Strings
    loop_of: Callable[[Wiring], LoopFunctions]

    @cached_property
    def loop(self) -> LoopFunctions:
        """The communication loop over the arrays."""
        return self.loop_of(self.wiring)

    def again(self, prepared: PreparedRun, storage: Storage) -> "WiredRun":
        """Returns the wiring of a run that differs in settings alone and follows this ended one."""
        if self.strings.table != Strings().table:
            return build_wiring(prepared, self.instances, storage, self.loop_of)
        wiring = self.wiring._replace(
            points=prepared.points,
            signal_values=prepared.signal_values,
            rows=storage.rows,
            report=storage.report,
            step_times=storage.step_times,
            error_logged=_report_calls(self.instances, storage.report),
        )
        _set_start(wiring, prepared)
        return replace(self, prepared=prepared, wiring=wiring)


def build_wiring(
    prepared: PreparedRun,
    instances: Mapping[str, FmuInstance],
    storage: Storage,
    loop_of: Callable[[Wiring], LoopFunctions] = compiled_loop,
) -> WiredRun:
    """Returns the arrays of a run at its start time."""
    bus, experiment = lay_out_bus(prepared), prepared.experiment
    count, periods = len(instances), np.array([prepared.periods[name] for name in instances], np.int64)
    fixed = prepared.system.components_without("canHandleVariableCommunicationStepSize")
    unable = prepared.system.components_without("canGetAndSetFMUstate")
    memory, parts = _memory(bus, count)
    values, slopes, integers = parts["bus"], parts["slopes"], parts["integers"]
    ones = np.ones(len(bus.index), np.int32)
    references: list[np.ndarray] = [ones]
    strings = Strings()
    others = integers, references, strings, instances
    wiring = Wiring(
        gauss_seidel=int(experiment.algorithm is Algorithm.GAUSS_SEIDEL),
        full_steps=int(not experiment.tolerance),
        independent=int(all(is_independent(instance.description) for instance in instances.values())),
        points=prepared.points,
        bus=values,
        slopes=slopes,
        integers=integers,
        orders=ones.ctypes.data,
        memory=memory,
        instances=np.array([instance.address for instance in instances.values()], np.int64),
        do_step=_addresses("fmi2DoStep", instances),
        real_status=_addresses("fmi2GetRealStatus", instances),
        boolean_status=_addresses("fmi2GetBooleanStatus", instances),
        get_state=_addresses("fmi2GetFMUstate", instances, unable),
        set_state=_addresses("fmi2SetFMUstate", instances, unable),
        periods=periods,
        fixed_step_size=np.isin(list(instances), fixed) * periods * experiment.step_size,
        step_start=parts["step_start"],
        error_logged=_report_calls(instances, storage.report),
        warning=parts["warning"],
        warning_time=np.zeros(count),
        input_calls=_calls(bus.calls[Call.SET_INPUTS], values, *others),
        derivative_calls=_calls(bus.calls[Call.SET_DERIVATIVES], slopes, *others),
        output_calls=_calls(bus.calls[Call.GET_OUTPUTS], values, *others),
        connections=_connections(prepared, bus, parts),
        faults=_faults(prepared),
        signal_values=prepared.signal_values,
        signal_index=np.array([bus.index[f"{SIGNAL}{name}"] for name in experiment.signals], np.int64),
        record_index=np.array([bus.index[name] for name in prepared.recorded], np.int64),
        rows=storage.rows,
        report=storage.report,
        step_status=np.zeros(count, np.int64),
        team=np.array([0, 0, _NOTHING_TO_TAKE, 0, 0, 0], np.int64),
        step_times=storage.step_times,
    )
    _set_start(wiring, prepared)
    for name, value in prepared.external.items():
        values[bus.index[f"{SIGNAL}{name}"]] = value
    return WiredRun(prepared, instances, wiring, bus, references, strings, loop_of)


def move_point(run: WiredRun, index: int, time: float) -> Callable[[], None]:
    """Moves a communication point to an earlier time [s], with signals and faults; it is the last one then.

    Returns a function that moves it back.
    """
    wiring, faults = run.wiring, run.wiring.faults
    of_points = [wiring.points, wiring.signal_values.T, faults.addition.T]
    of_points += [array.swapaxes(0, 1) for array in (faults.source, faults.weight)]
    before = [array[index].copy() for array in of_points]
    wiring.points[index] = time
    shortened = replace(run.prepared, points=wiring.points[: index + 1])
    wiring.signal_values[:, index] = shortened.signal_values[:, -1]
    for row, pattern in enumerate(shortened.fault_patterns.values()):
        faults.put(row, index, Pattern(*(x[-1] for x in pattern)))

    def move_back() -> None:
        for array, values in zip(of_points, before, strict=True):
            array[index] = values

    return move_back


def _set_start(wiring: Wiring, prepared: PreparedRun) -> None:
    """Sets what a step changes to what it is at the start time, without external values."""
    wiring.memory[:] = 0.0
    wiring.step_start[:] = prepared.experiment.start_time
    wiring.connections.sample_time[:] = -np.inf


def _memory(bus: BusLayout, count: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Returns all that a step changes as one array, and its parts by name; count: of components."""
    n, n_connections, n_integers = len(bus.index), len(bus.connections), bus.integer_count
    sizes = dict.fromkeys(CHANGING_OF_CONNECTIONS, n_connections)
    # two integers of 32 bits stand in the place of one number of 64
    sizes |= {"bus": n, "slopes": n, "step_start": count, "warning": count, "integers": -(-n_integers // 2)}
    memory = np.empty(sum(sizes.values()))
    parts: dict[str, np.ndarray] = dict(
        zip(sizes, np.split(memory, np.cumsum([*sizes.values()])[:-1]), strict=True)
    )
    parts["warning"] = parts["warning"].view(np.int64)
    parts["integers"] = parts["integers"].view(np.int32)[:n_integers]
    return memory, parts


def _addresses(function: str, instances: Mapping[str, FmuInstance], unable: Sequence[str] = ()) -> np.ndarray:
    """Returns the address of a function for each component, 0 for those that do not have it."""
    values = [0 if name in unable else instance.function(function) for name, instance in instances.items()]
    return np.array(values, np.int64)


def _report_calls(instances: Mapping[str, FmuInstance], report: np.ndarray) -> np.ndarray:
    """Lets the instances count their calls in the report; returns the array where they flag logged errors."""
    error_logged = np.zeros(len(instances), np.int64)
    busy, calls = (report[index : index + 1] for index in (Report.BUSY, Report.CALLS))
    for c, instance in enumerate(instances.values()):
        instance.log.error_logged = error_logged[c : c + 1]
        instance.number, instance.busy, instance.calls = c + 1, busy, calls
    return error_logged


def _calls(
    groups: Sequence[VariableGroup],
    reals: np.ndarray,
    integers: np.ndarray,
    references: list[np.ndarray],
    strings: Strings,
    instances: Mapping[str, FmuInstance],
) -> Calls:
    """Returns one row for each group and adds its value references to `references`."""
    rows = []
    for group in groups:
        references.append(np.array([port.variable.valueReference for port in group.ports], np.uint32))
        array, index = (
            (reals, group.bus_index) if group.integer_index < 0 else (integers, group.integer_index)
        )
        addresses = references[-1].ctypes.data, array.ctypes.data + index * array.itemsize
        sizes = len(group.ports), group.bus_index, group.integer_index
        instance = instances[group.component]
        is_string = group.type == "String"
        name = group.function
        address = strings.function(instance, name) if is_string else instance.function(name)
        rows.append((address, *addresses, *sizes))
    return Calls(
        _first_of_each([group.component for group in groups], instances), *_columns(rows, 6, np.int64)
    )


def _connections(prepared: PreparedRun, bus: BusLayout, parts: Mapping[str, np.ndarray]) -> Connections:
    numbers = {name: c for c, name in enumerate(prepared.system.components)}
    faults = {name: row for row, name in enumerate(prepared.fault_patterns)}
    validity = _SLOPE_VALIDITY_WITH_TOLERANCE if prepared.experiment.tolerance else _SLOPE_VALIDITY
    targets = [component_of(target, prepared) for _, target in bus.connections]
    indices, limits = [], []
    for (source, target), own, mode in zip(bus.connections, targets, bus.input_modes, strict=True):
        owner, ends = component_of(source, prepared), (bus.index[source], bus.index[target])
        indices.append((*ends, numbers.get(owner, -1), faults.get(target, -1), mode))
        periods = prepared.periods[own] / prepared.periods.get(owner, 1)
        transformation = prepared.system.transformations.get(target, _UNCHANGED)
        # x + -0.0 has the bits of x, also for x = -0.0
        change = transformation.factor, transformation.offset or -0.0
        limits.append((*prepared.input_ranges[target], validity * periods, *change))
    return Connections(
        _first_of_each(targets, prepared.system.components),
        *_columns(indices, 5, np.int64),
        *_columns(limits, 5, np.float64),
        **{name: parts[name] for name in CHANGING_OF_CONNECTIONS},
    )


def _faults(prepared: PreparedRun) -> Faults:
    patterns = [*prepared.fault_patterns.values()]
    shape = len(patterns), len(prepared.points)
    terms = max((pattern.source.shape[1] for pattern in patterns), default=1)
    source, weight = np.full((*shape, terms), -1, np.int64), np.ones((*shape, terms))
    faults = Faults(terms, source, weight, np.zeros(shape), np.zeros(shape))
    for row, pattern in enumerate(patterns):
        faults.put(row, slice(None), pattern)
    return faults


def _columns(rows: Sequence[tuple[float, ...]], width: int, kind: type[np.generic]) -> np.ndarray:
    """Rows as contiguous columns, shape (width, rows)."""
    return np.ascontiguousarray(np.array(rows, kind).reshape(-1, width).T)


def _first_of_each(owners: Iterable[str], components: Iterable[str]) -> np.ndarray:
    """Returns the index of each component's first entry, and the number of entries; `owners` are in order."""
    counts = Counter(owners)
    return np.cumsum([0, *(counts[name] for name in components)], dtype=np.int64)

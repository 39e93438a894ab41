"""A prepared run and its FMU instances as the arrays of the communication loop."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from orchestration.fmi.instance import CallInProgress, FmuInstance
from orchestration.master.bus import SIGNAL, BusLayout, VariableGroup, component_of, lay_out_bus
from orchestration.master.loop_data import (
    BUSY,
    CALLS,
    DO_STEP,
    FMU_DERIVATIVE,
    GET_OUTPUTS,
    HOLD,
    MIDPOINT,
    SET_DERIVATIVES,
    SET_INPUTS,
    Calls,
    Connections,
    Faults,
    Storage,
    Wiring,
)
from orchestration.system.experiment import Algorithm
from orchestration.system.prepared_run import PreparedRun

# How much longer than usual a step may be than the interval from which its slope was taken. With a tolerance
# the error is estimated, and a step may follow half a step and be five times as long as the whole.
_SLOPE_VALIDITY, _SLOPE_VALIDITY_WITH_TOLERANCE = 2.0, 10.0


@dataclass(frozen=True)
class NamedWiring:
    """The wiring of a run, and the names of its elements.

    functions: kind of call -> the FMI function of each of its rows
    references: value references, whose addresses are in the wiring
    """

    wiring: Wiring
    bus: BusLayout
    functions: Mapping[int, Sequence[str]]
    references: Sequence[np.ndarray]


def build_wiring(
    prepared: PreparedRun,
    instances: Mapping[str, FmuInstance],
    storage: Storage,
    error_logged: np.ndarray,
) -> NamedWiring:
    """The arrays of a run at its start time; error_logged: of `report_calls`."""
    bus, experiment = lay_out_bus(prepared), prepared.experiment
    count = len(instances)
    values, slopes = np.zeros(len(bus.index)), np.zeros(len(bus.index))
    integers, ones = np.zeros(bus.integer_count, np.int32), np.ones(len(bus.index), np.int32)
    modes = [_input_mode(prepared, source, target) for source, target in bus.connections]
    extrapolated = _groups_with_mode(bus, modes, FMU_DERIVATIVE)
    functions = {
        SET_INPUTS: [f"fmi2Set{group.type}" for group in bus.inputs],
        SET_DERIVATIVES: ["fmi2SetRealInputDerivatives"] * len(extrapolated),
        GET_OUTPUTS: [f"fmi2Get{group.type}" for group in bus.outputs],
        DO_STEP: ["fmi2DoStep"],
    }
    references: list[np.ndarray] = []

    def calls(kind: int, groups: Sequence[VariableGroup], reals: np.ndarray) -> Calls:
        arrays = [np.array([v.valueReference for v in group.variables], np.uint32) for group in groups]
        references.extend(arrays)
        buffers = [_buffer(group, reals, integers) for group in groups]
        return _calls(instances, groups, functions[kind], arrays, buffers)

    wiring = Wiring(
        gauss_seidel=int(experiment.algorithm is Algorithm.GAUSS_SEIDEL),
        full_steps=int(not experiment.tolerance),
        points=prepared.points,
        bus=values,
        slopes=slopes,
        integers=integers,
        orders=ones.ctypes.data,
        instances=np.array([instance.address for instance in instances.values()], np.int64),
        do_step=np.array([instance.function("fmi2DoStep") for instance in instances.values()], np.int64),
        periods=np.array([prepared.periods[name] for name in instances], np.int64),
        fixed_step_size=np.array([_fixed_step_size(prepared, name) for name in instances]),
        step_start=np.full(count, experiment.start_time),
        error_logged=error_logged,
        warning=np.zeros(count, np.int64),
        warning_time=np.zeros(count),
        input_calls=calls(SET_INPUTS, bus.inputs, values),
        derivative_calls=calls(SET_DERIVATIVES, extrapolated, slopes),
        output_calls=calls(GET_OUTPUTS, bus.outputs, values),
        connections=_connections(prepared, bus, modes),
        faults=_faults(prepared),
        signal_values=prepared.signal_values,
        signal_index=np.array([bus.index[f"{SIGNAL}{name}"] for name in experiment.signals], np.int64),
        record_index=np.array([bus.index[name] for name in prepared.recorded], np.int64),
        rows=storage.rows,
        report=storage.report,
    )
    return NamedWiring(wiring, bus, functions, [*references, ones])


def report_calls(instances: Mapping[str, FmuInstance], report: np.ndarray) -> np.ndarray:
    """Let the instances count their calls in the report; returns the array where they flag logged errors."""
    error_logged = np.zeros(len(instances), np.int64)
    busy, calls = report[BUSY : BUSY + 1], report[CALLS : CALLS + 1]
    for c, instance in enumerate(instances.values()):
        instance.log.error_logged = error_logged[c : c + 1]
        instance.call_in_progress = CallInProgress(c + 1, busy, calls)
    return error_logged


def _buffer(group: VariableGroup, reals: np.ndarray, integers: np.ndarray) -> int:
    """Address of the first value of a group."""
    is_real = group.integer_index < 0
    array, index = (reals, group.bus_index) if is_real else (integers, group.integer_index)
    return array.ctypes.data + index * array.itemsize


def _calls(
    instances: Mapping[str, FmuInstance],
    groups: Sequence[VariableGroup],
    functions: Sequence[str],
    references: Sequence[np.ndarray],
    buffers: Sequence[int],
) -> Calls:
    rows = [
        (
            instances[group.component].function(function),
            array.ctypes.data,
            buffer,
            len(group.variables),
            group.bus_index,
            group.integer_index,
        )
        for group, function, array, buffer in zip(groups, functions, references, buffers, strict=True)
    ]
    columns = np.array(rows, np.int64).reshape(-1, 6).T
    first = _first_of_each([group.component for group in groups], list(instances))
    return Calls(first, *(np.ascontiguousarray(column) for column in columns))


def _groups_with_mode(bus: BusLayout, modes: Sequence[int], mode: int) -> list[VariableGroup]:
    """The groups whose first input has this input mode."""
    targets = {target for (_, target), own in zip(bus.connections, modes, strict=True) if own == mode}
    return [group for group in bus.inputs if group.names[0] in targets]


def _fixed_step_size(prepared: PreparedRun, component: str) -> float:
    interface: Any = prepared.system.descriptions[component].coSimulation
    if interface.canHandleVariableCommunicationStepSize:
        return 0.0
    return prepared.periods[component] * prepared.experiment.step_size


def _input_mode(prepared: PreparedRun, source: str, target: str) -> int:
    ports = prepared.system.ports
    ends = [ports[name].variable for name in (source, target) if not name.startswith(SIGNAL)]
    is_continuous = all(v.type == "Real" and v.variability in (None, "continuous") for v in ends)
    if not (prepared.experiment.extrapolation and is_continuous):
        return HOLD
    interface: Any = prepared.system.descriptions[ports[target].component].coSimulation
    return FMU_DERIVATIVE if interface.canInterpolateInputs else MIDPOINT


def _connections(prepared: PreparedRun, bus: BusLayout, modes: list[int]) -> Connections:
    components, faulted = list(prepared.system.components), list(prepared.fault_patterns)
    count = len(bus.connections)
    sources = [
        -1 if source.startswith(SIGNAL) else components.index(component_of(source))
        for source, _ in bus.connections
    ]
    targets = [component_of(target) for _, target in bus.connections]
    ranges = [prepared.input_ranges[target] for _, target in bus.connections]
    validity = _SLOPE_VALIDITY_WITH_TOLERANCE if prepared.experiment.tolerance else _SLOPE_VALIDITY
    source_periods = [1 if c < 0 else prepared.periods[components[c]] for c in sources]
    return Connections(
        first=_first_of_each(targets, components),
        source=np.array([bus.index[source] for source, _ in bus.connections], np.int64),
        target=np.array([bus.index[target] for _, target in bus.connections], np.int64),
        source_component=np.array(sources, np.int64),
        fault=np.array([faulted.index(t) if t in faulted else -1 for _, t in bus.connections], np.int64),
        input_mode=np.array(modes, np.int64),
        minimum=np.array([low for low, _ in ranges]),
        maximum=np.array([high for _, high in ranges]),
        value=np.zeros(count),
        slope=np.zeros(count),
        sample_time=np.full(count, -np.inf),
        sample=np.zeros(count),
        sample_interval=np.zeros(count),
        slope_validity=np.array(
            [
                validity * prepared.periods[target] / period
                for target, period in zip(targets, source_periods, strict=True)
            ]
        ),
    )


def _faults(prepared: PreparedRun) -> Faults:
    patterns = prepared.fault_patterns
    shape = len(patterns), len(prepared.points)
    source, addition = np.zeros(shape, np.int64), np.zeros(shape)
    for row, pattern in enumerate(patterns.values()):
        source[row], addition[row] = pattern
    return Faults(source, addition, np.zeros(shape))


def _first_of_each(owners: list[str], components: list[str]) -> np.ndarray:
    """Index of each component's first entry, and the number of entries; `owners` are in order."""
    counts = [owners.count(name) for name in components]
    return np.array([0, *np.cumsum(counts)], np.int64)

"""The communication loop over the arrays of `loop_data.py` in Python: the oracle of `loop.c`.

It has the same results to the last bit (run/test_combinations.py, run/test_loop.py); it measures no times,
and no component terminates its runs. At a communication point `exchange_and_record` updates every connection
and records; `step` leads to the next:

    Jacobi         all inputs are set, then all components step, then all outputs are read
    Gauss-Seidel   component by component, each with the newest outputs there are

A component of period p starts a step at every p-th point. A slope that is extrapolated over a step much
longer than the interval from which it was taken is reduced: a jump over a short step must not be extrapolated
over a long one.
"""

import ctypes
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np

from fmus.fmi.binding import OK, WARNING
from orchestration.run.loop_data import Call, Calls, InputMode, LoopFunctions, Report, SavedMemory, Wiring
from orchestration.run.simulator import Simulator


def python_loop(wiring: Wiring) -> LoopFunctions:
    """Returns the functions below for one wiring."""
    functions: Any = (run, exchange_and_record, exchange, step, read_outputs, save, restore)
    return LoopFunctions(*(partial(function, wiring) for function in functions))


class LoopInPython(Simulator):
    """A simulator whose communication loop is this one."""

    _loop = staticmethod(python_loop)


def run(wiring: Wiring, first: int, last: int) -> int:
    """Steps from communication point `first` to `last`; `last` itself is neither exchanged nor recorded.

    Returns the point reached; if that is before `last`, `report` holds the failure.
    """
    for point in range(first, last):
        start, end = wiring.points[point], wiring.points[point + 1]
        if not (exchange_and_record(wiring, point) and step(wiring, point, start, end)):
            return point
        wiring.report[Report.POSITION] = point + 1
    return last


def exchange_and_record(wiring: Wiring, point: int) -> bool:
    """Updates the signals and the connections at a communication point, and records it."""
    for signal in range(len(wiring.signal_index)):
        wiring.bus[wiring.signal_index[signal]] = wiring.signal_values[signal, point]
    is_finite = exchange(wiring, point, wiring.points[point], True)
    for column in range(len(wiring.record_index)):
        wiring.rows[point, column] = wiring.bus[wiring.record_index[column]]
    wiring.report[Report.RECORDED] = point + 1
    return is_finite


def exchange(wiring: Wiring, point: int, time: float, on_point: bool) -> bool:
    """Transfers the new values on all connections; a faulted one only at communication points.

    point: the communication point at or before `time` [s]; on_point: whether `time` is that of the point
    """
    connections = wiring.connections
    is_finite = True
    is_last = point + 1 == len(wiring.points)
    for k in range(len(connections.source)):
        source = connections.source_component[k]
        has_fault = connections.fault[k] >= 0
        is_new = source < 0 or is_last or point % wiring.periods[source] == 0
        if on_point if has_fault else is_new:
            is_finite = transfer(wiring, k, point, time, is_new) and is_finite
    return is_finite


def transfer(wiring: Wiring, k: int, point: int, time: float, is_new: bool) -> bool:
    """Transfers the source's value on connection k; False if it is not finite.

    is_new: whether the source provided the value at `time` [s], or has held it since an earlier time
    """
    connections, faults = wiring.connections, wiring.faults
    value = float(wiring.bus[connections.source[k]] * connections.factor[k] + connections.offset[k])
    fault = connections.fault[k]
    if fault >= 0:
        faults.history[fault, point] = value
        value = float(faults.addition[fault, point])
        for term in range(faults.terms):
            origin = faults.source[fault, point, term]
            if origin >= 0:
                value += float(faults.weight[fault, point, term] * faults.history[fault, origin])
    if connections.input_mode[k] != InputMode.HOLD and is_new:
        if time > connections.sample_time[k]:
            connections.sample_interval[k] = time - connections.sample_time[k]
            connections.slope[k] = (value - connections.sample[k]) / connections.sample_interval[k]
            connections.sample_time[k] = time
        connections.sample[k] = value
    connections.value[k] = value
    wiring.bus[connections.target[k]] = value
    if np.isfinite(value):
        return True
    wiring.report[Report.FAILURE : Report.STATUS] = Call.NOT_FINITE, -1, k
    return False


def step(wiring: Wiring, point: int, start: float, end: float) -> bool:
    """Steps all components from `start` to `end` [s], within the communication step from a point."""
    step_all = _gauss_seidel_step if wiring.gauss_seidel else _jacobi_step
    return step_all(wiring, point, start, end)


def _jacobi_step(wiring: Wiring, point: int, start: float, end: float) -> bool:
    count = len(wiring.instances)
    for c in range(count):
        if point % wiring.periods[c] == 0 and not _start_step(wiring, c, point, start, end):
            return False
    for c in range(count):
        if _ends_step(wiring, c, point) and not _do_step(wiring, c, end):
            return False
    return all(read_outputs(wiring, c) for c in range(count) if _ends_step(wiring, c, point))


def _start_step(wiring: Wiring, c: int, point: int, start: float, end: float) -> bool:
    """Starts the step of component c with the inputs of `start`."""
    wiring.step_start[c] = start
    if wiring.periods[c] > 1:
        end = float(wiring.points[min(point + wiring.periods[c], len(wiring.points) - 1)])
    return _write_inputs(wiring, c, start, end - start)


def _gauss_seidel_step(wiring: Wiring, point: int, start: float, end: float) -> bool:
    connections = wiring.connections
    is_full_step = wiring.full_steps and (start, end) == (wiring.points[point], wiring.points[point + 1])
    for c in range(len(wiring.instances)):
        if point % wiring.periods[c] == 0:
            wiring.step_start[c] = start
        if not _ends_step(wiring, c, point):
            continue
        for k in range(connections.first[c], connections.first[c + 1]):
            source = connections.source_component[k]
            is_newer = 0 <= source < c and _ends_step(wiring, source, point)
            may_transfer = is_full_step or connections.fault[k] < 0
            if is_newer and may_transfer and not transfer(wiring, k, point + 1, end, True):
                return False
        has_inputs = _write_inputs(wiring, c, wiring.step_start[c], end - wiring.step_start[c])
        if not (has_inputs and _do_step(wiring, c, end) and read_outputs(wiring, c)):
            return False
    return True


def _ends_step(wiring: Wiring, c: int, point: int) -> bool:
    """Whether a step of component c ends with the communication step from a point."""
    return (point + 1) % wiring.periods[c] == 0 or point + 2 == len(wiring.points)


def _write_inputs(wiring: Wiring, c: int, start: float, size: float) -> bool:
    """Sets the inputs of component c, and their derivatives, for a step of `size` [s]."""
    connections = wiring.connections
    for k in range(connections.first[c], connections.first[c + 1]):
        if connections.input_mode[k] != InputMode.HOLD:  # else `transfer` has put the value on the bus
            _extrapolate(wiring, k, start, size)
    calls = wiring.input_calls
    for g in range(calls.first[c], calls.first[c + 1]):
        if calls.integer_index[g] >= 0:
            for j in range(calls.size[g]):
                wiring.integers[calls.integer_index[g] + j] = int(wiring.bus[calls.bus_index[g] + j])
        if not _exchange_values(wiring, calls, Call.SET_INPUTS, c, g):
            return False
    calls = wiring.derivative_calls
    groups = range(calls.first[c], calls.first[c + 1])
    return all(_exchange_values(wiring, calls, Call.SET_DERIVATIVES, c, g) for g in groups)


def _extrapolate(wiring: Wiring, k: int, start: float, size: float) -> None:
    """Puts the extrapolated value and slope of connection k on the bus, for a step of `size` [s]."""
    connections = wiring.connections
    value, slope = float(connections.value[k]), float(connections.slope[k])
    longest = connections.slope_validity[k] * connections.sample_interval[k]
    if size > longest:
        slope *= longest / size
    value += slope * (start - connections.sample_time[k])
    if connections.input_mode[k] == InputMode.MIDPOINT:
        value = min(max(value + slope * (0.5 * size), connections.minimum[k]), connections.maximum[k])
    wiring.slopes[connections.target[k]] = slope
    wiring.bus[connections.target[k]] = value


def read_outputs(wiring: Wiring, c: int) -> bool:
    """Reads the outputs of component c to the bus."""
    calls = wiring.output_calls
    for g in range(calls.first[c], calls.first[c + 1]):
        if not _exchange_values(wiring, calls, Call.GET_OUTPUTS, c, g):
            return False
        if calls.integer_index[g] >= 0:
            for j in range(calls.size[g]):
                wiring.bus[calls.bus_index[g] + j] = wiring.integers[calls.integer_index[g] + j]
    return True


def save(wiring: Wiring, saved: SavedMemory) -> bool:
    """Saves the states of all components and what a step changes; `saved` holds earlier states, or 0."""
    count = len(wiring.instances)
    np.ctypeslib.as_array(saved)[count:] = wiring.memory.view(np.int64)
    for c in range(count):
        wiring.report[Report.BUSY] = c + 1
        get_state = _function(_state_type, int(wiring.get_state[c]))
        status = get_state(int(wiring.instances[c]), ctypes.addressof(saved) + c * ctypes.sizeof(_POINTER))
        if not _is_accepted(wiring, Call.GET_STATE, c, 0, status):
            return False
    return True


def restore(wiring: Wiring, saved: SavedMemory) -> bool:
    """Sets everything back to what `save` has saved."""
    count = len(wiring.instances)
    wiring.memory[:] = np.ctypeslib.as_array(saved)[count:].view(np.float64)
    for c in range(count):
        wiring.report[Report.BUSY] = c + 1
        set_state = _function(_state_type, int(wiring.set_state[c]))
        if not _is_accepted(wiring, Call.SET_STATE, c, 0, set_state(int(wiring.instances[c]), saved[c])):
            return False
    return True


# Calls of FMI functions by their addresses.

_POINTER, _SIZE, _INT = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int
_exchange_type = ctypes.CFUNCTYPE(_INT, _POINTER, _POINTER, _SIZE, _POINTER)
_derivatives_type = ctypes.CFUNCTYPE(_INT, _POINTER, _POINTER, _SIZE, _POINTER, _POINTER)
_state_type = ctypes.CFUNCTYPE(_INT, _POINTER, _POINTER)
_step_type = ctypes.CFUNCTYPE(_INT, _POINTER, ctypes.c_double, ctypes.c_double, _INT)


@cache
def _function(kind: Any, address: int) -> Callable[..., int]:
    return kind(address)


def _do_step(wiring: Wiring, c: int, end: float) -> bool:
    start, fixed_size = wiring.step_start[c], wiring.fixed_step_size[c]
    size = fixed_size if fixed_size > 0.0 else end - start
    wiring.report[Report.BUSY] = c + 1
    do_step = _function(_step_type, int(wiring.do_step[c]))
    status = do_step(int(wiring.instances[c]), start, size, 1)
    return _is_accepted(wiring, Call.DO_STEP, c, 0, status)


def _exchange_values(wiring: Wiring, calls: Calls, kind: int, c: int, g: int) -> bool:
    """Calls fmi2Get... or fmi2Set... of Real, Integer or Boolean variables, or of input derivatives."""
    orders = (wiring.orders,) if kind == Call.SET_DERIVATIVES else ()
    function = _function(_derivatives_type if orders else _exchange_type, int(calls.function[g]))
    wiring.report[Report.BUSY] = c + 1
    status = function(
        int(wiring.instances[c]), int(calls.references[g]), int(calls.size[g]), *orders, int(calls.buffer[g])
    )
    return _is_accepted(wiring, kind, c, g, status)


def _is_accepted(wiring: Wiring, kind: int, c: int, index: int, status: int) -> bool:
    """Whether the loop goes on after a call that returned; a warning is kept, a failure reported."""
    wiring.report[Report.BUSY] = 0
    wiring.report[Report.CALLS] += 1
    if status in (OK, WARNING) and not wiring.error_logged[c]:
        if status != OK and wiring.warning[c] == Call.NO_FAILURE:
            wiring.warning[c] = kind
            wiring.warning_time[c] = wiring.step_start[c]
        return True
    wiring.report[Report.FAILURE : Report.BUSY] = kind, c, index, status
    return False

"""The communication loop: what happens between two looks of Python, over arrays that never move.

This is the loop to read. `loop.c` has it function by function for a machine, with the same results to the
last bit (tests/orchestration/master/test_loop.py); `compiled_loop.py` compiles that. At a communication point
`arrive` takes what every connection carries and records; `step` leads to the next one:

    Jacobi         everything is written, then everything steps, then everything is read
    Gauss-Seidel   component by component, each with the newest outputs there are

A connection carries u(t) = value + slope (t - stamp), where `slope` is 0 or, with first-order extrapolation,
the difference quotient of the last two values that its source gave. Over a step that is much longer than the
one it was taken from, the slope is less: a jump in a short step must not become a leap in a long one. A
component of period p steps from every p-th point.
"""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np

Array = np.ndarray

# how a connection is carried on between communication points
HELD, BY_THE_FMU, AT_THE_MIDDLE = 0, 1, 2
# what failed
NOTHING, WRITE, SLOPES, STEP, READ, CONNECTION = range(6)
# places in `Wiring.report`
RECORDED, FAILURE, WHO, WHICH, STATUS, BUSY, CALLS = range(7)
REPORT_SIZE = 7
_WARNING = 1  # of fmi2Status; what is worse ends the loop


class Calls(NamedTuple):
    """One fmi2Get or fmi2Set a row; those of component c are first[c]..first[c+1]-1.

    function, references, buffer: addresses; size: number of values; place: of the first on the bus;
    whole: of the first among the whole numbers, -1 for Real, whose buffer is the bus itself
    """

    first: Array
    function: Array
    references: Array
    buffer: Array
    size: Array
    place: Array
    whole: Array


class Links(NamedTuple):
    """Connections and signals; those into component c are first[c]..first[c+1]-1.

    source, target: places on the bus; giver: component, -1 for a signal; fault: row of `Faults` or -1;
    carried: HELD, ...; low, high: limits of what is carried to the middle of a step
    value, slope, stamp: what it carries, see above; given: the value that its source gave at `stamp`,
    interval: after that before [s]; reach: how many intervals the slope is good for
    """

    first: Array
    source: Array
    target: Array
    giver: Array
    fault: Array
    carried: Array
    low: Array
    high: Array
    value: Array
    slope: Array
    stamp: Array
    given: Array
    interval: Array
    reach: Array


class Faults(NamedTuple):
    """A row a faulted connection: at point i it carries history[source[i]] + addition[i], or addition[i]
    where source[i] is negative."""

    source: Array
    addition: Array
    history: Array


class Wiring(NamedTuple):
    """All that the loop touches.

    gauss_seidel, whole_steps: 1 or 0; with a tolerance steps are not whole, and a faulted connection carries
    the sample of the last communication point throughout
    points: communication points [s]; bus: every value that travels, as float64; slopes: of inputs, in their
    places on the bus; whole: Integer and Boolean values; orders: address of a 1 for each derivative
    instance, do_step: addresses, a component each; period: in steps; only_step: the step size [s] of one that
    takes no other, else 0; begun: time [s] of its step under way
    heard: not 0 once an FMU logged an error; warned, warned_at: first call that warned, and its time [s]
    signals: a row each, at every point, for the place signal_places; record: places; rows: their values
    report: RECORDED rows, what is the FAILURE, of WHO, in WHICH call or connection, with which STATUS;
    BUSY: 1 + the component of which a call is under way, negative while it is loaded, 0 for none;
    CALLS that have returned
    """

    gauss_seidel: int
    whole_steps: int
    points: Array
    bus: Array
    slopes: Array
    whole: Array
    orders: int
    instance: Array
    do_step: Array
    period: Array
    only_step: Array
    begun: Array
    heard: Array
    warned: Array
    warned_at: Array
    writes: Calls
    derivatives: Calls
    reads: Calls
    links: Links
    faults: Faults
    signals: Array
    signal_places: Array
    record: Array
    rows: Array
    report: Array


@dataclass(frozen=True)
class Storage:
    """Where a run keeps its record, for someone else to read while it goes on.

    rows: shape (communication points, signals); report: shape (REPORT_SIZE,)
    """

    rows: Array
    report: Array


class Entries(NamedTuple):
    """The functions of the loop that Python calls, for one wiring; as below, without their first argument."""

    run: Callable[[int, int], int]
    arrive: Callable[[int], bool]
    exchange: Callable[[int, float, bool], bool]
    step: Callable[[int, float, float], bool]
    read: Callable[[int], bool]


def plain(w: Wiring) -> Entries:
    """The loop as it stands here."""
    functions: Any = (run, arrive, exchange, step, read)
    return Entries(*(partial(each, w) for each in functions))


def run(w: Wiring, first: int, last: int) -> int:
    """From communication point `first` to `last`, which is reached but not looked at.

    Returns the point reached; one before `last` means that `report` tells a failure.
    """
    for i in range(first, last):
        if not (arrive(w, i) and step(w, i, w.points[i], w.points[i + 1])):
            return i
    return last


def arrive(w: Wiring, i: int) -> bool:
    """Signals, connections and the record at communication point i."""
    for s in range(len(w.signal_places)):
        w.bus[w.signal_places[s]] = w.signals[s, i]
    fine = exchange(w, i, w.points[i], True)
    for column in range(len(w.record)):
        w.rows[i, column] = w.bus[w.record[column]]
    w.report[RECORDED] = i + 1
    return fine


def exchange(w: Wiring, i: int, t: float, on_point: bool) -> bool:
    """Take what is new at t on every connection; a faulted one carries one sample a communication point."""
    fine = True
    last = i + 1 == len(w.points)
    for k in range(len(w.links.source)):
        giver = w.links.giver[k]
        faulty = w.links.fault[k] >= 0
        given = giver < 0 or last or i % w.period[giver] == 0
        if on_point if faulty else given:
            fine = take(w, k, i, t, given) and fine
    return fine


def take(w: Wiring, k: int, i: int, t: float, given: bool) -> bool:
    """Connection k takes its source's value at t, sample i; False if that is not finite.

    given: whether the source gave it at t, or holds it since
    """
    links = w.links
    value = float(w.bus[links.source[k]])
    fault = links.fault[k]
    if fault >= 0:
        w.faults.history[fault, i] = value
        origin = w.faults.source[fault, i]
        value = float(w.faults.addition[fault, i])
        if origin >= 0:
            value += float(w.faults.history[fault, origin])
    if links.carried[k] != HELD and given:
        if t > links.stamp[k]:
            links.interval[k] = t - links.stamp[k]
            links.slope[k] = (value - links.given[k]) / links.interval[k]
            links.stamp[k] = t
        links.given[k] = value
    links.value[k] = value
    w.bus[links.target[k]] = value
    if np.isfinite(value):
        return True
    w.report[FAILURE] = CONNECTION
    w.report[WHO] = -1
    w.report[WHICH] = k
    return False


def step(w: Wiring, i: int, t: float, end: float) -> bool:
    """From t to end, in the communication step from point i."""
    return _gauss_seidel(w, i, t, end) if w.gauss_seidel else _jacobi(w, i, t, end)


def _jacobi(w: Wiring, i: int, t: float, end: float) -> bool:
    components = len(w.instance)
    for c in range(components):
        if i % w.period[c] == 0 and not _begin(w, c, i, t, end):
            return False
    for c in range(components):
        if _is_due(w, c, i) and not _advance(w, c, end):
            return False
    return all(read(w, c) for c in range(components) if _is_due(w, c, i))


def _begin(w: Wiring, c: int, i: int, t: float, end: float) -> bool:
    """The step of component c begins at t, with the inputs of t."""
    w.begun[c] = t
    if w.period[c] > 1:
        end = float(w.points[min(i + w.period[c], len(w.points) - 1)])
    return _write(w, c, t, end - t)


def _gauss_seidel(w: Wiring, i: int, t: float, end: float) -> bool:
    whole = bool(w.whole_steps) and t == w.points[i] and end == w.points[i + 1]
    for c in range(len(w.instance)):
        if i % w.period[c] == 0:
            w.begun[c] = t
        if not _is_due(w, c, i):
            continue
        for k in range(w.links.first[c], w.links.first[c + 1]):
            giver = w.links.giver[k]
            newer = 0 <= giver < c and _is_due(w, giver, i)
            if newer and (whole or w.links.fault[k] < 0) and not take(w, k, i + 1, end, True):
                return False
        begun = w.begun[c]
        if not (_write(w, c, begun, end - begun) and _advance(w, c, end) and read(w, c)):
            return False
    return True


def _is_due(w: Wiring, c: int, i: int) -> bool:
    """Whether the step of component c ends where the communication step from point i does."""
    return (i + 1) % w.period[c] == 0 or i + 2 == len(w.points)


def _write(w: Wiring, c: int, t: float, h: float) -> bool:
    """Give component c what its inputs are over t..t + h."""
    links = w.links
    for k in range(links.first[c], links.first[c + 1]):
        if links.carried[k] == HELD:
            continue  # `take` has put it on the bus
        value, slope = float(links.value[k]), float(links.slope[k])
        reach = links.reach[k] * links.interval[k]
        if h > reach:
            slope *= reach / h
        value += slope * (t - links.stamp[k])
        if links.carried[k] == AT_THE_MIDDLE:
            value = min(max(value + slope * (0.5 * h), links.low[k]), links.high[k])
        w.slopes[links.target[k]] = slope
        w.bus[links.target[k]] = value
    calls = w.writes
    for g in range(calls.first[c], calls.first[c + 1]):
        if calls.whole[g] >= 0:
            for j in range(calls.size[g]):
                w.whole[calls.whole[g] + j] = int(w.bus[calls.place[g] + j])
        if not _call(w, calls, WRITE, c, g):
            return False
    calls = w.derivatives
    for g in range(calls.first[c], calls.first[c + 1]):
        function = _function(_derivatives_type, int(calls.function[g]))
        arguments = calls.references[g], calls.size[g], w.orders, calls.buffer[g]
        w.report[BUSY] = c + 1
        status = function(int(w.instance[c]), *map(int, arguments))
        if not _accepted(w, SLOPES, c, g, status):
            return False
    return True


def _advance(w: Wiring, c: int, end: float) -> bool:
    begun = w.begun[c]
    w.report[BUSY] = c + 1
    h = w.only_step[c] if w.only_step[c] > 0.0 else end - begun
    function = _function(_step_type, int(w.do_step[c]))
    status = function(int(w.instance[c]), begun, h, 1)
    return _accepted(w, STEP, c, 0, status)


def read(w: Wiring, c: int) -> bool:
    """Take the outputs of component c to the bus."""
    calls = w.reads
    for g in range(calls.first[c], calls.first[c + 1]):
        if not _call(w, calls, READ, c, g):
            return False
        if calls.whole[g] >= 0:
            for j in range(calls.size[g]):
                w.bus[calls.place[g] + j] = w.whole[calls.whole[g] + j]
    return True


def _accepted(w: Wiring, call: int, c: int, which: int, status: int) -> bool:
    """Whether the loop goes on after a call that returned."""
    w.report[BUSY] = 0
    w.report[CALLS] += 1
    if status == 0 and w.heard[c] == 0:
        return True
    if status <= _WARNING and w.heard[c] == 0:
        if w.warned[c] == NOTHING:
            w.warned[c] = call
            w.warned_at[c] = w.begun[c]
        return True
    w.report[FAILURE] = call
    w.report[WHO] = c
    w.report[WHICH] = which
    w.report[STATUS] = status
    return False


# Calls of FMI functions by their addresses.

_POINTER, _SIZE, _INT = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int
_exchange_type = ctypes.CFUNCTYPE(_INT, _POINTER, _POINTER, _SIZE, _POINTER)
_derivatives_type = ctypes.CFUNCTYPE(_INT, _POINTER, _POINTER, _SIZE, _POINTER, _POINTER)
_step_type = ctypes.CFUNCTYPE(_INT, _POINTER, ctypes.c_double, ctypes.c_double, _INT)


@cache
def _function(kind: Any, address: int) -> Callable[..., int]:
    return kind(address)


def _call(w: Wiring, calls: Calls, kind: int, c: int, g: int) -> bool:
    """fmi2Get... or fmi2Set... of Real, Integer or Boolean variables."""
    w.report[BUSY] = c + 1
    function = _function(_exchange_type, int(calls.function[g]))
    arguments = calls.references[g], calls.size[g], calls.buffer[g]
    status = function(int(w.instance[c]), *map(int, arguments))
    return _accepted(w, kind, c, g, status)

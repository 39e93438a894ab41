"""The arrays that the communication loop works on; they stay at their addresses for a whole run.

`loop.c` declares the same structures, member by member.
"""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from orchestration.system.faults import Pattern

Array = np.ndarray

# how an input is extrapolated between communication points
InputMode = IntEnum("InputMode", "HOLD FMU_DERIVATIVE MIDPOINT", start=0)
# the kinds of failure and, but for the first and the last, of calls
Call = IntEnum(
    "Call",
    "NO_FAILURE SET_INPUTS SET_DERIVATIVES DO_STEP GET_OUTPUTS GET_STATE SET_STATE NOT_FINITE",
    start=0,
)
# indices of Wiring.report
Report = IntEnum(
    "Report", "RECORDED FAILURE COMPONENT INDEX STATUS BUSY CALLS POSITION TERMINATED FORKED", start=0
)
# indices of Wiring.team
Team = IntEnum("Team", "IS_USED IS_OVER TICKET DONE POINT END", start=0)


class Calls(NamedTuple):
    """fmi2Get... or fmi2Set... calls, one a row; rows first[c]..first[c+1]-1 belong to component c.

    function, references, buffer: addresses; size: number of values
    bus_index: of the first value on the bus
    integer_index: of the first value in `Wiring.integers`; -1 for Real, whose buffer is on the bus itself
    """

    first: Array
    function: Array
    references: Array
    buffer: Array
    size: Array
    bus_index: Array
    integer_index: Array


class Connections(NamedTuple):
    """Connections and signals; those into component c are first[c]..first[c+1]-1.

    source, target: indices on the bus; source_component: -1 for a signal; fault: row of `Faults` or -1
    input_mode: HOLD, FMU_DERIVATIVE or MIDPOINT; minimum, maximum: of the target, for MIDPOINT
    slope_validity: length of the step, in sample intervals, from which on the slope is reduced
    factor, offset: the value of the source becomes factor * value + offset; 1 and -0.0 change no bit

    Between communication points a connection carries value + slope (t - sample_time):
    value, slope: the slope is 0 or, with extrapolation, the difference quotient of the last two samples
    sample, sample_time [s]: the last value that its source provided, without extrapolation
    sample_interval: time between the last two samples [s]
    """

    first: Array
    source: Array
    target: Array
    source_component: Array
    fault: Array
    input_mode: Array
    minimum: Array
    maximum: Array
    slope_validity: Array
    factor: Array
    offset: Array
    value: Array
    slope: Array
    sample_time: Array
    sample: Array
    sample_interval: Array


# names of the arrays that a step changes; the record and the history of faults, which only grow, are left out
CHANGING = ("bus", "slopes", "integers", "step_start", "warning")
CHANGING_OF_CONNECTIONS = ("value", "slope", "sample_time", "sample", "sample_interval")


class Faults(NamedTuple):
    """One row for each faulted connection, one column for each communication point i: the connection carries
    addition[i] + the sum of weight[i, j] history[source[i, j]] over its terms j whose source is not negative.

    terms: the number of terms, the length of the last axis of `source` and `weight`
    """

    terms: int
    source: Array
    weight: Array
    addition: Array
    history: Array

    def put(self, row: int, points: int | slice, pattern: Pattern) -> None:
        """Sets what a connection carries at these communication points; a pattern may have fewer terms."""
        terms = pattern.source.shape[-1]
        self.source[row, points, :terms] = pattern.source
        self.weight[row, points, :terms] = pattern.weight
        self.addition[row, points] = pattern.addition


class Wiring(NamedTuple):
    """All data of the communication loop.

    gauss_seidel: 1 for Gauss-Seidel, 0 for Jacobi
    independent: 1 if all FMUs are known to change nothing in this process (`fmi.description.is_independent`)
    full_steps: 1 if every step ends at a communication point; 0 with a tolerance, where a faulted connection
    carries the sample of the last communication point throughout
    points: communication points [s]
    bus: every exchanged value, as float64; slopes: of inputs, at their indices on the bus
    integers: Integer and Boolean values, and numbers of strings
    orders: address of an array of ones, for the input derivatives
    memory: all that a step changes, as one array of which the others are parts
    instances, do_step, real_status, boolean_status, get_state, set_state: addresses, one for each component;
    0 for a state that it cannot save
    periods: communication steps in one step of the component
    fixed_step_size: step size [s] of a component that cannot vary it, else 0
    step_start: start time [s] of the component's present step
    error_logged: not 0 after the component logged an error
    warning, warning_time: kind of its first call that returned a warning, and the step start then [s]
    signal_values: one row for each signal, one column for each point; signal_index: of the signals on the bus
    record_index: of the recorded values on the bus; rows: the recorded values, one row for each point
    report: RECORDED rows; the kind of FAILURE with its COMPONENT, the INDEX of its call or connection and its
    STATUS; BUSY: 1 + the component whose call is in progress, its negative while it is loaded, else 0;
    CALLS that have returned; POSITION: the present communication point; TERMINATED: 1 + the component that
    terminated the simulation, else 0; FORKED: 1 after a child that an FMU forked returned from a call; while
    several are stepped at once, BUSY is 1 more than their number
    step_status: of each component's step, where threads share the steps; team: what these threads share
    step_times: of `Storage`
    """

    gauss_seidel: int
    full_steps: int
    independent: int
    points: Array
    bus: Array
    slopes: Array
    integers: Array
    orders: int
    memory: Array
    instances: Array
    do_step: Array
    real_status: Array
    boolean_status: Array
    get_state: Array
    set_state: Array
    periods: Array
    fixed_step_size: Array
    step_start: Array
    error_logged: Array
    warning: Array
    warning_time: Array
    input_calls: Calls
    derivative_calls: Calls
    output_calls: Calls
    connections: Connections
    faults: Faults
    signal_values: Array
    signal_index: Array
    record_index: Array
    rows: Array
    report: Array
    step_status: Array
    team: Array
    step_times: Array | int


@dataclass(frozen=True)
class Storage:
    """Arrays for `Wiring`, of which another process can read `rows` and `report` during the run.

    rows: shape (communication points, recorded variables); report: shape (len(Report),)
    step_times: shape (3, components), the steps of each, their wall and CPU time [s]; 0 if not asked for
    """

    rows: Array
    report: Array
    step_times: Array | int = 0


# a saved state for each component, then a copy of `Wiring.memory`; all of eight bytes
SavedMemory = ctypes.Array[ctypes.c_int64]


class LoopFunctions(NamedTuple):
    """The functions of loop.c for one wiring, without their first argument.

    help: called by each thread that shares the steps of `run`, until that ends
    """

    run: Callable[[int, int], int]
    exchange_and_record: Callable[[int], bool]
    exchange: Callable[[int, float, bool], bool]
    step: Callable[[int, float, float], bool]
    read_outputs: Callable[[int], bool]
    save: Callable[[SavedMemory], bool]
    restore: Callable[[SavedMemory], bool]
    help: Callable[[], None] | None = None

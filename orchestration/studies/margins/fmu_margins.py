"""Delay and gain margins of any controller and plant, measured by runs of their FMUs.

A scan tries values on a grid, then the first loss is enclosed by bisection. Quietness need not be monotonic
in a delay: a value that is quiet again may lie beyond one that is not, and an interval of loss narrower than
the step of the scan may be missed. So a result is the first loss that was measured, with these steps.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import groupby
from typing import Any

import numpy as np

from fmus.fmi.variable_types import FmiValue
from orchestration.studies.margins.hold import MOVED, HoldRuns, LoopSignal, loop_inputs
from orchestration.system.faults import Effect, InterpolatedDelay, Scale


@dataclass(frozen=True)
class Metric:
    """A metric of a margin.

    value: not a number if it does not exist, infinite if nothing is lost; unit: "" where it has none
    assumption: the conditions of its validity; remark: a note on this metric alone
    """

    group: str
    name: str
    value: float
    unit: str
    assumption: str
    source: str
    remark: str = ""

    @property
    def shown(self) -> str:
        """The value in a table."""
        if math.isnan(self.value):
            return "none"
        return "not lost" if math.isinf(self.value) else f"{self.value:.4g}"

    def document(self) -> dict[str, Any]:
        """Returns the metric for JSON, which has neither infinity nor NaN: both are null."""
        return {
            **asdict(self),
            "value": self.value if math.isfinite(self.value) else None,
            "shown": self.shown,
        }


@dataclass(frozen=True)
class Grid:
    """The grid of a scan: the values of a delay [s] or of a factor that it tries, from none to the largest.

    largest: below 1 for the smallest gain; step, resolution: between values, and of the first loss; ratios of
    factors
    """

    effect: Callable[[float], Effect]
    largest: float
    step: float
    resolution: float

    @property
    def is_geometric(self) -> bool:
        """Whether values are factors."""
        return self.effect is Scale

    def values(self) -> list[float]:
        """Returns the values in their order; the first changes nothing."""
        if not self.is_geometric:
            return (self.step * np.arange(round(self.largest / self.step) + 1)).tolist()
        count = math.ceil(abs(math.log(self.largest)) / math.log(self.step) - 1e-9)
        return np.geomspace(1.0, self.largest, count + 1).tolist()

    def is_apart(self, quiet: float, lost: float) -> bool:
        """Whether two values differ by more than the resolution."""
        apart = max(lost / quiet, quiet / lost) if self.is_geometric else lost - quiet
        return apart > self.resolution

    def middle(self, quiet: float, lost: float) -> float:
        """Returns the value between two others."""
        return math.sqrt(quiet * lost) if self.is_geometric else 0.5 * (quiet + lost)


DELAYS = Grid(InterpolatedDelay, largest=0.6, step=0.02, resolution=1e-3)
GAINS = Grid(Scale, largest=10.0, step=1.1, resolution=1.01)


@dataclass(frozen=True)
class Scan:
    """A scan of the values of a grid, and its measurements.

    margin: the last quiet value before the first loss; not a number if the unchanged scenario is not quiet
    lost: the first value that is not quiet; infinite if all are; at most the resolution beyond the margin
    quiet_again: intervals beyond it, from the first to the last quiet value on the grid
    runs: how many it took
    """

    margin: float
    lost: float
    quiet_again: tuple[tuple[float, float], ...]
    runs: int


def scan(
    runs: HoldRuns,
    loop_signal: LoopSignal,
    grid: Grid = DELAYS,
    *,
    parameters: Mapping[str, FmiValue] = {},
    only_first_loss: bool = False,
    progress: Callable[[], object] = lambda: None,
) -> Scan:
    """Measures up to which delay of, or factor on, a signal of the loop the scenario holds quietly.

    A delay is interpolated on straight lines between communication points. The delays of the loop itself, of
    sampling, of communication and of the scenario's own faults, come in addition.

    only_first_loss: end the scan there; `quiet_again` is then empty
    Raises ScenarioError for a scenario without a loop.
    """
    inputs, before = loop_inputs(runs.prepared, runs.hold.signal, loop_signal), runs.count

    def is_quiet(value: float) -> bool:
        progress()
        return runs.is_quiet(inputs, grid.effect(value), parameters)

    margin, lost, quiet_again = search(is_quiet, grid, only_first_loss)
    return Scan(margin, lost, quiet_again, runs.count - before)


def search(
    is_quiet: Callable[[float], bool], grid: Grid, only_first_loss: bool = False
) -> tuple[float, float, tuple[tuple[float, float], ...]]:
    """Returns margin, loss and later quiet intervals, as `Scan` has them, of a function of the value."""
    values, quiet = grid.values(), list[bool]()
    for value in values:
        quiet.append(is_quiet(value))
        if only_first_loss and not quiet[-1]:
            break
    margin, lost = _first_loss(is_quiet, grid, values, quiet)
    again = _intervals(values, quiet) if not math.isnan(margin) else ()
    return margin, lost, again[1:]


def _first_loss(
    is_quiet: Callable[[float], bool], grid: Grid, values: Sequence[float], quiet: Sequence[bool]
) -> tuple[float, float]:
    """Returns the last quiet value before the first that is not, and that one; nan or inf without one."""
    if not quiet[0]:
        return math.nan, values[0]
    if all(quiet):
        return values[-1], math.inf
    first = quiet.index(False)
    margin, lost = values[first - 1], values[first]
    while grid.is_apart(margin, lost):
        middle = grid.middle(margin, lost)
        margin, lost = (middle, lost) if is_quiet(middle) else (margin, middle)
    return margin, lost


def _intervals(values: Sequence[float], quiet: Sequence[bool]) -> tuple[tuple[float, float], ...]:
    """Returns the first and last of each row of quiet values."""
    groups = groupby(zip(quiet, values, strict=False), key=lambda pair: pair[0])
    rows = [[value for _, value in group] for is_quiet, group in groups if is_quiet]
    return tuple((row[0], row[-1]) for row in rows)


THROUGH_FMUS = "through the FMUs"
ADAPTATION_GAINS = (10.0, 100.0, 1e3, 1e4, 1e5)
_GRADUAL = (
    f"delays interpolated, in steps of {1e3 * DELAYS.step:g} ms, "
    f"the loss within {1e3 * DELAYS.resolution:g} ms"
)
_RATIOS = (
    f"factors in steps of {100 * (GAINS.step - 1):.3g} %, "
    f"the loss within {100 * (GAINS.resolution - 1):.3g} %"
)


def runs_needed(over: Mapping[str, Sequence[float]]) -> int:
    """Returns about how many runs the metrics take."""
    return 2 * 36 + 2 * 30 + 2 * 15 * (sum(map(len, over.values())) or len(ADAPTATION_GAINS))


def run_metrics(runs: HoldRuns, progress: Callable[[], object]) -> Iterator[Metric]:
    """Measures the delay margins on control and measurement, and the gain margins."""
    for loop_signal in LoopSignal:
        measured = scan(runs, loop_signal, progress=progress)
        how = f"{_GRADUAL}, up to {DELAYS.largest:g} s"
        yield _metric(f"delay margin, {loop_signal}", measured, "s", how, runs)
    for name, largest in (("largest", GAINS.largest), ("smallest", 1.0 / GAINS.largest)):
        measured = scan(runs, LoopSignal.CONTROL, replace(GAINS, largest=largest), progress=progress)
        yield _metric(f"{name} gain, control", measured, "1", f"{_RATIOS}, up to {largest:g}", runs)


def parameter_metrics(
    runs: HoldRuns, parameter: str, values: Sequence[float], progress: Callable[[], object]
) -> Iterator[Metric]:
    """Measures the delay margins on control and measurement at several values of a parameter."""
    for value in values:
        for loop_signal in LoopSignal:
            measured = scan(
                runs, loop_signal, parameters={parameter: value}, only_first_loss=True, progress=progress
            )
            name = f"delay margin, {loop_signal}, {parameter} = {value:g}"
            yield _metric(name, measured, "s", f"{_GRADUAL}; the first loss alone", runs)


def _metric(name: str, measured: Scan, unit: str, how: str, runs: HoldRuns) -> Metric:
    hold, signal_unit = runs.hold, runs.prepared.system.ports[runs.hold.signal].variable.unit or ""
    remark = ", ".join(f"quiet again at {low:.4g}..{high:.4g} {unit}" for low, high in measured.quiet_again)
    if math.isnan(measured.margin):
        remark = (
            f"not quiet without a change; the scenario as it is: standard deviation {runs.deviation:.3g}, "
            f"limit {hold.quiet:g} {signal_unit}".rstrip()
        )
    assumption = (
        f"quiet: standard deviation of {hold.signal} below {hold.quiet:g} {signal_unit} from "
        f"{hold.start:g} s to {hold.end:g} s, mean within {MOVED:g} {signal_unit} of that without a change; "
        f"{how}"
    )
    return Metric(THROUGH_FMUS, name, measured.margin, unit, assumption, "measured", remark)

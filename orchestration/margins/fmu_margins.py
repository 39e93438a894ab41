"""Delay and gain margins of any controller and plant, measured by runs of their FMUs.

A scan tries values on a grid, then the first loss is enclosed by bisection. Quietness need not be monotonic
in a delay: a value that is quiet again may lie beyond one that is not, and an interval of loss narrower than
the step of the scan may be missed. So a result is the first loss that was measured, with these steps.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from fmus.fmi.variable_types import FmiValue
from orchestration.margins.hold import MOVED, Hold, HoldRuns, LoopSignal, loop_inputs
from orchestration.margins.margin_metric import Metric
from orchestration.scenarios.scenario import Scenario
from orchestration.system.faults import Effect, InterpolatedDelay, Scale

LARGEST_DELAY, DELAY_STEP, DELAY_RESOLUTION = 0.6, 0.02, 1e-3  # s
LARGEST_GAIN, GAIN_STEP, GAIN_RESOLUTION = 10.0, 1.1, 1.01  # factors


@dataclass(frozen=True)
class Scan:
    """A scan of values, in s or as factors, and what it measured.

    margin: the last quiet value before the first loss; not a number if the scenario is not quiet as it is
    lost: the first value that is not quiet; infinite if all are; at most `resolution` beyond the margin
    quiet_again: intervals beyond it, from the first to the last quiet value on the grid
    largest, step, resolution: what was scanned, and how finely; runs: how many it took
    """

    margin: float
    lost: float
    quiet_again: tuple[tuple[float, float], ...]
    largest: float
    step: float
    resolution: float
    runs: int


def delay_margin(
    chosen: Scenario | HoldRuns,
    loop_signal: LoopSignal = LoopSignal.MEASUREMENT,
    *,
    hold: Hold | None = None,
    largest: float = LARGEST_DELAY,
    step: float = DELAY_STEP,
    resolution: float = DELAY_RESOLUTION,
    parameters: Mapping[str, FmiValue] = {},
    only_first_loss: bool = False,
    progress: Callable[[], object] = lambda: None,
) -> Scan:
    """Measures how long [s] the control, or every measurement, may be late while the scenario holds quietly.

    Delays are interpolated on straight lines between communication points. The delays of the loop itself, of
    sampling, of communication and of the scenario's own faults, are there besides.

    chosen: a scenario, or its runs, whose FMUs are loaded already
    hold: what is judged, and when; by default `hold_of(scenario)`
    only_first_loss: end the scan there; `quiet_again` is then empty
    Raises ScenarioError for a scenario without a hold or a loop, SimulationError if it fails as it is.
    """
    grid = step * np.arange(round(largest / step) + 1)
    return _scan(
        chosen,
        loop_signal,
        hold,
        InterpolatedDelay,
        grid,
        step,
        resolution,
        parameters,
        only_first_loss,
        progress,
    )


def gain_margin(
    chosen: Scenario | HoldRuns,
    loop_signal: LoopSignal = LoopSignal.CONTROL,
    *,
    hold: Hold | None = None,
    largest: float = LARGEST_GAIN,
    step: float = GAIN_STEP,
    resolution: float = GAIN_RESOLUTION,
    parameters: Mapping[str, FmiValue] = {},
    only_first_loss: bool = False,
    progress: Callable[[], object] = lambda: None,
) -> Scan:
    """Measures the largest factor on the control, or every measurement, at which the scenario holds quietly.

    largest below 1 asks for the other margin. The grid is geometric: `step` and `resolution` are ratios.
    """
    count = math.ceil(abs(math.log(largest)) / math.log(step) - 1e-9)
    grid = np.geomspace(1.0, largest, count + 1)
    return _scan(
        chosen, loop_signal, hold, Scale, grid, step, resolution, parameters, only_first_loss, progress
    )


def _scan(
    chosen: Scenario | HoldRuns,
    loop_signal: LoopSignal,
    hold: Hold | None,
    effect: Callable[[float], Effect],
    grid: np.ndarray,
    step: float,
    resolution: float,
    parameters: Mapping[str, FmiValue],
    only_first_loss: bool,
    progress: Callable[[], object],
) -> Scan:
    with ExitStack() as stack:
        runs = stack.enter_context(HoldRuns(chosen, hold)) if isinstance(chosen, Scenario) else chosen
        inputs, before = loop_inputs(runs.prepared, runs.hold.signal, loop_signal), runs.count

        def is_quiet(value: float) -> bool:
            progress()
            return runs.is_quiet(inputs, effect(value), parameters)

        values, quiet = grid.tolist(), list[bool]()
        for value in values:
            quiet.append(is_quiet(value))
            if only_first_loss and not quiet[-1]:
                break
        margin, lost = _first_loss(is_quiet, values, quiet, resolution, is_ratio=effect is Scale)
        again = _intervals(values, quiet) if not math.isnan(margin) else ()
        return Scan(margin, lost, again[1:], values[-1], step, resolution, runs.count - before)


def _first_loss(
    is_quiet: Callable[[float], bool],
    values: list[float],
    quiet: list[bool],
    resolution: float,
    is_ratio: bool,
) -> tuple[float, float]:
    """Returns the last quiet value before the first that is not, and that one; nan or inf without one."""
    if not quiet[0]:
        return math.nan, values[0]
    if all(quiet):
        return values[-1], math.inf
    first = quiet.index(False)
    return _enclosed(is_quiet, values[first - 1], values[first], resolution, is_ratio)


def _enclosed(
    is_quiet: Callable[[float], bool], quiet: float, lost: float, resolution: float, is_ratio: bool
) -> tuple[float, float]:
    """Returns a quiet value and one that is not, at most `resolution` apart, between the two."""

    def is_apart() -> bool:
        return max(lost / quiet, quiet / lost) > resolution if is_ratio else lost - quiet > resolution

    while is_apart():
        middle = math.sqrt(quiet * lost) if is_ratio else 0.5 * (quiet + lost)
        quiet, lost = (middle, lost) if is_quiet(middle) else (quiet, middle)
    return quiet, lost


def _intervals(values: Sequence[float], quiet: Sequence[bool]) -> tuple[tuple[float, float], ...]:
    """Returns the first and last of each row of quiet values."""
    groups = groupby(zip(quiet, values, strict=False), key=lambda pair: pair[0])
    rows = [[value for _, value in group] for is_quiet, group in groups if is_quiet]
    return tuple((row[0], row[-1]) for row in rows)


THROUGH_FMUS = "through the FMUs"
ADAPTATION_GAINS = (10.0, 100.0, 1e3, 1e4, 1e5)
_GRADUAL = (
    f"delays interpolated, in steps of {1e3 * DELAY_STEP:g} ms, the loss within {1e3 * DELAY_RESOLUTION:g} ms"
)
_RATIOS = (
    f"factors in steps of {100 * (GAIN_STEP - 1):.3g} %, the loss within {100 * (GAIN_RESOLUTION - 1):.3g} %"
)


def runs_needed(over: Mapping[str, Sequence[float]]) -> int:
    """Returns about how many runs the metrics take."""
    return 2 * 36 + 2 * 30 + 2 * 15 * (sum(map(len, over.values())) or len(ADAPTATION_GAINS))


def run_metrics(runs: HoldRuns, progress: Callable[[], object]) -> Iterator[Metric]:
    """Measures the delay margins on control and measurement, and the gain margins."""
    for loop_signal in LoopSignal:
        scan = delay_margin(runs, loop_signal, progress=progress)
        yield _metric(
            f"delay margin, {loop_signal}", scan, "s", f"{_GRADUAL}, up to {LARGEST_DELAY:g} s", runs
        )
    for name, largest in (("largest", LARGEST_GAIN), ("smallest", 1.0 / LARGEST_GAIN)):
        scan = gain_margin(runs, largest=largest, progress=progress)
        yield _metric(f"{name} gain, control", scan, "1", f"{_RATIOS}, up to {largest:g}", runs)


def parameter_metrics(
    runs: HoldRuns, parameter: str, values: Sequence[float], progress: Callable[[], object]
) -> Iterator[Metric]:
    """Measures the delay margins on control and measurement at several values of a parameter."""
    for value in values:
        changed: Mapping[str, FmiValue] = {parameter: value}
        for loop_signal in LoopSignal:
            scan = delay_margin(
                runs, loop_signal, parameters=changed, only_first_loss=True, progress=progress
            )
            name = f"delay margin, {loop_signal}, {parameter} = {value:g}"
            yield _metric(name, scan, "s", f"{_GRADUAL}; the first loss alone", runs)


def _metric(name: str, scan: Scan, unit: str, how: str, runs: HoldRuns) -> Metric:
    hold, signal_unit = runs.hold, runs.prepared.system.ports[runs.hold.signal].variable.unit or ""
    again = ", ".join(f"quiet again at {low:.4g}..{high:.4g} {unit}" for low, high in scan.quiet_again)
    assumption = (
        f"quiet: standard deviation of {hold.signal} below {hold.quiet:g} {signal_unit} from "
        f"{hold.start:g} s to {hold.end:g} s, mean within {MOVED:g} {signal_unit} of that without a change; "
        f"{how}"
    )
    return Metric(THROUGH_FMUS, name, scan.margin, unit, assumption, "measured", again)

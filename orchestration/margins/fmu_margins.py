"""Delay and gain margins of any controller and plant, measured by runs of their FMUs.

A scan tries values on a grid, then the first loss is enclosed by bisection. Quietness need not be monotonic
in a delay: a value that is quiet again may lie beyond one that is not, and an interval of loss narrower than
the step of the scan may be missed. So a result is the first loss that was measured, with these steps.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from fmus.fmi.variable_types import FmiValue
from orchestration.margins.hold import Hold, HoldRuns, LoopSignal, loop_inputs
from orchestration.scenarios.scenario import Scenario
from orchestration.system.faults import Effect, InterpolatedDelay, Scale

LARGEST_DELAY, DELAY_STEP, DELAY_RESOLUTION = 0.6, 0.02, 1e-3  # s
LARGEST_GAIN, GAIN_STEP, GAIN_RESOLUTION = 10.0, 1.1, 1.01  # factors


@dataclass(frozen=True)
class Scan:
    """What a scan found, in s or as factors.

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
    """How long [s] the control, or every measurement, may be late while the scenario holds quietly.

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
    """By how much the control, or every measurement, may be multiplied while the scenario holds quietly.

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
    """The last quiet value before the first that is not, and that one; nan or inf where there is none."""
    if not quiet[0]:
        return math.nan, values[0]
    if all(quiet):
        return values[-1], math.inf
    first = quiet.index(False)
    return _enclosed(is_quiet, values[first - 1], values[first], resolution, is_ratio)


def _enclosed(
    is_quiet: Callable[[float], bool], quiet: float, lost: float, resolution: float, is_ratio: bool
) -> tuple[float, float]:
    """A quiet value and one that is not, at most `resolution` apart, between the two."""

    def is_apart() -> bool:
        return max(lost / quiet, quiet / lost) > resolution if is_ratio else lost - quiet > resolution

    while is_apart():
        middle = math.sqrt(quiet * lost) if is_ratio else 0.5 * (quiet + lost)
        quiet, lost = (middle, lost) if is_quiet(middle) else (quiet, middle)
    return quiet, lost


def _intervals(values: Sequence[float], quiet: Sequence[bool]) -> tuple[tuple[float, float], ...]:
    """First and last of each row of quiet values."""
    groups = groupby(zip(quiet, values, strict=False), key=lambda pair: pair[0])
    rows = [[value for _, value in group] for is_quiet, group in groups if is_quiet]
    return tuple((row[0], row[-1]) for row in rows)

"""The figures that are measured by runs of the FMUs, whatever is inside them."""

from collections.abc import Callable, Iterator, Mapping, Sequence

from fmus.fmi.variable_types import FmiValue
from orchestration.margins.fmu_margins import (
    DELAY_RESOLUTION,
    DELAY_STEP,
    GAIN_RESOLUTION,
    GAIN_STEP,
    LARGEST_DELAY,
    LARGEST_GAIN,
    Scan,
    delay_margin,
    gain_margin,
)
from orchestration.margins.hold import MOVED, HoldRuns, LoopSignal
from orchestration.margins.margin_figure import Figure

THROUGH_FMUS = "through the FMUs"
ADAPTATION_GAINS = (10.0, 100.0, 1e3, 1e4, 1e5)
_GRADUAL = (
    f"delays interpolated, in steps of {1e3 * DELAY_STEP:g} ms, the loss within {1e3 * DELAY_RESOLUTION:g} ms"
)
_RATIOS = (
    f"factors in steps of {100 * (GAIN_STEP - 1):.3g} %, the loss within {100 * (GAIN_RESOLUTION - 1):.3g} %"
)


def runs_needed(over: Mapping[str, Sequence[float]]) -> int:
    """How many runs the figures take, about."""
    return 2 * 36 + 2 * 30 + 2 * 15 * (sum(map(len, over.values())) or len(ADAPTATION_GAINS))


def run_figures(runs: HoldRuns, progress: Callable[[], object]) -> Iterator[Figure]:
    """Delay margins on control and measurement, and gain margins."""
    for loop_signal in LoopSignal:
        scan = delay_margin(runs, loop_signal, progress=progress)
        yield _figure(
            f"delay margin, {loop_signal}", scan, "s", f"{_GRADUAL}, up to {LARGEST_DELAY:g} s", runs
        )
    for name, largest in (("largest", LARGEST_GAIN), ("smallest", 1.0 / LARGEST_GAIN)):
        scan = gain_margin(runs, largest=largest, progress=progress)
        yield _figure(f"{name} gain, control", scan, "1", f"{_RATIOS}, up to {largest:g}", runs)


def parameter_figures(
    runs: HoldRuns, parameter: str, values: Sequence[float], progress: Callable[[], object]
) -> Iterator[Figure]:
    """Delay margins on control and measurement at several values of a parameter."""
    for value in values:
        changed: Mapping[str, FmiValue] = {parameter: value}
        for loop_signal in LoopSignal:
            scan = delay_margin(
                runs, loop_signal, parameters=changed, only_first_loss=True, progress=progress
            )
            name = f"delay margin, {loop_signal}, {parameter} = {value:g}"
            yield _figure(name, scan, "s", f"{_GRADUAL}; the first loss alone", runs)


def _figure(name: str, scan: Scan, unit: str, how: str, runs: HoldRuns) -> Figure:
    hold, signal_unit = runs.hold, runs.prepared.system.ports[runs.hold.signal].variable.unit or ""
    again = ", ".join(f"quiet again at {low:.4g}..{high:.4g} {unit}" for low, high in scan.quiet_again)
    assumption = (
        f"quiet: standard deviation of {hold.signal} below {hold.quiet:g} {signal_unit} from "
        f"{hold.start:g} s to {hold.end:g} s, mean within {MOVED:g} {signal_unit} of that without a change; "
        f"{how}"
    )
    return Figure(THROUGH_FMUS, name, scan.margin, unit, assumption, "measured", again)

"""Margins of a scenario: from the design of its controller, and from runs of its FMUs."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from fmus.fmi.variable_types import FmiValue
from orchestration.errors import ScenarioError
from orchestration.scenarios.scenario import Scenario
from orchestration.studies.margins.certificate import certificate_metrics, without_p
from orchestration.studies.margins.code_loop import CodeLoop, code_loop
from orchestration.studies.margins.fmu_margins import ADAPTATION_GAINS, Metric, parameter_metrics, run_metrics
from orchestration.studies.margins.hold import QUIET, Hold, HoldRuns, LoopSignal, hold_of, loop_inputs
from orchestration.studies.margins.l1_design import Design, design_of
from orchestration.studies.margins.l1_loop import loop
from orchestration.studies.margins.linear_margins import LinearLoop
from orchestration.studies.margins.theory_metrics import (
    code_metrics,
    design_metrics,
    linear_loops,
    step_metrics,
)
from orchestration.system.signals import values_at

FOREIGN = (
    "The L1-norm condition and the linear margins are not judged: they follow from the equations of a law, "
    "and an FMU shows its inputs and outputs alone. The equations of L1DepthController and L1Controller are "
    "known, on ExamplePlant and on vehicles whose description names their inertia: expected it in "
    "NAME.vehicle.toml beside the vehicle, as RovDepthPlant has it."
)
NO_CODE = (
    "The linear loop of the code is not judged: expected installed blocks alone, a hold at whose end the "
    "derivatives repeat, Jacobi's algorithm, and no events, faults, extrapolated inputs or components with "
    "steps of their own."
)
NO_CERTIFICATE = "There is no certificate: expected an L1 controller in a loop whose code is judged."


@dataclass(frozen=True)
class Margins:
    """The margins of one scenario; not_judged: sentences on missing margins, and why.

    linear: the name of the linear loop that leaves out least, and the loop; None if none is known
    """

    scenario: str
    metrics: tuple[Metric, ...]
    not_judged: tuple[str, ...]
    linear: tuple[str, LinearLoop] | None = None

    def document(self) -> dict[str, Any]:
        """Returns the margins for JSON."""
        metrics = [metric.document() for metric in self.metrics]
        return {"scenario": self.scenario, "metrics": metrics, "not_judged": list(self.not_judged)}


def judge(
    chosen: Scenario,
    hold: Hold | None = None,
    *,
    quiet: float = QUIET,
    over: Mapping[str, Sequence[float]] = {},
    measured: bool = True,
    certificate: bool = False,
    progress: Callable[[], object] = lambda: None,
) -> Margins:
    """Judges all margins of a scenario.

    hold: where it is judged through the FMUs; by default `hold_of`, with this largest deviation `quiet`
    over: parameter -> values, at each of which the delay margins are measured; by default the adaptation gain
    of an L1 controller
    measured: whether the metrics that take many runs are among them
    certificate: whether the sectors of the extension that are proved are, too
    """
    not_judged, runs = list[str](), None
    try:
        runs = HoldRuns(chosen, hold or hold_of(chosen, quiet))
    except ScenarioError as error:
        not_judged.append(f"Margins through the FMUs are not judged: {error}.")
    with runs or nullcontext():
        if runs:
            for name in over:
                runs.prepared.system.port(name, "--over")
        design = _design(chosen, runs)
        if not design:
            not_judged.append(FOREIGN)
        metrics = [*design_metrics(design, ADAPTATION_GAINS)] if design else []
        made = _loop_of_code(chosen, runs)
        metrics += code_metrics(made) if made else []
        not_judged += [] if made else [NO_CODE]
        if certificate:
            made = design and _loop_of_code(chosen, runs, without_p(design))
            not_judged += [] if made else [NO_CERTIFICATE]
            if design and runs and made:
                holds = partial(_holds, runs, design) if measured else None
                metrics += certificate_metrics(made, design, holds)
        if runs and measured:
            metrics += run_metrics(runs, progress)
            if design and design.has_gain and not over:
                over = {f"{design.controller}.adaptation_gain": ADAPTATION_GAINS}
            for parameter, values in over.items():
                metrics += parameter_metrics(runs, parameter, values, progress)
        if design and measured and math.isfinite(design.adaptation_gain):
            metrics += step_metrics(chosen, progress)
    linear = None
    if design:
        name, (law, plant, _) = list(linear_loops(design).items())[-1]
        linear = name, loop(law, plant)
    return Margins(chosen.name, tuple(metrics), tuple(not_judged), linear)


def _loop_of_code(
    chosen: Scenario, runs: HoldRuns | None, instead: Mapping[str, FmiValue] = {}
) -> CodeLoop | None:
    """Returns the loop of the code about the hold, cut at the control, with other values of parameters."""
    if runs is None:
        return None
    cut = loop_inputs(runs.prepared, runs.hold.signal, LoopSignal.CONTROL)
    return code_loop(chosen, runs.hold.end, cut, instead)


def _holds(runs: HoldRuns, design: Design, gain: float) -> bool:
    """Whether runs with a linear P of this gain, beside the integral of the PI, hold quietly."""
    return runs.is_quiet(parameters=without_p(design) | {f"{design.controller}.proportional_gain": gain})


def _design(chosen: Scenario, runs: HoldRuns | None) -> Design | None:
    times = chosen.experiment.time_grid()
    signals = [values_at(signal, times) for signal in chosen.experiment.signals.values()]
    largest = max((float(np.abs(values).max()) for values in signals), default=0.0)
    return design_of(chosen, largest, runs.mean if runs else math.nan)

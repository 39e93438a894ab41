"""Margins of a scenario: what follows from the design of its controller, and what its FMUs show."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np

from orchestration.errors import ScenarioError
from orchestration.margins.fmu_margins import ADAPTATION_GAINS, parameter_figures, run_figures
from orchestration.margins.hold import QUIET, Hold, HoldRuns, hold_of
from orchestration.margins.l1_design import Design, design_of
from orchestration.margins.margin_figure import Figure
from orchestration.margins.theory_figures import (
    bound_figure,
    gamma_figures,
    linear_figures,
    norm_figures,
    step_figures,
)
from orchestration.scenarios.scenario import Scenario
from orchestration.system.prepared_run import prepare
from orchestration.system.signals import values_at

FOREIGN = (
    "The L1-norm condition and the linear margins are not judged: they follow from the equations of a law, "
    "and an FMU shows its inputs and outputs alone. The equations of L1DepthController and L1Controller are "
    "known, on RovDepthPlant and ExamplePlant."
)


@dataclass(frozen=True)
class Margins:
    """The margins of one scenario; not_judged: sentences that say what is missing, and why."""

    scenario: str
    figures: tuple[Figure, ...]
    not_judged: tuple[str, ...]

    def document(self) -> dict[str, Any]:
        """Returns the margins for JSON."""
        figures = [figure.document() for figure in self.figures]
        return {"scenario": self.scenario, "figures": figures, "not_judged": list(self.not_judged)}


def judge(
    chosen: Scenario,
    hold: Hold | None = None,
    *,
    quiet: float = QUIET,
    over: Mapping[str, Sequence[float]] = {},
    measured: bool = True,
    progress: Callable[[], object] = lambda: None,
) -> Margins:
    """Judges all margins of a scenario.

    hold: where it is judged through the FMUs; by default `hold_of`, with this largest deviation `quiet`
    over: parameter -> values, at each of which the delay margins are measured; by default the adaptation gain
    of an L1 controller
    measured: whether the figures that take many runs are among them
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
        figures = [*_theory(design)] if design else []
        if runs and measured:
            figures += run_figures(runs, progress)
            for parameter, values in (over or _adaptation_gains(design)).items():
                figures += parameter_figures(runs, parameter, values, progress)
        if design and measured and math.isfinite(design.adaptation_gain):
            figures += step_figures(chosen, progress)
    return Margins(chosen.name, tuple(figures), tuple(not_judged))


def _theory(design: Design) -> Iterator[Figure]:
    has_gain = 0.0 < design.adaptation_gain < math.inf
    yield from norm_figures(design)
    yield from linear_figures(design)
    if has_gain and design.has_rest:
        yield from gamma_figures(design, ADAPTATION_GAINS)
    if has_gain:
        yield from bound_figure(design)


def _adaptation_gains(design: Design | None) -> dict[str, Sequence[float]]:
    has_gain = design is not None and 0.0 < design.adaptation_gain < math.inf
    return {f"{design.controller}.adaptation_gain": ADAPTATION_GAINS} if design and has_gain else {}


def _design(chosen: Scenario, runs: HoldRuns | None) -> Design | None:
    prepared = prepare(chosen.system, chosen.experiment)
    times = chosen.experiment.time_grid()
    signals = [values_at(signal, times) for signal in chosen.experiment.signals.values()]
    largest = max((float(np.abs(values).max()) for values in signals), default=0.0)
    return design_of(prepared, largest, runs.mean if runs else math.nan)

"""Margins of a scenario: what follows from the design of its controller, and what its FMUs show."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from orchestration.errors import ScenarioError
from orchestration.scenarios.scenario import Scenario
from orchestration.study.hold import QUIET, Hold, HoldRuns, hold_of
from orchestration.study.l1_design import Design, design_of
from orchestration.study.margin_figure import Figure
from orchestration.study.run_figures import parameter_figures, run_figures
from orchestration.study.theory_figures import linear_figures, norm_figures
from orchestration.system.prepared_run import prepare
from orchestration.system.signals import values_at

FOREIGN = (
    "The L1-norm condition and the linear margins are not judged: they follow from the equations of a law, "
    "and an FMU shows its inputs and outputs alone. The equations of L1DepthController and L1Controller are "
    "known, on RovDepthPlant and ExamplePlant."
)


@dataclass(frozen=True)
class Margins:
    """Of one scenario; not_judged: sentences that say what is missing, and why."""

    scenario: str
    figures: tuple[Figure, ...]
    not_judged: tuple[str, ...]

    def document(self) -> dict[str, Any]:
        """As JSON has it."""
        figures = [figure.document() for figure in self.figures]
        return {"scenario": self.scenario, "figures": figures, "not_judged": list(self.not_judged)}


def judge(
    chosen: Scenario,
    hold: Hold | None = None,
    *,
    quiet: float = QUIET,
    over: Mapping[str, Sequence[float]] = {},
    progress: Callable[[], object] = lambda: None,
) -> Margins:
    """All margins of a scenario.

    hold: where it is judged through the FMUs; by default `hold_of`, with this largest deviation `quiet`
    over: parameter -> values, at each of which the delay margins are measured
    """
    figures, not_judged = list[Figure](), list[str]()
    runs = None
    try:
        runs = HoldRuns(chosen, hold or hold_of(chosen, quiet))
    except ScenarioError as error:
        not_judged.append(f"Margins through the FMUs are not judged: {error}.")
    design = _design(chosen, runs)
    if design:
        figures += [*norm_figures(design), *linear_figures(design)]
    else:
        not_judged.append(FOREIGN)
    if runs:
        with runs:
            figures += run_figures(runs, progress)
            for parameter, values in over.items():
                figures += parameter_figures(runs, parameter, values, progress)
    return Margins(chosen.name, tuple(figures), tuple(not_judged))


def _design(chosen: Scenario, runs: HoldRuns | None) -> Design | None:
    prepared = prepare(chosen.system, chosen.experiment)
    times = chosen.experiment.time_grid()
    signals = [values_at(signal, times) for signal in chosen.experiment.signals.values()]
    largest = max((float(np.abs(values).max()) for values in signals), default=0.0)
    return design_of(prepared, largest, runs.mean if runs else math.nan)

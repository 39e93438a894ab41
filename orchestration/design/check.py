"""A design checked by runs: every corner of the ranges, draws within them, and the start values."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from fmus.fmi.variable_types import FmiValue
from orchestration.design.rules import Gain
from orchestration.many.job import Failure
from orchestration.many.run_many import run_many
from orchestration.results.metrics import evaluate
from orchestration.results.recording import Recording
from orchestration.scenarios.changes import with_values
from orchestration.scenarios.scenario import Scenario

RMSE, SETTLING = "rmse", "settling_time"
Values = Mapping[str, FmiValue]


@dataclass(frozen=True)
class DesignCheck:
    """Results of the runs of a controller.

    values: of each run; the first has none, the start values
    rmse: of each run [cm], not a number if it failed; settling: its settling time [s], not a number if none
    """

    title: str
    values: Sequence[Values]
    rmse: Sequence[float]
    settling: Sequence[float]
    reasons: Mapping[int, str]

    @property
    def worst(self) -> int:
        """The index of the run that failed, or has the largest RMSE."""
        return max(range(len(self.rmse)), key=lambda i: (i in self.failed, _size(self.rmse[i])))

    @property
    def longest_settling(self) -> float:
        """The longest settling time [s], not a number if a run does not settle."""
        return max(self.settling, key=_size)

    @property
    def failed(self) -> list[int]:
        """The indices of the runs that did not settle, or failed."""
        return [i for i, time in enumerate(self.settling) if math.isnan(time)]

    def values_text(self, index: int) -> str:
        """Returns the values of a run in words."""
        values = self.values[index].items()
        return ", ".join(f"{name} = {value:.4g}" for name, value in values) or "the start values"

    def failures(self) -> list[str]:
        """Returns a sentence for each run that did not settle."""
        return [
            f"{self.title}: {self.reasons.get(i, 'does not settle')} at {self.values_text(i)}"
            for i in self.failed
        ]


def _size(number: float) -> float:
    return math.inf if math.isnan(number) else number


def check(
    title: str,
    scenario: Scenario,
    gains: Sequence[Gain],
    values: Sequence[Values],
    progress: Callable[[], object] = lambda: None,
) -> DesignCheck:
    """Runs a scenario with the gains of a design at the start values and at others."""
    own = {f"controller.{gain.name}": gain.value for gain in gains}
    values = [{}, *values]
    experiments = [with_values(scenario.experiment, {**own, **of_run}) for of_run in values]
    metrics = {name: scenario.metrics[name] for name in (RMSE, SETTLING)}
    rows, reasons = list[Mapping[str, float]](), dict[int, str]()
    for i, result in enumerate(run_many(scenario.system, experiments, reduce=partial(_reduced, metrics))):
        if isinstance(result, Failure):
            reasons[i] = result.reason
        rows.append({} if isinstance(result, Failure) else result)
        progress()
    columns = ([row.get(name, math.nan) for row in rows] for name in (RMSE, SETTLING))
    rmse, settling = columns
    return DesignCheck(title, values, rmse, settling, reasons)


def _reduced(metrics: Mapping[str, Mapping[str, Any]], runs: Recording) -> list[dict[str, float]]:
    """Returns the metrics of each run; one that was terminated has none."""
    rows = (runs.run(i) for i in range(len(runs.values)))
    return [{} if "terminated" in run.provenance else evaluate(run, metrics) for run in rows]

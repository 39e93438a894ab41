"""Samples as instances of an ensemble, which step together in this process."""

from collections.abc import Sequence
from contextlib import AbstractContextManager

from fmus.fmi_types import FmiValue
from fmus.lanes import LANES
from orchestration.errors import EnsembleError, OrchestrationError
from orchestration.master.ensemble import Ensemble
from orchestration.master.ensemble_choice import check_ensemble
from orchestration.results.metrics_of_all import evaluate_all
from orchestration.sweep.plan import Plan
from orchestration.sweep.samples import Job, Outcome, Samples

_BATCH_BYTES = 2**24  # of recorded values, if a group has less


class EnsembleSamples(AbstractContextManager["EnsembleSamples"]):
    """Runs several samples at once; their rows are those of `Samples`.

    most: samples that are to run at once, a multiple of a group
    """

    def __init__(self, plan: Plan, job: Job, most: int) -> None:
        self._plan, self._job, self.most = plan, job, most
        self._ensemble, self._alone = Ensemble(job.system), Samples(job)

    def run(self, values: Sequence[dict[str, FmiValue]]) -> list[Outcome]:
        """The outcomes of samples; values: what is varied in each.

        A sample that fails is run alone, by a simulator that may try shorter steps; so is one of which a
        metric fails, whose row has the error of `Samples`.
        """
        vary = {name: [sample[name] for sample in values] for name in values[0]}
        rows: dict[int, dict[str, float] | None] = {}
        try:
            recorded = self._ensemble.run(self._job.experiment, vary)
        except OrchestrationError:  # of values that no instance can have
            pass
        else:
            if recorded.complete:
                metrics = evaluate_all(recorded.recordings(), self._job.metrics)
                rows = dict(zip(recorded.complete, metrics, strict=True))
        return [
            self._alone.run(self._plan.settings(sample)) if (row := rows.get(i)) is None else Outcome(row)
            for i, sample in enumerate(values)
        ]

    def close(self) -> None:
        """End a sample that runs alone."""
        self._alone.close()

    def __exit__(self, *error: object) -> None:
        self._ensemble.__exit__(*error)
        self._alone.__exit__(*error)


def ensemble_samples(
    plan: Plan, job: Job, count: int, is_asked_for: bool, threads: int
) -> list[EnsembleSamples]:
    """What runs so many samples of a plan in so many threads.

    is_asked_for: whether the user wants an ensemble, also where it does not pay
    Raises EnsembleError for samples that are for simulators, with the reason.
    """
    for entry in plan.varied:
        if entry.target.table not in ("parameters", "inputs") or entry.target.key.endswith(".internal_step"):
            raise EnsembleError(
                f"{entry.target.name} is varied: expected parameters but internal_step, and constant inputs"
            )
    if job.recorded is not None or job.timeout is not None:
        raise EnsembleError("samples of an ensemble have no recordings and no timeout")
    group_bytes = check_ensemble(job.system, job.experiment, count, is_asked_for, threads=threads)
    most = LANES * max(1, _BATCH_BYTES // group_bytes)
    return [EnsembleSamples(plan, job, most) for _ in range(threads)]

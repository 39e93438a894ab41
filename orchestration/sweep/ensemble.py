"""Samples as instances of an ensemble, which step together in this process."""

from collections.abc import Sequence
from contextlib import AbstractContextManager

from fmus.fmi_types import FmiValue
from fmus.lanes import LANES
from orchestration.errors import EnsembleError, OrchestrationError
from orchestration.fmi.description import describe, is_independent
from orchestration.master.ensemble import Ensemble
from orchestration.master.ensemble_checks import check_supported
from orchestration.master.initialisation import connection_groups
from orchestration.results.metrics_of_all import evaluate_all
from orchestration.sweep.plan import Plan
from orchestration.sweep.samples import Job, Outcome, Samples
from orchestration.system.prepared_run import PreparedRun, prepare
from orchestration.system.system import System

_BATCH_BYTES = 2**24  # of recorded values, if a group has less
_MOST_BYTES = 2**28  # of recorded values of a group
_STEPS_WORTH_COMPILING = (
    1e7  # each costs 0.25 us more an FMU in a Simulator; to compile an FMU takes 2 to 3 s
)


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
    _check(plan, job)
    prepared = prepare(job.system, job.experiment)
    check_supported(prepared, connection_groups(prepared.system))
    points, columns = prepared.shape
    group_bytes = 8 * LANES * points * columns
    if not is_asked_for:
        _check_pays(job.system, prepared, count, group_bytes)
    most = LANES * max(1, _BATCH_BYTES // group_bytes)
    return [EnsembleSamples(plan, job, most) for _ in range(threads)]


def _check(plan: Plan, job: Job) -> None:
    """EnsembleError for what samples of an ensemble do not have."""
    for name, path in job.system.components.items():
        if not is_independent(describe(path)):
            raise EnsembleError(f"{name} is no native FMU of l1-depth")
    for entry in plan.varied:
        if entry.target.table not in ("parameters", "inputs") or entry.target.key.endswith(".internal_step"):
            raise EnsembleError(
                f"{entry.target.name} is varied: expected parameters but internal_step, and constant inputs"
            )
    if job.recorded is not None or job.timeout is not None:
        raise EnsembleError("samples of an ensemble have no recordings and no timeout")


def _check_pays(system: System, prepared: PreparedRun, count: int, group_bytes: int) -> None:
    """EnsembleError for samples that simulators run about as fast, or in much less memory."""
    steps = count * prepared.experiment.step_count
    if count < LANES:
        raise EnsembleError(f"{count} samples are less than the {LANES} that step at once")
    if group_bytes > _MOST_BYTES:
        raise EnsembleError(f"{LANES} samples at once record {group_bytes / 1e6:.0f} MB")
    if steps < _STEPS_WORTH_COMPILING and not Ensemble.is_compiled(system):
        raise EnsembleError(f"to compile the FMUs takes longer than {steps} steps save")

"""Samples as instances of an ensemble, which step together in this process."""

import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from fmus.fmi_types import FmiValue
from fmus.lanes import LANES
from orchestration.errors import EnsembleError, OrchestrationError, SweepError
from orchestration.master.ensemble import Ensemble
from orchestration.master.ensemble_checks import check_supported
from orchestration.master.ensemble_recording import EnsembleRecording
from orchestration.master.initialisation import connection_groups
from orchestration.results import metrics
from orchestration.sweep.plan import Plan
from orchestration.sweep.samples import Job, Outcome, Samples
from orchestration.sweep.workers import Batches, Finished
from orchestration.system.prepared_run import prepare


class EnsembleWorkers:
    """Runs batches of samples as ensembles, with so many threads; the rows are those of `LocalWorkers`."""

    def __init__(self, threads: int) -> None:
        self._threads = threads

    def run(self, plan: Plan, job: Job, missing: Batches) -> Generator[Finished, None, None]:
        """The samples as they are finished; see `Workers`.

        Raises EnsembleError or SweepError for a sweep that only a `Simulator` can run.
        """
        _check(plan, job)
        with ExitStack() as stack:
            temporary = TemporaryDirectory(prefix="l1-depth-sweep-", ignore_cleanup_errors=True)
            folder = Path(stack.enter_context(temporary))
            job = job.with_packed_fmus().with_unpacked_fmus(folder)
            ensemble, alone = stack.enter_context(Ensemble(job.system)), stack.enter_context(Samples(job))
            while batch := missing.take(1, LANES * self._threads):
                start, values = time.perf_counter(), plan.block(batch)
                outcomes = self._outcomes(ensemble, alone, plan, job, values)
                missing.note(len(batch), time.perf_counter() - start)
                yield Finished(batch, values, outcomes)

    def _outcomes(
        self, ensemble: Ensemble, alone: Samples, plan: Plan, job: Job, values: Sequence[dict[str, FmiValue]]
    ) -> list[Outcome]:
        """Those of an ensemble.

        An instance that fails is run by a simulator, which may try shorter steps; so is one of which a metric
        fails, whose row has the error of `Samples`.
        """
        vary = {name: [sample[name] for sample in values] for name in values[0]}
        try:
            recorded = ensemble.run(job.experiment, vary, threads=self._threads)
        except EnsembleError:
            raise
        except OrchestrationError:  # of values that no instance can have
            return [alone.run(plan.settings(sample)) for sample in values]
        return [
            _measured(recorded, instance, job) or alone.run(plan.settings(sample))
            for instance, sample in enumerate(values)
        ]


def _measured(recorded: EnsembleRecording, instance: int, job: Job) -> Outcome | None:
    """The outcome of an instance; None if it failed, or a metric of it."""
    if instance in recorded.failures:
        return None
    try:
        return Outcome(metrics.evaluate(recorded.recording(instance), job.metrics))
    except Exception:  # whatever the reason, as in `Samples`
        return None


def _check(plan: Plan, job: Job) -> None:
    """SweepError or EnsembleError for what samples of an ensemble do not have."""
    prepared = prepare(job.system, job.experiment)
    check_supported(prepared, connection_groups(prepared.system))
    for entry in plan.varied:
        if entry.target.table not in ("parameters", "inputs"):
            raise SweepError(
                f"--ensemble: {entry.target.name} cannot be varied: expected a parameter or a constant input"
            )
    if job.recorded is not None or job.timeout is not None:
        raise SweepError("--ensemble: samples of an ensemble have no recordings and no timeout")


@contextmanager
def ensemble(threads: int) -> Iterator[EnsembleWorkers]:
    """Workers of this process, `EnsembleWorkers`."""
    yield EnsembleWorkers(threads)

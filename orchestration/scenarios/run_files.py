"""Running scenarios into a folder: one, or all of the paper side by side, and what sums them up."""

import errno
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fmus.files import lasting_folder, write_json_atomically
from fmus.fmi import parent_process
from fmus.registry import Flavour
from orchestration.errors import OrchestrationError, ScenarioWarning, SimulationError
from orchestration.many.job import Failure
from orchestration.many.run_many import run_many
from orchestration.results import files, metrics
from orchestration.results.files import reserved
from orchestration.results.formats import FigureFormat, RecordingFormat
from orchestration.results.metric_units import MetricDocument, metric_units, with_units
from orchestration.results.recording import Recording
from orchestration.run import simulate_prepared
from orchestration.scenarios import scenario
from orchestration.scenarios.published import CASES, summary
from orchestration.scenarios.scenario import Scenario
from orchestration.system.prepared_run import PreparedRun, values_of
from orchestration.system.time_grid import GRID_TOLERANCE

# outputs of the laws that estimate a disturbance from the control that they take as delivered
_ESTIMATES = (".sigma_hat", ".estimated_disturbance")


@dataclass(frozen=True)
class Result:
    """A finished run: its recording and the metrics that its scenario declares."""

    scenario: Scenario
    recording: Recording
    metrics: dict[str, float]

    @property
    def metric_units(self) -> dict[str, str]:
        """Unit of each metric, "" where it is not known."""
        signals = dict(zip(self.recording.names, self.recording.units, strict=True))
        return metric_units(self.scenario.metrics, signals)

    @property
    def metrics_with_units(self) -> MetricDocument:
        """The metrics as the files hold them."""
        return with_units(self.metrics, self.metric_units)


def run(
    loaded: Scenario,
    folder: Path,
    progress: Callable[[int, int], None] | None = None,
    file_format: RecordingFormat = RecordingFormat.CSV,
    fmus: ExitStack | None = None,
    **options: Any,
) -> Result:
    """Runs one scenario; writes NAME.csv or .parquet and NAME.json (settings, FMUs, metrics) to `folder`.

    progress, options: of `simulate`. A run that ends early leaves its recording as NAME.partial.csv or
    .parquet, which the next run that succeeds removes. The room for the recording is reserved before the
    run; where it cannot be written all the same, it is in a temporary folder, which the error names.
    fmus: frees the FMUs when it is closed; by default they are freed once the files are written. So an FMU
    that crashes then loses nothing.
    """
    file = folder / f"{loaded.name}.{file_format}"
    check_steps(loaded.prepared)
    with ExitStack() as own:
        options["fmus"] = fmus or own
        try:
            with reserved(file, loaded.prepared.shape):
                recording = simulate_prepared(loaded.system, loaded.prepared, progress, **options)
        except SimulationError as error:
            if len(error.recording.time):
                _write_partial(error.recording, file)
            raise
        result = write_result(loaded, recording, folder, file_format)
        for ending in RecordingFormat:
            file.with_suffix(f".partial.{ending}").unlink(missing_ok=True)
        parent_process.results_are_written()
    return result


def check_steps(prepared: PreparedRun) -> None:
    """Checks that no controller estimates by control of internal steps that the vehicle does not get."""
    for name in sorted({p.component for n, p in prepared.system.ports.items() if n.endswith(_ESTIMATES)}):
        values, step = values_of(prepared, name), prepared.periods[name] * prepared.experiment.step_size
        internal_step = values.get("internal_step", step)
        if step > internal_step * (1.0 + GRID_TOLERANCE):
            longest = f"{min(step, values.get('observer_period', step)):g} s"
            message = f"{name}: communication step of {step:g} s: expected at most internal_step = "
            message += f"{internal_step:g} s, or {longest} with an internal_step of {longest}"
            warnings.warn(message, ScenarioWarning, stacklevel=3)


def write_result(
    loaded: Scenario,
    recording: Recording,
    folder: Path,
    file_format: RecordingFormat = RecordingFormat.CSV,
) -> Result:
    """Writes the two files of `run` of a recording that was made elsewhere.

    Where a metric fails, the files of an earlier run stay, and the recording is NAME.partial.csv or .parquet.
    """
    file = folder / f"{loaded.name}.{file_format}"
    try:
        result = Result(loaded, recording, metrics.evaluate(recording, loaded.metrics))
    except BaseException:
        _write_partial(recording, file)
        raise
    start = time.perf_counter()
    digest = _write(recording, file)
    if "statistics" in recording.provenance:
        recording.provenance["statistics"]["phases_s"]["writing"] = time.perf_counter() - start
    files.write_document(file, digest, loaded.resolved, recording.provenance, result.metrics_with_units)
    return result


def _write_partial(recording: Recording, file: Path) -> None:
    _write(recording, file.with_suffix(f".partial{file.suffix}"))


def _write(recording: Recording, file: Path) -> str:
    """Writes a recording; returns the SHA-256 of its file."""
    try:
        return files.write(file, recording)
    except OSError as error:
        if error.errno == errno.EFBIG:
            hint = "an FMU may have limited this process; with --timeout FMUs have one of their own"
            raise OrchestrationError(f"{file}: {error.strerror}: {hint}") from error
        elsewhere = lasting_folder() / file.name
        recording.write(elsewhere)
        raise OrchestrationError(f"{file}: {error.strerror}; the recording is in {elsewhere}") from error


def reproduced(flavour: Flavour = Flavour.NATIVE) -> dict[str, Scenario]:
    """Returns the shipped scenarios of the paper's experiments by name."""
    paths = scenario.shipped().items()
    return {name: scenario.load(path, flavour=flavour) for name, path in paths if name.startswith(CASES)}


def run_all(
    folder: Path,
    workers: int,
    progress: Callable[[str], None] = lambda name: None,
    flavour: Flavour = Flavour.NATIVE,
) -> dict[str, Result]:
    """Runs every reproduced scenario, `workers` at once; `progress` gets the name of each that is done.

    Raises OrchestrationError for a run that fails.
    """
    scenarios, results = list(reproduced(flavour).values()), dict[str, Result]()
    for system in {repr(loaded.system): loaded.system for loaded in scenarios}.values():
        group = [loaded for loaded in scenarios if loaded.system == system]
        runs = run_many(system, [loaded.experiment for loaded in group], workers=workers)
        for loaded, run in zip(group, runs, strict=True):
            if isinstance(run, Failure):
                raise OrchestrationError(f"{loaded.name}: {run.reason}")
            results[loaded.name] = write_result(loaded, run, folder)
            progress(loaded.name)
    return results


def write_report(
    results: Mapping[str, Result], folder: Path, formats: Sequence[FigureFormat] = (FigureFormat.PNG,)
) -> list[Path]:
    """Writes summary.json and the figures of the paper; returns the files."""
    recordings = {name: result.recording for name, result in results.items()}
    measured = {name: result.metrics for name, result in results.items()}
    path = folder / "summary.json"
    write_json_atomically(path, summary({name: r.metrics_with_units for name, r in results.items()}))
    if not formats:
        return [path]
    from orchestration.scenarios.paper_figures import write_figures

    return [path, *write_figures(recordings, measured, folder, formats)]

"""Running scenarios into a folder: one, or all that ship, side by side."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path

from fmus.files import lasting_folder, write_json_atomically
from fmus.registry import Flavour
from orchestration.errors import OrchestrationError, SimulationError
from orchestration.master import simulate
from orchestration.master.checkpoint import Checkpoint, Checkpoints
from orchestration.results import metrics
from orchestration.results.files import reserved
from orchestration.results.formats import FigureFormat, RecordingFormat
from orchestration.results.metric_units import MetricDocument, metric_units, with_units
from orchestration.results.recording import Recording
from orchestration.scenarios import scenario
from orchestration.scenarios.paper_tables import summary
from orchestration.scenarios.published import CASES
from orchestration.scenarios.scenario import Scenario
from orchestration.scenarios.worker_pool import worker_pool
from orchestration.system.prepared_run import prepare

_LONGEST_FIRST = ("example-extended", "example-l1")  # so that no core idles at the end


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
    *,
    timeout: float | None = None,
    real_time: float | None = None,
    checkpoints: Checkpoints | None = None,
    resume: Checkpoint | None = None,
) -> Result:
    """Run one scenario and write NAME.csv or .parquet and NAME.json (settings, FMUs, metrics) to `folder`.

    progress .. resume: of `simulate`. A run that ends early leaves its recording as NAME.partial.csv or
    .parquet. The room for the recording is reserved before the run; where it cannot be written all the same,
    it is in a temporary folder, which the error names.
    """
    file = folder / f"{loaded.name}.{file_format}"
    try:
        with reserved(file, prepare(loaded.system, loaded.experiment).shape):
            recording = simulate(
                loaded.system,
                loaded.experiment,
                progress,
                timeout=timeout,
                real_time=real_time,
                checkpoints=checkpoints,
                resume=resume,
            )
    except SimulationError as error:
        if len(error.recording.time):
            _write(error.recording, file.with_name(f"{loaded.name}.partial.{file_format}"))
        raise
    _write(recording, file)
    result = Result(loaded, recording, metrics.evaluate(recording, loaded.metrics))
    document = {
        "recording": file.name,
        "scenario": loaded.resolved,
        "run": recording.provenance,
        "metrics": result.metrics_with_units,
    }
    write_json_atomically(folder / f"{loaded.name}.json", document)
    return result


def reproduced(flavour: Flavour = Flavour.NATIVE) -> dict[str, Scenario]:
    """The shipped scenarios of the paper's experiments by name."""
    paths = scenario.shipped().items()
    return {name: scenario.load(path, flavour=flavour) for name, path in paths if name.startswith(CASES)}


def _write(recording: Recording, file: Path) -> None:
    try:
        recording.write(file)
    except OSError as error:
        elsewhere = lasting_folder() / file.name
        recording.write(elsewhere)
        raise OrchestrationError(f"{file}: {error.strerror}; the recording is in {elsewhere}") from error


def run_all(
    folder: Path,
    workers: int,
    progress: Callable[[str], None] = lambda name: None,
    flavour: Flavour = Flavour.NATIVE,
) -> dict[str, Result]:
    """Run every reproduced scenario in `workers` processes; `progress` gets the name of each that is done."""
    scenarios = reproduced(flavour)
    names = sorted(scenarios, key=lambda name: name not in _LONGEST_FIRST)
    results = {}
    with worker_pool(workers) as submit:
        futures = {submit(_run_named, name, folder, flavour): name for name in names}
        for future in as_completed(futures):
            name = futures[future]
            results[name] = Result(scenarios[name], *future.result())
            progress(name)
    return results


def _run_named(name: str, folder: Path, flavour: Flavour) -> tuple[Recording, dict[str, float]]:
    result = run(scenario.load(scenario.find(name), flavour=flavour), folder)
    return result.recording, result.metrics


def write_report(
    results: Mapping[str, Result], folder: Path, formats: Sequence[FigureFormat] = (FigureFormat.PNG,)
) -> list[Path]:
    """Write summary.json and the figures of the paper; returns the files."""
    recordings = {name: result.recording for name, result in results.items()}
    measured = {name: result.metrics for name, result in results.items()}
    path = folder / "summary.json"
    write_json_atomically(path, summary({name: r.metrics_with_units for name, r in results.items()}))
    if not formats:
        return [path]
    from orchestration.scenarios.paper_figures import write_figures

    return [path, *write_figures(recordings, measured, folder, formats)]

"""Running all scenarios that ship into a folder, side by side, and what sums them up."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from fmus.files import write_json_atomically
from fmus.registry import Flavour
from orchestration.errors import OrchestrationError
from orchestration.many.job import Failure
from orchestration.many.run_many import run_many
from orchestration.results.formats import FigureFormat
from orchestration.scenarios import scenario
from orchestration.scenarios.published import CASES, summary
from orchestration.scenarios.run_files import Result, write_result
from orchestration.scenarios.scenario import Scenario


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

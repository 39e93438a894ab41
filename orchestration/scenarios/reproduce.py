"""Running all scenarios that ship into a folder, side by side, and what sums them up."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from pathlib import Path

from fmus.files import write_json_atomically
from fmus.registry import Flavour
from orchestration.results.formats import FigureFormat
from orchestration.results.recording import Recording
from orchestration.scenarios import scenario
from orchestration.scenarios.paper_tables import summary
from orchestration.scenarios.published import CASES
from orchestration.scenarios.run_files import Result, run
from orchestration.scenarios.scenario import Scenario
from orchestration.scenarios.worker_pool import worker_pool

_LONGEST_FIRST = ("example-extended", "example-l1")  # so that no core idles at the end


def reproduced(flavour: Flavour = Flavour.NATIVE) -> dict[str, Scenario]:
    """The shipped scenarios of the paper's experiments by name."""
    paths = scenario.shipped().items()
    return {name: scenario.load(path, flavour=flavour) for name, path in paths if name.startswith(CASES)}


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

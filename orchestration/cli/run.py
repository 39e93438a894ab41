"""Commands on scenarios, run, scenarios, and on the paper: reproduce."""

import math
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fmus.errors import MissingExtraError
from fmus.operating_system import usable_processors
from fmus.registry import Flavour
from orchestration.cli import shared
from orchestration.cli.changes import NO_CHANGES, Changes, takes_changes
from orchestration.errors import OrchestrationError
from orchestration.results.formats import FigureFormat, RecordingFormat
from orchestration.results.metric_units import error_table, metrics_table, statistics_table

_SHORT_S = 0.5  # a run that takes no longer shows no progress

if TYPE_CHECKING:
    from orchestration.results.recording import Recording
    from orchestration.scenarios.scenario import Scenario


@takes_changes()
def run(
    name: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO",
            help="Name of a shipped scenario, a .toml file, or an .ssp package.",
            autocompletion=shared.shipped_scenarios,
        ),
    ],
    out: shared.OutFolder = Path("results"),
    flavour: shared.FlavourOption = Flavour.NATIVE,
    changes: Changes = NO_CHANGES,
    file_format: Annotated[
        RecordingFormat, typer.Option("--format", help="Write the recording in this format.")
    ] = RecordingFormat.CSV,
    formats: shared.FigureFormatsOption = "png",
    real_time: Annotated[
        float | None,
        typer.Option(metavar="FACTOR", help="Run at this factor of real time; 2 is twice as fast."),
    ] = None,
    timeout: Annotated[
        float | None,
        typer.Option(metavar="S", help="Run the FMUs in another process, and end it if a step takes longer."),
    ] = None,
    checkpoint: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Save the state of the whole system here on an interrupt."),
    ] = None,
    every: Annotated[
        float,
        typer.Option(metavar="S", help="Save the checkpoint also at this interval of simulated seconds."),
    ] = math.inf,
    resume: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Continue from this checkpoint.")
    ] = None,
    error_estimate: Annotated[
        bool, typer.Option("--error-estimate", help="Run again at twice the step to estimate the error.")
    ] = False,
    statistics: Annotated[
        bool, typer.Option("--statistics", help="Measure the time of each phase and of each FMU's steps.")
    ] = False,
) -> None:
    """Run one scenario, and write its recording (CSV or Parquet), its metrics (JSON) and a figure.

    The columns of the recording have the units of the FMUs, in their heads.
    For example, l1-depth run nominal-l1 writes nominal-l1.csv, nominal-l1.json and nominal-l1.png to results.
    """
    from orchestration.cli import chosen_scenario
    from orchestration.run.checkpoint import Checkpoints, read_checkpoint
    from orchestration.scenarios import run_files

    written_formats = shared.figure_formats(formats)
    if every < math.inf and checkpoint is None:
        raise OrchestrationError(f"--every {every:g}: expected --checkpoint FILE beside it")
    # freed once all is written and printed: an FMU may crash then
    with ExitStack() as fmus:
        with (
            chosen_scenario.opened(name, flavour, changes) as chosen,
            shared.progress(chosen.name, 1, _SHORT_S) as bar,
        ):
            result = run_files.run(
                _with_error_estimate(chosen) if error_estimate else chosen,
                out,
                bar.update,
                file_format,
                real_time=real_time,
                timeout=timeout,
                checkpoints=Checkpoints(checkpoint, every) if checkpoint else None,
                resume=read_checkpoint(resume) if resume else None,
                statistics=statistics,
                fmus=fmus,
            )
        figures = _figures(chosen.title, result.recording, out / chosen.name, written_formats)
        if result.metrics:
            print(metrics_table(chosen.title, result.metrics, result.metric_units, chosen.metrics))
        _print_remarks(result.recording)
        if statistics:
            print(statistics_table(result.recording.provenance["statistics"]))
        written = [out / f"{chosen.name}.{ending}" for ending in (file_format, "json")]
        print(*written, *figures, sep="\n", flush=True)


def _figures(title: str, recording: "Recording", path: Path, formats: Sequence[FigureFormat]) -> list[Path]:
    """Writes the figure of a run, or prints which extra it needs, or that there is no number to draw."""
    if not formats:
        return []
    if not recording.numbers:
        print("l1-depth: no figure: no number is recorded", file=sys.stderr)
        return []
    try:
        from orchestration.results.figures import run_figure  # Matplotlib takes longer to import than a run

        return run_figure(title, recording, path, formats)
    except MissingExtraError as error:
        print(f"l1-depth: no figure: {error}", file=sys.stderr)
        return []


def _with_error_estimate(chosen: "Scenario") -> "Scenario":
    settings = {**chosen.resolved.get("experiment", {}), "error_estimate": True}
    return replace(
        chosen,
        experiment=replace(chosen.experiment, error_estimate=True),
        resolved={**chosen.resolved, "experiment": settings},
    )


def _print_remarks(recording: "Recording") -> None:
    """Prints the estimated error, which FMU ended the run early, and how well a run kept pace."""
    remarks = recording.provenance
    if estimate := remarks.get("error_estimate"):
        units = dict(zip(recording.names, recording.units, strict=True))
        print(error_table(estimate["quantities"], units))
    if terminated := remarks.get("terminated"):
        where = f"{terminated['component']} terminated the simulation at t = {terminated['time_s']:.9g} s"
        print("; ".join([where, *terminated["messages"]]))
    if pace := remarks.get("real_time"):
        missed, worst, where = pace["missed_deadlines"], pace["worst_lateness_s"], pace["worst_at_s"]
        print(f"{missed} deadlines missed, the worst by {1e3 * worst:.3g} ms at t = {where:g} s")


def scenarios() -> None:
    """List the scenarios that ship with the package.

    For example, l1-depth run nominal-l1 runs one of them.
    """
    from orchestration.scenarios.layers import shipped
    from orchestration.scenarios.toml_file import read_toml

    for name, path in shipped().items():
        print(f"{name:28} {read_toml(path).data['title']}")


def reproduce(
    out: shared.OutFolder = Path("results"),
    workers: Annotated[int, typer.Option(help="Scenarios that run at once.", min=1)] = usable_processors(),
    flavour: shared.FlavourOption = Flavour.NATIVE,
    formats: shared.FigureFormatsOption = "png",
) -> None:
    """Run the shipped scenarios, but not their sweeps, and give the tables and figures of the paper.

    Writes the recordings and metrics of the scenarios, figures 3, 5 and 6, and summary.json.
    For example, l1-depth reproduce --formats pdf writes the figures as PDF.
    """
    from orchestration.cli.chosen_scenario import build_missing_fmus
    from orchestration.scenarios import run_files
    from orchestration.scenarios.published import comparison_table

    written_formats = shared.figure_formats(formats)
    shared.check_writable(out)
    scenarios = run_files.reproduced(flavour)
    build_missing_fmus(scenarios.values())
    with shared.progress("reproduce", len(scenarios)) as bar:
        results = run_files.run_all(out, workers, lambda name: bar.advance(note=name), flavour)
    written = run_files.write_report(results, out, written_formats)
    shared.print_table(comparison_table({name: result.metrics for name, result in results.items()}))
    print(*written, sep="\n")

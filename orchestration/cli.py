"""The command line `l1-depth`."""

import os
import sys
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from fmpy.model_description import ScalarVariable
from fmpy.validation import validate_fmu
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from tqdm import tqdm

from fmus import catalogue
from fmus.catalogue import Flavour
from fmus.errors import ExportError
from fmus.toolchain import PLATFORMS, check_platforms
from orchestration import bench, report, reproduce, scenario
from orchestration import identify as identification
from orchestration.errors import OrchestrationError
from orchestration.system import describe

app = typer.Typer(
    help="Extended L1 adaptive depth control of an underwater vehicle: FMUs and their master.",
    add_completion=False,
    pretty_exceptions_enable=False,
)
_console = Console(width=None if sys.stdout.isatty() else 130)
_BEFORE_A_BAR_S = 2.0
_PIPED_WIDTH = 260  # a line a variable, for grep
_IDENTIFIED = Path(__file__).parent / "scenarios" / "parameters" / "identified.toml"

FlavourOption = Annotated[Flavour, typer.Option(help="How our own FMUs run: compiled, or on Python.")]
OutFolder = Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to write to.")]


@contextmanager
def _bar(total: float, unit: str, description: str) -> Iterator[Any]:
    """A progress bar on standard error, if that is a terminal and the work takes over two seconds."""
    with tqdm(
        total=total, unit=unit, desc=description, delay=_BEFORE_A_BAR_S, disable=None, file=sys.stderr
    ) as bar:
        yield bar


@app.command()
def build(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]...", help="Blocks; all by default.")
    ] = None,
    flavour: FlavourOption = Flavour.NATIVE,
    platform: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,NAME", help=f"Of a native FMU: {', '.join(PLATFORMS)}; this one by default."
        ),
    ] = None,
    all_platforms: Annotated[
        bool, typer.Option("--all-platforms", help="Of a native FMU: all of them.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help=f"Folder to write to; by default {catalogue.DIST.name} of the package."
        ),
    ] = None,
) -> None:
    """Write DIR/NAME.fmu for each block."""
    if all_platforms and platform:
        raise OrchestrationError(f"--platform {platform} and --all-platforms: expected one of them")
    named = check_platforms([each.strip() for each in platform.split(",")]) if platform else ()
    platforms = PLATFORMS if all_platforms else named
    chosen = names or catalogue.block_names()
    for name in chosen:
        catalogue.load_block(name)
    with _bar(len(chosen), "FMU", "build") as bar:
        for name in chosen:
            print(catalogue.build(name, out, flavour, platforms))
            bar.update()


@app.command()
def check(fmus: Annotated[list[Path], typer.Argument(metavar="FMU...")]) -> None:
    """Validate FMUs with FMPy's validator; fails if it finds any problem."""
    problems = {path: _problems(path) for path in fmus}
    for path, found in problems.items():
        print(f"{path}: {len(found)} problems" if found else f"{path}: no problems")
        for problem in found:
            print(f"  {' '.join(problem.split())}")
    count = sum(len(found) for found in problems.values())
    if count:
        raise OrchestrationError(f"{count} problems found: expected none")


def _problems(path: Path) -> list[str]:
    describe(path)
    with zipfile.ZipFile(path) as archive:
        damaged = archive.testzip()
    return [f"{damaged} is damaged"] if damaged else validate_fmu(str(path))


@app.command()
def inspect(fmu: Annotated[Path, typer.Argument(metavar="FMU")]) -> None:
    """Show what an FMU is and every variable with its unit, range and start value."""
    description = describe(fmu)
    print(f"{description.modelName}: {description.description or ''}")
    tool = description.generationTool or "an unknown tool"
    print(f"FMI {description.fmiVersion}, GUID {description.guid}, made by {tool}")
    table = Table()
    table.add_column("Variable", no_wrap=True)
    for heading in ("Causality", "Type", "Unit", "Start", "Permitted", "Description"):
        table.add_column(heading, overflow="fold")
    for v in description.modelVariables:
        limits = _permitted(v)
        kind = v.declaredType.name if v.declaredType else v.type
        cells = (v.name, v.causality, kind, v.unit, v.start, limits, v.description)
        table.add_row(*(escape(str(cell)) if cell is not None else "" for cell in cells))
    (_console if sys.stdout.isatty() else Console(width=_PIPED_WIDTH)).print(table)


def _permitted(variable: ScalarVariable) -> str:
    """Enumeration items, or the range."""
    declared = variable.declaredType
    if declared is not None and declared.items:
        return ", ".join(f"{item.value} ({item.name})" for item in declared.items)
    if variable.min is None and variable.max is None:
        return ""
    return f"{variable.min or ''}..{variable.max or ''}"


@app.command()
def run(
    name: Annotated[str, typer.Argument(metavar="SCENARIO", help="A shipped scenario or a .toml file.")],
    out: OutFolder = Path("results"),
    flavour: FlavourOption = Flavour.NATIVE,
) -> None:
    """Run one scenario: recording (CSV), what was run and metrics (JSON), a figure."""
    chosen = scenario.load(scenario.find(name), flavour=flavour)
    reproduce.build_what_is_missing([chosen])
    with _bar(1, "step", chosen.name) as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        result = reproduce.run(chosen, out, progress)
    figures = report.run_figure(chosen.title, result.recording, out / chosen.name)
    _console.print(report.metrics_table(chosen.title, result.metrics))
    for path in (out / f"{chosen.name}.csv", out / f"{chosen.name}.json", *figures):
        print(path)


@app.command()
def scenarios() -> None:
    """List the scenarios that ship with the package."""
    for name, path in scenario.shipped().items():
        print(f"{name:28} {scenario.load(path).title}")


@app.command()
def identify(
    seed: Annotated[int, typer.Option(help="Seed of the starting points.", min=0)] = 1,
    evaluations: Annotated[int, typer.Option(help="Pairs of runs allowed in all.", min=2)] = 80,
    starts: Annotated[int, typer.Option(help="Pairs of runs on drawn starting points.", min=1)] = 10,
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="Parameter file; by default the one the scenarios use.")
    ] = _IDENTIFIED,
) -> None:
    """Fit the gains that the paper does not publish to the nominal row of its Table 1."""
    reproduce.build_what_is_missing(scenario.load(scenario.find(name)) for name in identification.SCENARIOS)
    with _bar(evaluations, "run", "identify") as bar:

        def progress(cost: float) -> None:
            bar.set_postfix(cost=f"{cost:.3g}")
            bar.update()

        fit = identification.identify(seed, evaluations, starts, progress)
    identification.write(fit, out)
    for name, measured in fit.metrics.items():
        _console.print(report.metrics_table(name, measured))
    for name, value in fit.gains.items():
        print(f"{name} = {value}")
    print(out)


@app.command(name="reproduce")
def reproduce_all(
    out: OutFolder = Path("results"),
    workers: Annotated[int, typer.Option(help="Processes.", min=1)] = os.cpu_count() or 1,
    flavour: FlavourOption = Flavour.NATIVE,
) -> None:
    """Run every scenario and give the paper's tables and figures back."""
    with _bar(len(scenario.shipped()), "scenario", "reproduce") as bar:
        results = reproduce.run_all(out, workers, lambda name: bar.update() and None, flavour)
    written = reproduce.write_report(results, out)
    _console.print(report.comparison_table({name: r.metrics for name, r in results.items()}))
    for path in written:
        print(path)


@app.command(name="bench")
def measure(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[SCENARIO]...", help="Shipped scenarios (Jacobi, no events)."),
    ] = None,
    rounds: Annotated[int, typer.Option(help="Of which the median is taken.", min=1)] = 7,
) -> None:
    """Measure the FMUs: FMI against bare C, native against python, a scenario against one C program."""
    chosen, blocks = names or ["nominal-extended"], catalogue.block_names()
    for name in chosen:
        scenario.find(name)
    with _bar(len(blocks) + len(chosen), "part", "bench") as bar:
        layers = [bar.update() or bench.layer(name, rounds=rounds) for name in blocks]
        loops = [bar.update() or bench.loop(name, rounds=rounds) for name in chosen]
    for table in bench.tables(layers, loops):
        _console.print(table)
    print(f"medians of {rounds} rounds on {bench.machine()}")


def main() -> None:
    """Entry point: every failure is one line on standard error; exit status 1, or 2 for bad usage.

    With L1_DEPTH_DEBUG set, an error that nobody foresaw comes with its traceback.
    """
    if len(sys.argv) == 1:
        sys.argv.append("--help")
    try:
        app(standalone_mode=False)
    except (typer.Abort, KeyboardInterrupt):
        _fail("interrupted", 1)
    except (OrchestrationError, ExportError, OSError) as error:
        _fail(str(error), 1)
    except Exception as error:
        usage = getattr(error, "format_message", None)  # click's own errors, wherever typer keeps them
        if usage:
            _fail(f"{usage()} Try --help.", 2)
        if os.environ.get("L1_DEPTH_DEBUG"):
            raise
        _fail(f"unforeseen {type(error).__name__}: {error}; set L1_DEPTH_DEBUG=1 for the traceback", 1)


def _fail(message: str, status: int) -> None:
    print(f"l1-depth: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(status)

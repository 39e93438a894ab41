"""Whole commands, from the start of their process to its end, beside the same loop in other importers.

`python -m tests.speed.commands` prints medians with the least and the largest time; all take turns, so that
they see the same machine. What a command does once comes before: the FMUs of scenarios, and the compiler's
own libraries for each platform. A build anew finds neither FMUs nor anything of them that was compiled.
"""

import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Annotated

import typer
from rich.table import Table

from fmus import catalogue
from fmus.platforms import PLATFORMS
from orchestration.scenarios import scenario
from tests.importers.comparison import packaged
from tests.importers.importers import ImporterJob
from tests.printing import print_tables

SCENARIO = "nominal-extended"
FIVE = ("L1DepthController", "RovDepthPlant", "L1Controller", "ExamplePlant", "DepthReference")
FIRST_RUN = """
from orchestration import System, simulate
system = System({{"controller": {controller!r}, "plant": {plant!r}}}, [
    ("controller.voltage[1]", "plant.voltage[1]"), ("controller.voltage[2]", "plant.voltage[2]"),
    ("plant.measured_depth", "controller.measured_depth")])
simulate(system, stop_time=10.0, step_size=0.02, open_inputs="start")
"""
ECOS = """
from ecospy.EcosSimulation import EcosSimulation
with EcosSimulation(ssp_path={package!r}, step_size={step!r}) as simulation:
    simulation.init(0.0)
    simulation.step({count})
"""
LIBCOSIM = """
from libcosimpy.CosimExecution import CosimExecution
CosimExecution.from_ssp_file({package!r}, {nanoseconds}).step({count})
"""
FMPY = """
from fmpy.ssp.simulation import simulate_ssp
simulate_ssp({package!r}, 0.0, {stop!r}, {step!r})
"""
# exported, as Zig ends with a fault where a library for macOS exports nothing
_COMPILED = (
    '#include <math.h>\n__attribute__((visibility("default"))) double f(double x) { return sin(x); }\n'
)


@dataclass
class Command:
    """What is timed: its times so far [s], on the wall clock and of all processors together."""

    name: str
    arguments: Sequence[str]
    environment: Mapping[str, str] = field(default_factory=dict)
    prepare: Callable[[], object] = lambda: None
    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)

    def measure(self, folder: Path, environment: Mapping[str, str]) -> None:
        """Run it once; RuntimeError if it fails. environment: of all commands, to which it adds its own."""
        self.prepare()
        variables = {**environment, **self.environment}
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        done = subprocess.run(
            self.arguments, cwd=folder, env=variables, capture_output=True, text=True, check=False
        )
        self.wall.append(time.perf_counter() - start)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        self.cpu.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
        if done.returncode:
            raise RuntimeError(f"{self.name}: {done.stderr[-500:]}")


def commands(folder: Path) -> list[Command]:
    """The commands of this project, and the importers that are installed."""
    chosen = scenario.load(scenario.find(SCENARIO))
    catalogue.build_missing(chosen.system.components.values())
    components = {name: str(path) for name, path in chosen.system.components.items()}
    run = ("l1-depth", "run", SCENARIO, "--out", "results")
    return [
        Command("python -c pass", (sys.executable, "-c", "pass")),
        Command("l1-depth --help", ("l1-depth", "--help")),
        Command("import, and a first simulate", (sys.executable, "-c", FIRST_RUN.format(**components))),
        Command(f"l1-depth run {SCENARIO} --formats none", (*run, "--formats", "none")),
        Command(f"l1-depth run {SCENARIO}, with its figure", run),
        Command("l1-depth reproduce, with its figures", ("l1-depth", "reproduce", "--out", "results")),
        *_builds(folder),
        Command("l1-depth check of one FMU", ("l1-depth", "check", components["controller"])),
        *_of_importers(packaged(chosen, folder)),
    ]


def _of_importers(job: ImporterJob) -> list[Command]:
    """The same loop in other importers, which write nothing."""
    times = {"step": job.step_size, "stop": job.stop_time, "nanoseconds": round(job.step_size * 1e9)}
    values = {"package": str(job.package), "count": job.reports, **times}
    programs = {"Ecos": ECOS, "libcosim": LIBCOSIM, "FMPy": FMPY}
    return [
        Command(f"{name}, nothing written", (sys.executable, "-c", text.format(**values)))
        for name, text in programs.items()
    ]


def _builds(folder: Path) -> list[Command]:
    """Builds of five FMUs: from nothing but the compiler's own libraries, and without a change."""
    build, libraries = ("l1-depth", "build", *FIVE), folder / "libraries"
    caches = {"XDG_CACHE_HOME": f"{folder}/cache", "ZIG_GLOBAL_CACHE_DIR": f"{folder}/cache/zig"}
    of_unchanged = {"XDG_CACHE_HOME": f"{folder}/unchanged"}  # which holds the stamps of its FMUs

    def forget() -> None:
        for name in ("cache", "built"):
            shutil.rmtree(folder / name, ignore_errors=True)
        if not libraries.exists():  # made where they are used, as Zig finds them by their paths
            compiled = _COMPILE.format(platforms=PLATFORMS, text=_COMPILED)
            subprocess.run([sys.executable, "-c", compiled], env={**os.environ, **caches}, check=True)
            shutil.move(folder / "cache" / "zig", libraries)
        shutil.copytree(libraries, folder / "cache" / "zig", symlinks=True)

    return [
        Command("l1-depth build of five FMUs, anew", (*build, "--out", "built"), caches, forget),
        Command("the same for all platforms", (*build, "--all-platforms", "--out", "built"), caches, forget),
        Command("the same, unchanged", (*build, "--out", "unchanged"), of_unchanged),
    ]


_COMPILE = """
from fmus.export.toolchain import compile_library
for platform in {platforms!r}:
    compile_library("empty", {{"empty.c": {text!r}}}, ["empty.c"], platform)
"""


def measured(rounds: int, parts: Sequence[str]) -> list[Command]:
    """All commands, or those with one of these parts in their names, after a round that does not count."""
    with tempfile.TemporaryDirectory(prefix="l1-depth-speed-") as name:
        folder = Path(name)
        environment = {**os.environ, "PYTHONPYCACHEPREFIX": str(folder / "bytecode")}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)
        chosen = [c for c in commands(folder) if not parts or any(part in c.name for part in parts)]
        for turn in range(rounds + 1):
            for command in chosen:
                command.measure(folder, environment)
                if not turn:
                    command.wall.clear()
                    command.cpu.clear()
        return chosen


def table(chosen: Sequence[Command]) -> Table:
    """Medians, and in brackets the least and the largest [s]."""
    result = Table(title="From the start of the process to its end")
    for heading in ("Command", "s", "s of CPU"):
        result.add_column(heading, justify="left" if heading == "Command" else "right", overflow="fold")
    for command in chosen:
        spread = [f"{median(x):.2f} ({min(x):.2f} to {max(x):.2f})" for x in (command.wall, command.cpu)]
        result.add_row(command.name, *spread)
    return result


def main(
    rounds: Annotated[int, typer.Option(help="Measurements of which the median is taken.", min=1)] = 5,
    only: Annotated[
        list[str] | None, typer.Option(help="Time commands alone whose names have this part; repeatable.")
    ] = None,
    markdown: Annotated[bool, typer.Option(help="Print the table of docs/performance.md.")] = False,
) -> None:
    """Time whole commands and other importers, from the start of their processes to the end."""
    print_tables([table(measured(rounds, only or []))], markdown)


if __name__ == "__main__":
    typer.run(main)

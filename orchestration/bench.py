"""How fast the FMUs are, as ratios measured in one run on one machine.

Medians over rounds; what is compared takes turns, so that both see the same disturbances.
"""

import os
import platform
import subprocess
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from statistics import median

import numpy as np
from rich.table import Table

from fmus import catalogue
from fmus.catalogue import Flavour
from fmus.toolchain import FLAGS, host_platform, library_name, zig
from orchestration import monolith, scenario
from orchestration.errors import OrchestrationError
from orchestration.master import simulate
from orchestration.plan import read_result, write_plan
from orchestration.reproduce import build_what_is_missing
from orchestration.scenario import Scenario
from orchestration.system import check

_LIBRARIES = () if os.name == "nt" else ("-ldl", "-lm")
_C = resources.files("orchestration") / "c"


@dataclass(frozen=True)
class Layer:
    """One communication step of a block through FMI, all inputs set and outputs read, and without FMI [s]."""

    block: str
    through_fmi: float
    bare: float


@dataclass(frozen=True)
class Loop:
    """A whole scenario [s]: in this project's master by flavour, in a C host, and as one C program."""

    scenario: str
    steps: int
    master_python: float
    master_native: float
    host: float
    monolith: float

    @property
    def ways(self) -> dict[str, float]:
        """Seconds of each way in which the scenario was run."""
        return {
            "python FMUs, this master": self.master_python,
            "native FMUs, this master": self.master_native,
            "native FMUs, a host in C": self.host,
            "the same equations, one C program": self.monolith,
        }


def tables(layers: list[Layer], loops: list[Loop]) -> list[Table]:
    """What was measured, with the ratios that matter."""
    steps = Table(title="One communication step", title_justify="left")
    for heading in ("Block", "ns by FMI", "ns in bare C", "ratio"):
        steps.add_column(heading, justify="left" if heading == "Block" else "right")
    for each in layers:
        fmi, bare = each.through_fmi, each.bare
        steps.add_row(each.block, f"{1e9 * fmi:.0f}", f"{1e9 * bare:.0f}", f"{fmi / bare:.2f}")
    runs = Table(title="A whole scenario", title_justify="left")
    for heading in ("Scenario", "How", "ms", "us a step", "of python"):
        runs.add_column(heading, justify="left" if heading in ("Scenario", "How") else "right")
    for each in loops:
        for how, seconds in each.ways.items():
            per_step, speed = 1e6 * seconds / each.steps, each.master_python / seconds
            runs.add_row(each.scenario, how, f"{1e3 * seconds:.2f}", f"{per_step:.2f}", f"1/{speed:.0f}")
        runs.add_section()
    return [steps, runs]


def machine() -> str:
    """What was measured on, for the record."""
    system = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    return f"{system}, Python {platform.python_version()}"


def layer(name: str, steps: int = 200_000, rounds: int = 7) -> Layer:
    """What FMI costs around one step of a block."""
    step = catalogue.load_block(name).step_size
    with _workplace() as folder:
        path = catalogue.build_if_stale(name)
        with zipfile.ZipFile(path) as archive:
            archive.extractall(folder)
        _equations(folder, 0, folder / "sources")
        _compile(folder, "bare", [f"-DPART(f)={monolith.part(0, '##f')}", str(_C / "bare.c"), "part0.o"],
                 includes=[folder / "sources"])  # fmt: skip
        library = folder / library_name(name, host_platform())
        lines = _output(folder, "bare", library, step, steps, rounds)
    fmi, bare = zip(*(map(float, line.split()) for line in lines), strict=True)
    return Layer(name, median(fmi) / steps, median(bare) / steps)


def loop(name: str, rounds: int = 7) -> Loop:
    """A scenario in every way in which it can run.

    Raises OrchestrationError if the ways do not give the same trajectories.
    """
    native = scenario.load(scenario.find(name))
    python = scenario.load(scenario.find(name), flavour=Flavour.PYTHON)
    build_what_is_missing([native, python])
    by_python = _timed(lambda: simulate(python.system, python.experiment))
    by_master = median(_timed(lambda: simulate(native.system, native.experiment)) for _ in range(rounds))
    with _workplace() as folder:
        host, single = _programs(native, folder, rounds)
    return Loop(name, len(native.experiment.points()) - 1, by_python, by_master, host, single)


def _programs(chosen: Scenario, folder: Path, rounds: int) -> tuple[float, float]:
    """Seconds of the C host and of the monolith."""
    checked = check(chosen.system, [*chosen.experiment.inputs, *chosen.experiment.signals])
    plan = write_plan(checked, chosen.experiment, folder, host_platform())
    sources = [folder / name / "sources" for name in checked.components]
    _compile(folder, "host", [str(_C / "host.c")], includes=sources[:1])
    (folder / "main.c").write_text(monolith.program(plan), encoding="utf-8")
    for i, include in enumerate(sources):
        _equations(folder, i, include, "-flto")
    parts = [f"part{i}.o" for i in range(len(sources))]
    _compile(folder, "monolith", ["-flto", "main.c", *parts], includes=[])
    host = [float(line) for line in _output(folder, "host", plan, "host.bin", rounds)]
    single = [float(line) for line in _output(folder, "monolith", "table.bin", "monolith.bin", rounds)]
    if not np.array_equal(read_result(folder / "host.bin", plan), read_result(folder / "monolith.bin", plan)):
        raise OrchestrationError(
            f"{chosen.name}: the C host and the monolith differ: expected equal trajectories"
        )
    return median(host), median(single)


@contextmanager
def _workplace() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="l1-depth-bench-") as name:
        yield Path(name)


def _equations(folder: Path, part: int, sources: Path, *options: str) -> None:
    """Compile the equations of an FMU to partN.o."""
    named = f"-DPART(f)={monolith.part(part, '##f')}"
    source = str(_C / "equations.c")
    zig(["cc", "-c", *FLAGS, *options, named, f"-I{sources}", "-o", f"part{part}.o", source], folder)


def _compile(folder: Path, program: str, files: list[str], includes: list[Path]) -> None:
    options = [*FLAGS, f"-I{_C}", *(f"-I{include}" for include in includes)]
    zig(["cc", *options, "-o", program, *files, *_LIBRARIES], folder)


def _output(folder: Path, program: str, *arguments: object) -> list[str]:
    command = [str(folder / program), *map(str, arguments)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise OrchestrationError(
            f"{program} failed with exit status {done.returncode}: {done.stderr.strip()}"
        )
    return done.stdout.splitlines()


def _timed(action: Callable[[], object]) -> float:
    begun = time.perf_counter()
    action()
    return time.perf_counter() - begun

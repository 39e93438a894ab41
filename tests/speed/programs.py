"""C programs that are compiled for a measurement and run beside it."""

import os
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import Any

import fmpy

from fmus.fmi.description import describe
from fmus.native.toolchain import FLAGS, FMI_HEADERS, zig
from fmus.platforms import library_name
from orchestration.errors import OrchestrationError

C_SOURCES = Path(__file__).parent / "c"
_LOADER = Path(str(resources.files("orchestration.exchange")))  # of load.h
# those of the FMUs, and the same instructions of the processor
_FLAGS = (*FLAGS, "-mcpu=baseline")
_LIBRARIES = () if os.name == "nt" else ("-ldl", "-lm")


@contextmanager
def workplace() -> Iterator[Path]:
    """A folder that is gone afterwards."""
    with tempfile.TemporaryDirectory(prefix="l1-depth-speed-") as name:
        yield Path(name)


def extracted(fmu: Path, folder: Path, platform: str) -> tuple[str, Path]:
    """The GUID of an FMU, which is extracted to a folder, and its library there."""
    description: Any = describe(fmu)
    fmpy.extract(str(fmu), str(folder))
    return description.guid, folder / library_name(description.coSimulation.modelIdentifier, platform)


def part_name(part: int) -> str:
    """The compiler's option that gives the functions of c/equations.c the names of a part."""
    return f"-DPART(f)=part{part}_##f"


def compile_equations(
    folder: Path, part: int, sources: Path, *options: str, c_sources: Path = C_SOURCES
) -> None:
    """Compile the equations of an FMU to partN.o."""
    named = part_name(part)
    source = str(c_sources / "equations.c")
    headers = [f"-I{sources}", f"-I{FMI_HEADERS}"]
    zig(["cc", "-c", *_FLAGS, *options, named, *headers, "-o", f"part{part}.o", source], folder)


def compile_program(folder: Path, program: str, files: Sequence[str], includes: Sequence[Path]) -> None:
    """Compile and link with the flags of the FMUs."""
    options = [*_FLAGS, *(f"-I{headers}" for headers in (_LOADER, FMI_HEADERS, *includes))]
    zig(["cc", *options, "-o", program, *files, *_LIBRARIES], folder)


def output_of(folder: Path, program: str, *arguments: object) -> list[str]:
    """The lines that the program prints. Raises OrchestrationError if it fails."""
    command = [str(folder / program), *map(str, arguments)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise OrchestrationError(
            f"{program} failed with exit status {done.returncode}: {done.stderr.strip()}"
        )
    return done.stdout.splitlines()

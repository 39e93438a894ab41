"""C programs that are compiled for a measurement and run beside it."""

import os
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import resources
from pathlib import Path

from fmus.export.toolchain import FLAGS, zig
from orchestration.errors import OrchestrationError
from tests.speed import monolith

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


def compile_equations(folder: Path, part: int, sources: Path, *options: str) -> None:
    """Compile the equations of an FMU to partN.o."""
    named = f"-DPART(f)={monolith.part(part, '##f')}"
    source = str(C_SOURCES / "equations.c")
    zig(["cc", "-c", *_FLAGS, *options, named, f"-I{sources}", "-o", f"part{part}.o", source], folder)


def compile_program(folder: Path, program: str, files: Sequence[str], includes: Sequence[Path]) -> None:
    """Compile and link with the flags of the FMUs."""
    options = [*_FLAGS, f"-I{_LOADER}", *(f"-I{include}" for include in includes)]
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

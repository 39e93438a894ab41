"""States of this project: a clone, or a git revision, whose files are unpacked to a folder."""

import io
import os
import resource
import subprocess
import sys
import tarfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from orchestration.errors import OrchestrationError

ROOT = Path(__file__).parents[2]
PROGRAMS = Path(__file__).parent / "python"
COMMAND = (sys.executable, "-P", "-c", "from orchestration.cli import main; main()")
FIVE = ("L1DepthController", "RovDepthPlant", "L1Controller", "ExamplePlant", "DepthReference")


@dataclass(frozen=True)
class State:
    """The files of a state, a folder in which its programs run and keep their caches, its git revision."""

    sources: Path
    folder: Path
    revision: str

    @property
    def environment(self) -> dict[str, str]:
        """Of its programs: they import its packages, and keep FMUs, stamps and bytecode in its folder.

        The compiler's cache is beside it, for all states.
        """
        inherited = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
        return {
            **inherited,
            "PYTHONPATH": str(self.sources),
            "PYTHONPYCACHEPREFIX": str(self.folder / "bytecode"),
            "XDG_CACHE_HOME": str(self.folder / "cache"),
            "ZIG_GLOBAL_CACHE_DIR": str(self.folder.parent / "zig"),
        }

    def start(self, program: str, *arguments: object, new_session: bool = False) -> "subprocess.Popen[str]":
        """A program of python/, on pipes."""
        command = [sys.executable, "-P", str(PROGRAMS / program), *map(str, arguments)]
        pipe = subprocess.PIPE
        return subprocess.Popen(
            command,
            cwd=self.folder,
            env=self.environment,
            stdin=pipe,
            stdout=pipe,
            text=True,
            start_new_session=new_session,
        )

    def output_of(self, program: str, *arguments: object) -> list[str]:
        """The words that a program of python/ prints. Raises OrchestrationError if it fails."""
        process = self.start(program, *arguments)
        output, _ = process.communicate()
        if process.returncode:
            raise OrchestrationError(f"{program} failed with exit status {process.returncode}")
        return output.split()

    def timed(
        self, arguments: Sequence[str], cwd: Path | None = None, environment: Mapping[str, str] | None = None
    ) -> tuple[float, float]:
        """(wall clock, CPU of all its processes) [s] of a command. Raises OrchestrationError if it fails."""
        before, start = _children_s(), time.perf_counter()
        done = subprocess.run(
            arguments,
            cwd=cwd or self.folder,
            env=environment or self.environment,
            capture_output=True,
            text=True,
            check=False,
        )
        wall_s = time.perf_counter() - start
        if done.returncode:
            raise OrchestrationError(f"{' '.join(arguments)[-100:]} failed: {done.stderr.strip()[-500:]}")
        return wall_s, _children_s() - before

    @cached_property
    def fmus(self) -> Path:
        """A folder with the FMUs of `FIVE`."""
        self.timed([*COMMAND, "build", *FIVE, "--out", "fmus"])
        return self.folder / "fmus"


def _children_s() -> float:
    """CPU seconds of all processes that were started and have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def state(name: str, folder: Path) -> State:
    """A clone by its folder, or a revision by its name, that works in a new folder."""
    folder.mkdir()
    clone = Path(name).absolute()
    if clone.is_dir():
        return State(clone, folder, _git(clone, "describe", "--always", "--dirty").decode().strip())
    revision = _git(ROOT, "describe", "--always", name).decode().strip()
    with tarfile.open(fileobj=io.BytesIO(_git(ROOT, "archive", "--format=tar", name))) as archive:
        archive.extractall(folder / "source", filter="data")
    return State(folder / "source", folder, revision)


def _git(clone: Path, *arguments: str) -> bytes:
    done = subprocess.run(["git", "-C", str(clone), *arguments], capture_output=True, check=False)
    if done.returncode:
        reason = done.stderr.decode().strip()
        raise OrchestrationError(f"{arguments[-1]}: {reason}: expected a revision or a clone")
    return done.stdout

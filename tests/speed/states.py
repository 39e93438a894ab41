"""States of this project: a clone, or a git revision, whose files are unpacked to a folder."""

import io
import os
import subprocess
import sys
import tarfile
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
    """The files of a state, and a folder in which its programs run and keep their caches."""

    sources: Path
    folder: Path

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

    def run(self, *arguments: str) -> None:
        """Run `l1-depth`. Raises OrchestrationError if it fails."""
        done = subprocess.run(
            [*COMMAND, *arguments],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            raise OrchestrationError(f"l1-depth {' '.join(arguments)} failed: {done.stderr.strip()}")

    @cached_property
    def fmus(self) -> Path:
        """A folder with the FMUs of `FIVE`."""
        self.run("build", *FIVE, "--out", "fmus")
        return self.folder / "fmus"


def state(name: str, folder: Path) -> State:
    """A clone by its folder, or a revision by its name, that works in a new folder."""
    folder.mkdir()
    clone = Path(name).absolute()
    if clone.is_dir():
        return State(clone, folder)
    command = ["git", "-C", str(ROOT), "archive", "--format=tar", name]
    done = subprocess.run(command, capture_output=True, check=False)
    if done.returncode:
        raise OrchestrationError(f"{name}: {done.stderr.decode().strip()}: expected a revision or a folder")
    with tarfile.open(fileobj=io.BytesIO(done.stdout)) as archive:
        archive.extractall(folder / "source", filter="data")
    return State(folder / "source", folder)

"""States of this project: a clone, or a git revision, whose files are unpacked to a folder."""

import io
import json
import os
import subprocess
import sys
import tarfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from orchestration import OrchestrationError

ROOT = Path(__file__).parents[2]
HERE = Path(__file__).parent
COMMAND = (sys.executable, "-P", "-c", "from orchestration.cli import main; main()")
FIVE = ("L1DepthController", "RovDepthPlant", "L1Controller", "ExamplePlant", "DepthReference")


@dataclass(frozen=True)
class Cost:
    """Cost of a command: on the clock [s], of all processors together [s], of its largest process [bytes]."""

    wall_s: float
    cpu_s: float
    peak: float


@dataclass(frozen=True)
class State:
    """The files of a state, a folder in which its programs run and keep their caches, its git revision."""

    sources: Path
    folder: Path
    revision: str

    def cost(self, *command: str, **environment: str) -> Cost:
        """Runs a command in the folder of the state. Raises OrchestrationError if it fails."""
        return Cost(*json.loads(self._printed(HERE / "launch.py", *command, **environment)))

    def answer(self, function: str, *arguments: object) -> Any:
        """Returns what a function of inside.py measures. Raises OrchestrationError if it fails."""
        assert self.fmus
        return json.loads(self._printed(HERE / "inside.py", function, *arguments))

    def _printed(self, program: Path, *arguments: object, **environment: str) -> str:
        # the compiler's cache is beside the folders of the states, for all of them
        own = {
            "PYTHONPATH": str(self.sources),
            "PYTHONPYCACHEPREFIX": str(self.folder / "bytecode"),
            "XDG_CACHE_HOME": str(self.folder / "cache"),
            "ZIG_GLOBAL_CACHE_DIR": str(self.folder.parent / "zig"),
        }
        inherited = {name: x for name, x in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        done = subprocess.run(
            [sys.executable, "-P", str(program), *map(str, arguments)],
            cwd=self.folder,
            env={**inherited, **own, **environment},
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            what = " ".join(map(str, arguments))[-100:]
            raise OrchestrationError(f"{self.revision}: {what} failed: {done.stderr.strip()[-500:]}")
        return done.stdout

    @cached_property
    def fmus(self) -> Path:
        """A folder with the FMUs of `FIVE`, which scenarios find as well."""
        self.cost(*COMMAND, "build", *FIVE, "--cache")
        self.cost(*COMMAND, "build", *FIVE, "--out", "fmus")
        return self.folder / "fmus"


def state(name: str, folder: Path) -> State:
    """Returns a clone by its folder, or a revision by its name, that works in a new folder."""
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

"""States of this project: a git revision, unpacked to a folder, or a clone."""

import io
import os
import subprocess
import sys
import tarfile
from pathlib import Path

from orchestration.errors import OrchestrationError

ROOT = Path(__file__).parents[2]


def sources(state: str, folder: Path) -> Path:
    """The folder of a clone, or the files of a revision in a new folder below `folder`."""
    clone = Path(state).absolute()
    if clone.is_dir():
        return clone
    command = ["git", "-C", str(ROOT), "archive", "--format=tar", state]
    done = subprocess.run(command, capture_output=True, check=False)
    if done.returncode:
        raise OrchestrationError(f"{state}: {done.stderr.decode().strip()}: expected a revision or a folder")
    with tarfile.open(fileobj=io.BytesIO(done.stdout)) as archive:
        archive.extractall(folder / "source", filter="data")
    return folder / "source"


def python(program: str, source: Path, folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """A Python program with the packages of a state, whose FMUs are built below `folder`, on pipes."""
    environment = {**os.environ, "PYTHONPATH": str(source), "XDG_CACHE_HOME": str(folder / "cache")}
    return subprocess.Popen(
        [sys.executable, "-P", "-c", program, *arguments],
        cwd=folder,
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )

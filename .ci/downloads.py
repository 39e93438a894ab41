"""What users without Python take with them, made by the commands of the project.

FOLDER/fmus/NAME.fmu                  every block, for all platforms
FOLDER/ssp/SCENARIO.ssp               the closed loop as an SSP 1.0 package
"""

import functools
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

SCENARIO = "nominal-extended"
KINDS = ("fmus", "ssp")
PROGRAMS = Path(sys.executable).parent


def run(*command: str, folder: Path, **environment: str) -> list[str]:
    """The lines that a program of this environment prints; raises CalledProcessError if it fails.

    Writes the command to standard error first: the site and the archive are minutes of such commands.
    """
    print(*command, file=sys.stderr, flush=True)
    done = subprocess.run(
        [PROGRAMS / command[0], *command[1:]],
        cwd=folder,
        env=os.environ | {"MPLBACKEND": "Agg"} | environment,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return done.stdout.splitlines()


def make(folder: Path) -> None:
    """Write all of them; the first time on a machine takes about a minute."""
    fmus, ssp = folder / "fmus", folder / "ssp"
    ssp.mkdir(parents=True)
    with tempfile.TemporaryDirectory() as cache:
        l1_depth = functools.partial(run, "l1-depth", folder=folder, L1_DEPTH_FMUS=cache)
        l1_depth("build", "--cache", "--all-platforms")
        shutil.copytree(Path(cache, "native"), fmus)
        l1_depth("package", SCENARIO, "--out", str(ssp / f"{SCENARIO}.ssp"))

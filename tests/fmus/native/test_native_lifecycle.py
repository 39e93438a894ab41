"""Instances of a native FMU, one beside the other and in threads, watched by valgrind."""

import re
import subprocess
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import fmpy
import pytest

from fmus.generate import builder
from fmus.platforms import library_name

pytestmark = pytest.mark.cross


PROGRAM = Path("tests/c/lifecycle.c")
MEMCHECK = ("--error-exitcode=99", "--leak-check=full", "--errors-for-leak-kinds=all")
MOVED = {"RovDepthPlant": "voltage[1]", "L1DepthController": "measured_depth"}
BLOCKS = list(MOVED)
ALLOCATIONS = 3  # of an instance: itself, a saved state, a state from bytes


class Lifecycle:
    """The program with an FMU's library."""

    def __init__(self, program: Path, fmu: Path, folder: Path) -> None:
        description: Any = fmpy.read_model_description(str(fmu))
        fmpy.extract(str(fmu), folder)
        by_name = {v.name: v for v in description.modelVariables}
        outputs = [v for v in description.modelVariables if v.causality == "output" and v.type == "Real"]
        self._program, self._guid = program, description.guid
        self._library = folder / library_name(fmu.stem, "linux64")
        self._references = [v.valueReference for v in (by_name[MOVED[fmu.stem]], *outputs)]
        self._step = builder.load_block(fmu.stem).step_size

    def run(
        self, how: str, count: int, steps: int, under: tuple[str, ...] = ()
    ) -> subprocess.CompletedProcess[str]:
        arguments = [how, self._library, self._guid, count, steps, self._step, *self._references]
        done = subprocess.run(
            [*under, self._program, *map(str, arguments)],
            capture_output=True,
            text=True,
            check=False,
            timeout=120,
        )
        assert done.returncode == 0, done.stderr
        return done


@pytest.fixture(scope="session")
def program(c_program: Callable[[Path, str], Path]) -> Path:
    return c_program(PROGRAM, "linux64")


@pytest.fixture(params=BLOCKS)
def lifecycle(
    request: pytest.FixtureRequest, program: Path, built: Mapping[str, Path], tmp_path: Path
) -> Lifecycle:
    return Lifecycle(program, built[request.param], tmp_path)


def test_a_thousand_instances_leave_nothing_behind(lifecycle: Lifecycle, tool: Callable[[str], str]) -> None:
    """The program also checks that each restored state gives the same step. No step asks for memory."""
    memcheck = (tool("valgrind"), *MEMCHECK)
    one, thousand = (_blocks(lifecycle.run("instances", n, steps=20, under=memcheck)) for n in (1, 1000))
    # what the program and the loader need is the same
    assert thousand - one == ALLOCATIONS * 999


def _blocks(done: subprocess.CompletedProcess[str]) -> int:
    """How many blocks of memory valgrind saw, whoever asked for them."""
    match = re.search(r"total heap usage: ([\d,]+) allocs", done.stderr)
    assert match
    return int(match[1].replace(",", ""))


def test_eight_threads_do_not_disturb_each_other(lifecycle: Lifecycle) -> None:
    lifecycle.run("threads", 8, steps=50_000)


@pytest.mark.parametrize("checker", ["helgrind", "drd"])
def test_eight_threads_share_nothing_unprotected(
    lifecycle: Lifecycle, tool: Callable[[str], str], checker: str
) -> None:
    lifecycle.run(
        "threads", 8, steps=200, under=(tool("valgrind"), f"--tool={checker}", "--error-exitcode=99")
    )

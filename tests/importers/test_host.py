"""The FMUs in a host that is not Python: compiled C, on three platforms, from a plan."""

import dataclasses
import os
import subprocess
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestration.errors import OrchestrationError
from orchestration.run import simulate
from orchestration.scenarios import scenario
from orchestration.system.experiment import Algorithm, Event, Experiment
from orchestration.system.prepared_run import prepare
from orchestration.system.system import System
from tests.importers.plan import HOST, read_result, write_plan
from tests.shared_builds import Fmus

pytestmark = pytest.mark.slow


QEMU_LIBRARIES = "/usr/aarch64-linux-gnu"


@dataclasses.dataclass(frozen=True)
class Host:
    """How to run the host of a platform here."""

    program: Path
    runner: tuple[str, ...] = ()
    environment: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def run(self, plan: Path) -> np.ndarray:
        done = self.start(plan)
        assert done.returncode == 0, done.stderr
        return read_result(plan.parent / "result.bin", plan)

    def start(self, plan: Path) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*self.runner, str(self.program), str(plan), str(plan.parent / "result.bin")],
            env=os.environ | self.environment,
            cwd=plan.parent,
            capture_output=True,
            text=True,
            check=False,
            timeout=120,
        )


@pytest.fixture(scope="session")
def linux(c_program: Callable[[Path, str], Path]) -> Host:
    return Host(c_program(HOST, "linux64"))


@pytest.fixture(scope="session")
def arm(c_program: Callable[[Path, str], Path], tool: Callable[[str], str]) -> Host:
    runner = (tool("qemu-aarch64-static"), "-L", QEMU_LIBRARIES)
    return Host(c_program(HOST, "aarch64-linux"), runner)


@pytest.fixture(scope="session")
def windows(
    c_program: Callable[[Path, str], Path],
    tool: Callable[[str], str],
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Host]:
    """Wine with a configuration of its own, whose server is gone at the end."""
    environment = {
        "WINEPREFIX": str(tmp_path_factory.mktemp("wine")),
        "WINEDEBUG": "-all",
        "WINEDLLOVERRIDES": "mscoree=;mshtml=",  # asks for no download of Mono and Gecko
        "DISPLAY": "",
    }
    yield Host(c_program(HOST, "win64"), (tool("wine64"),), environment)
    # -k stops a server that is still there, and says by 1 that there was none
    subprocess.run([tool("wineserver"), "-k"], env=os.environ | environment, check=False, timeout=60)
    subprocess.run([tool("wineserver"), "-w"], env=os.environ | environment, check=True, timeout=60)


def _shipped(name: str, fmus: Fmus, **changes: Any) -> tuple[System, Experiment]:
    """A shipped scenario with the FMUs of these files, its experiment changed."""
    loaded = scenario.load(scenario.find(name))
    components = {component: fmus[path.stem] for component, path in loaded.system.components.items()}
    return System(components, loaded.system.connections), dataclasses.replace(loaded.experiment, **changes)


def _plan(system: System, experiment: Experiment, folder: Path, platform: str = "linux64") -> Path:
    return write_plan(prepare(system, experiment), folder, platform)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("nominal-extended", {}),
        ("example-extended", {}),
        # everything is recorded, and the last step is a shorter one
        ("nominal-extended", {"record": (), "start_time": 0.3, "stop_time": 2.005}),
    ],
)
def test_the_host_gives_what_the_master_gives(
    linux: Host, built: Fmus, tmp_path: Path, name: str, changes: dict[str, Any]
) -> None:
    """Bit for bit: the same library gets the same numbers in the same calls; no host computes any."""
    system, experiment = _shipped(name, built, **changes)
    result = linux.run(_plan(system, experiment, tmp_path / "a plan"))
    assert np.array_equal(result, simulate(system, experiment).values)


def test_no_python_is_loaded(linux: Host, built: Fmus, tmp_path: Path) -> None:
    """What the dynamic linker opens, as it tells itself."""
    plan = _plan(*_shipped("nominal-extended", built), tmp_path)
    log = dataclasses.replace(linux, environment={"LD_DEBUG": "files"}).start(plan).stderr
    opened = {Path(line.split()[-1]).name for line in log.splitlines() if "calling init:" in line}
    assert opened >= {"RovDepthPlant.so", "L1DepthController.so"}
    system = {"libc.so.6", "libm.so.6", "libdl.so.2", "libpthread.so.0", "ld-linux-x86-64.so.2"}
    assert opened <= system | {"RovDepthPlant.so", "L1DepthController.so"}


def test_a_run_is_clean_under_valgrind(
    linux: Host, built: Fmus, tmp_path: Path, tool: Callable[[str], str]
) -> None:
    plan = _plan(*_shipped("nominal-extended", built, stop_time=5.0), tmp_path)
    options = ("--error-exitcode=99", "--leak-check=full", "--errors-for-leak-kinds=all")
    dataclasses.replace(linux, runner=(tool("valgrind"), *options)).run(plan)


# C libraries differ in the last bit of exp, log, pow and cos: 1e-16 of a value. The vehicle's loop damps
# that away; the example's, with its large adaptation gain, makes 8e-13 of it.
ANOTHER_C_LIBRARY = 1e-12


@pytest.mark.parametrize("name", ["nominal-extended", "example-extended"])
@pytest.mark.parametrize(("platform", "host"), [("aarch64-linux", "arm"), ("win64", "windows")])
def test_another_platform_gives_the_same(
    linux: Host,
    built_everywhere: Fmus,
    tmp_path: Path,
    request: pytest.FixtureRequest,
    platform: str,
    host: str,
    name: str,
) -> None:
    """Up to the last bits of the elementary functions, which each C library computes in its own way."""
    system, experiment = _shipped(name, built_everywhere)
    expected = linux.run(_plan(system, experiment, tmp_path / "linux"))
    values = request.getfixturevalue(host).run(_plan(system, experiment, tmp_path / "other", platform))
    assert np.all(np.abs(values - expected) <= ANOTHER_C_LIBRARY * np.abs(expected).max(axis=0))


def test_what_the_host_cannot_do_is_refused(built: Fmus, tmp_path: Path) -> None:
    for changes, words in (
        ({"algorithm": Algorithm.GAUSS_SEIDEL}, "a plan with algorithm gauss-seidel: expected none"),
        ({"events": (Event(1.0, {"plant.inertia": 7.0}),)}, "a plan with events: expected none"),
    ):
        with pytest.raises(OrchestrationError, match=words):
            _plan(*_shipped("nominal-extended", built, **changes), tmp_path)


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("jump 1", "cannot understand: jump 1"),
        ("component it {0} /nowhere/It.so", "cannot load: /nowhere/It.so"),
        ("connect 0 1 0 2", "no component of that number"),
        ("table 3 /nowhere", "cannot read the table: /nowhere"),
        ("", "expected a table"),
    ],
)
def test_a_plan_that_is_wrong_ends_the_host_with_one_line(
    linux: Host, tmp_path: Path, lines: str, words: str
) -> None:
    plan = tmp_path / "plan.txt"
    plan.write_text(lines)
    done = linux.start(plan)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert words in done.stderr

"""An FMU forks its process, and the child returns from the call: no result is that of another request."""

import contextlib
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import psutil
import pytest

from orchestration.errors import OrchestrationError
from orchestration.many.job import Failure
from orchestration.many.local_runs import LocalRuns
from orchestration.many.run_many import in_order
from orchestration.results.recording import Recording
from orchestration.run import Simulator, simulate
from orchestration.scenarios import scenario
from orchestration.studies.score.closed_loop import ClosedLoop, ClosedLoopRun, Controller
from orchestration.studies.score.protocol import read_protocol
from orchestration.sweep import table
from orchestration.sweep.plan import plan
from orchestration.sweep.run import sweep
from orchestration.system.experiment import Experiment
from orchestration.system.system import System
from tests.foreign_fmus import FORKING_CALLS
from tests.shared_builds import Build

CAUSE = "and the child returned from the call; expected a child that calls _exit or exec"
STEP = "fmi2DoStep"
FORKS = [
    pytest.param(call, waits, marks=[pytest.mark.slow] if waits == "parent" and call != STEP else [])
    for call in FORKING_CALLS
    for waits in ("child", "parent")
]
TO_END_S = 30.0  # for killed processes, on a machine that is busy
# y' = u from 0 for 1 s, so that y ends at u
SWEEP = """
[components]
f = "{fmu}"
[experiment]
stop_time = 1.0
step_size = 0.1
[inputs]
"f.u" = 1.0
[metrics.end]
function = "peak"
signal = "f.y"
[sweep.vary."f.u"]
values = [1.0, 2.0, 3.0, 4.0]
"""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of all temporary files; no process that has it for its own is left afterwards."""
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    yield tmp_path
    limit = time.monotonic() + TO_END_S
    while left := processes_of(temporary):
        assert time.monotonic() < limit, left
        time.sleep(0.05)


def processes_of(temporary: Path) -> list[psutil.Process]:
    """Those that run and keep their temporary files inside a folder, whoever started them."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            inside = process.environ().get("TMPDIR", "").startswith(str(temporary))
            found += [process] if inside and process.status() != psutil.STATUS_ZOMBIE else []
    return found


@pytest.mark.parametrize(
    ("call", "waits"), [("fmi2Instantiate", "child"), (STEP, "parent"), ("fmi2Reset", "child")]
)
def test_each_sample_has_its_own_metrics_or_the_cause(
    forker: Build, folder: Path, call: str, waits: str
) -> None:
    path = folder / "forks.toml"
    path.write_text(SWEEP.format(fmu=forker(call, waits)))
    swept = sweep(plan(scenario.load(path)), folder / "results", LocalRuns(1))
    rows = table.read(swept)[0].to_pylist()
    assert [row["f.u"] for row in rows] == [1.0, 2.0, 3.0, 4.0]
    for row in rows:
        assert row["error"] or row["end"] == pytest.approx(row["f.u"], rel=1e-12)  # ten sums
        assert not row["error"] or CAUSE in row["error"]
    assert any(row["error"] for row in rows)


@pytest.mark.parametrize(("call", "waits"), [fork for fork in FORKS if fork.values[0] != "fmi2Reset"])
def test_a_run_ends_with_the_cause_and_its_child(forker: Build, call: str, waits: str) -> None:
    """With a timeout, than which its one step takes less, and in this process: there the child would go on
    with the program that called `simulate`.
    """
    system, experiment = System({"f": forker(call, waits)}), Experiment(0.1, 0.1, inputs={"f.u": 2.0})
    others = {*psutil.Process().children()}  # of tests before, such as a tracker of shared memory
    with pytest.raises(OrchestrationError, match=CAUSE):
        simulate(system, experiment, timeout=TO_END_S)
    with pytest.raises(OrchestrationError, match=f"f forked its process {CAUSE}"):
        simulate(system, experiment)
    for child in {*psutil.Process().children()} - others:
        child.wait(TO_END_S)  # nobody else does, and it would stay a zombie of the tests that follow


@pytest.mark.parametrize("child", ["exits", "becomes"])
@pytest.mark.parametrize("call", ["fmi2Instantiate", STEP])
def test_a_child_that_does_not_return_is_no_error(forker: Build, call: str, child: str) -> None:
    system = System({"f": forker(call, "child", child=child)})
    recording = simulate(system, Experiment(1.0, 0.1, inputs={"f.u": -2.0}))
    assert recording["f.y"].tolist() == pytest.approx((-2.0 * recording.time).tolist(), rel=1e-12)


def test_a_fork_is_the_fault_of_its_own_run_alone(forker: Build, linear: Build) -> None:
    """The one that another run of this process ends with is neither of a run before nor of one after."""
    forking = System({"f": forker(STEP, "child")})
    with Simulator(System({"one": linear()})) as simulator:
        run = simulator.start(Experiment(1.0, 0.1, inputs={"one.u[1]": 1.0}))
        with pytest.raises(OrchestrationError, match=f"f forked its process {CAUSE}"):
            simulate(forking, Experiment(1.0, 0.1, inputs={"f.u": 1.0}))
        while not run.is_done:
            run.step()
        assert len(run.recording().time) == 11


def number_of(signals: Recording, number: int) -> int:
    """Returns the number, whatever the run gave."""
    return number


@pytest.mark.parametrize("waits", ["child", pytest.param("parent", marks=pytest.mark.slow)])
def test_each_case_of_a_score_has_the_cause(forker: Build, vehicle_fmus: None, waits: str) -> None:
    names = {"depth_reference": "u", "control_force": "y"}
    controller = Controller("forker", str(forker(STEP, waits)), mapping=names)
    protocol = read_protocol()
    runs = [ClosedLoopRun(protocol.nominal, partial(number_of, number=i)) for i in range(2)]
    with LocalRuns(1, isolate=True) as place:
        loop = ClosedLoop(controller, protocol, partial(in_order, place), protocol.tables.time_limit)
        for result in loop.results(runs):
            assert isinstance(result, Failure)
            assert CAUSE in result.reason

"""An FMU forks its process, and the child returns from the call: no result is that of another request."""

import contextlib
import os
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
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
QUICK = STEP, "fmi2Instantiate"
FORKS = [
    pytest.param(
        call, waits, marks=[] if call in QUICK and (waits == "child" or call == STEP) else [pytest.mark.slow]
    )
    for call in FORKING_CALLS
    for waits in ("child", "parent")
]
TO_END_S = 30.0  # for killed processes, on a machine that is busy
# y' = u from 0 for 1 s, so that y ends at u
SWEEP = """
[components]
f = '{fmu}'
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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("call", "waits"),
    [
        ("fmi2Instantiate", "child"),
        *(pytest.param(*row, marks=pytest.mark.slow) for row in ((STEP, "parent"), ("fmi2Reset", "child"))),
    ],
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


@pytest.mark.slow
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


@pytest.mark.parametrize("first", ["exits", "returns"])
def test_each_of_two_children_of_one_step_is_judged(forker: Build, first: str) -> None:
    """The one that ends does not hide the one that returns, whichever the FMUs fork first."""
    children = {"one": first, "two": "exits" if first == "returns" else "returns"}
    system = System({name: forker(STEP, "child", child=child) for name, child in children.items()})
    with pytest.raises(OrchestrationError, match=f" forked its process {CAUSE}"):
        simulate(system, Experiment(0.1, 0.1, inputs={"one.u": 1.0, "two.u": 1.0}))


def test_signals_do_not_hide_a_child_that_returns(forker: Build) -> None:
    """They interrupt the wait of the parent for the child, which takes 0.1 s."""
    before = signal.signal(signal.SIGALRM, lambda number, frame: None)
    signal.setitimer(signal.ITIMER_REAL, 0.01, 0.01)
    try:
        with pytest.raises(OrchestrationError, match=CAUSE):
            simulate(System({"f": forker(STEP, "child")}), Experiment(0.1, 0.1, inputs={"f.u": 1.0}))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("child", ["returns", "exits"])
def test_a_fork_leaves_no_file_open(forker: Build, child: str) -> None:
    system = System({"f": forker(STEP, "child", child=child)})
    experiment = Experiment(0.2, 0.1, inputs={"f.u": 1.0})
    numbers = []
    for _ in range(3):  # what a first run opens stays open
        with contextlib.suppress(OrchestrationError):
            simulate(system, experiment)
        numbers.append(psutil.Process().num_fds())
    assert numbers[1] == numbers[2]


def forked(child_of: Callable[[], bool]) -> int:
    """Returns the exit status of a forked process: 7 where a function is true in it, 1 where it is not."""
    child = os.fork()
    if child == 0:
        status = 1
        try:
            status = 7 if child_of() else 1
        finally:
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def test_a_process_that_the_program_forks_between_steps_goes_on(linear: Build) -> None:
    with Simulator(System({"one": linear()})) as simulator:
        run = simulator.start(Experiment(0.3, 0.1, inputs={"one.u[1]": 1.0}))
        run.step()
        before = psutil.Process().num_fds()

        def goes_on() -> bool:
            run.step()
            return run.time == pytest.approx(0.2)

        assert forked(goes_on) == 7
        assert psutil.Process().num_fds() == before
        assert goes_on()


@pytest.mark.slow
def test_forks_of_a_thread_that_calls_no_fmu_are_left_alone(linear: Build) -> None:
    """While an FMU is busy in another thread."""
    statuses, numbers = [], []
    with Simulator(System({"one": linear()})) as simulator:
        for count in (0, 10):
            forks = threading.Thread(target=lambda n=count: statuses.extend(forked(bool) for _ in range(n)))
            forks.start()
            while forks.is_alive():
                simulator.run(Experiment(10.0, 0.01, inputs={"one.u[1]": 1.0}))
            forks.join()
            numbers.append(psutil.Process().num_fds())  # what a first thread opens stays open
    assert statuses == 10 * [1]
    assert numbers[0] == numbers[1]


def number_of(signals: Recording, number: int) -> int:
    """Returns the number, whatever the run gave."""
    return number


@pytest.mark.slow
@pytest.mark.parametrize("waits", ["child", "parent"])
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

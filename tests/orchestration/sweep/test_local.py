"""A sweep on this machine without a cluster: threads or processes, one or several, the rows are the same."""

import threading
from collections.abc import Callable, Mapping
from itertools import count
from pathlib import Path

import psutil
import pytest

from fmus.fmi_types import FmiValue
from orchestration.errors import OrchestrationError, SweepError
from orchestration.results import metrics
from orchestration.results.recording import Recording
from orchestration.scenarios import scenario
from orchestration.sweep import table
from orchestration.sweep.ensemble import ensemble
from orchestration.sweep.local import LocalWorkers, local
from orchestration.sweep.plan import Plan, plan
from orchestration.sweep.run import sweep
from orchestration.sweep.samples import Job, Outcome
from orchestration.sweep.workers import Batches

Make = Callable[..., Plan]
COUNT = 30
VEHICLE = f"""
base = "nominal-extended"
[experiment]
stop_time = 4.0
[metrics]
settling_time = false
overshoot = false
holding_thrust = false
lag = false
[metrics.first]
function = "mean"
signal = "plant.measured_depth"
[sweep]
samples = {COUNT}
[sweep.vary."plant.sensor_seed"]
distribution = "seed"
[sweep.vary."plant.inertia"]
distribution = "uniform"
low = 5.0
high = 6.0
"""


def children() -> set[psutil.Process]:
    return set(psutil.Process().children(recursive=True))


@pytest.fixture
def vehicle(tmp_path: Path) -> Plan:
    path = tmp_path / "mine.toml"
    path.write_text(VEHICLE)
    return plan(scenario.load(path))


def swept(made: Plan, folder: Path, workers: int, isolated: bool = False) -> tuple[bytes, int]:
    """The table, and how many processes ran samples."""
    before, started = children(), set()
    path = sweep(
        made, folder, local(workers, isolated), progress=lambda done: started.update(children() - before)
    )
    assert children() <= before
    return path.read_bytes(), len(started)


def test_one_thread_and_three_give_the_same_bytes(vehicle: Plan, tmp_path: Path) -> None:
    expected = swept(vehicle, tmp_path / "one", 1)
    assert swept(vehicle, tmp_path / "three", 3) == expected
    assert expected[1] == 0
    rows = table.read(tmp_path / "one" / "mine.sweep.parquet")[0].to_pylist()
    assert len({row["rmse"] for row in rows}) == COUNT


@pytest.mark.cluster
def test_processes_give_the_bytes_of_threads(vehicle: Plan, tmp_path: Path) -> None:
    expected, _ = swept(vehicle, tmp_path / "threads", 2)
    assert swept(vehicle, tmp_path / "apart", 2, isolated=True) == (expected, 2)


def test_what_was_done_before_an_interrupt_is_not_run_again(vehicle: Plan, tmp_path: Path) -> None:
    done: list[int] = []

    def interrupt(more: int) -> None:
        done.append(more)
        if sum(done) >= COUNT // 3:
            raise KeyboardInterrupt

    before = threading.active_count()
    with pytest.raises(KeyboardInterrupt):
        sweep(vehicle, tmp_path / "again", local(2), progress=interrupt)
    assert threading.active_count() == before
    assert COUNT // 3 <= sum(done) < COUNT
    more: list[int] = []
    path = sweep(vehicle, tmp_path / "again", local(2), progress=more.append)
    assert (more[0], sum(more)) == (sum(done), COUNT)
    assert path.read_bytes() == sweep(vehicle, tmp_path / "once", local(1)).read_bytes()


@pytest.mark.cluster
@pytest.mark.parametrize("lines", ["", "timeout = 60\n"])
def test_foreign_fmus_and_samples_with_a_timeout_have_a_process(
    planned: Make, vehicle: Plan, tmp_path: Path, lines: str
) -> None:
    """A crash of the foreign one is a row, and the next sample runs."""
    if lines:
        path = tmp_path / "timed.toml"
        path.write_text(VEHICLE.replace("[sweep]", f"[sweep]\n{lines}").replace(f"= {COUNT}", "= 2"))
        made, errors = plan(scenario.load(path)), [None, None]
    else:
        made = planned('[sweep.vary."r.misdeed"]\nvalues = ["segfault", "none"]\n')
        errors = ["the worker process ended: SIGSEGV", None]
    before, started = children(), set()
    path = sweep(made, tmp_path, local(1), progress=lambda done: started.update(children() - before))
    assert table.read(path)[0]["error"].to_pylist() == errors
    assert started


def test_a_sample_that_fails_in_a_thread_is_a_row_and_the_next_one_runs(
    vehicle: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The FMU refuses an inertia that the plan would not draw."""
    refused: list[dict[str, FmiValue]] = [{"plant.inertia": -1.0}, {"plant.inertia": 5.5}]
    monkeypatch.setattr(Plan, "block", lambda plan, numbers: [refused[number] for number in numbers])
    monkeypatch.setattr(Plan, "settings", lambda plan, values: {"parameters": values})
    outcomes: list[Outcome] = []
    for finished in LocalWorkers(1).run(vehicle, Job.of(vehicle, None), Batches(range(2), 2)):
        outcomes += finished.outcomes
    assert "plant.inertia = -1.0: expected" in (outcomes[0].error or "")
    assert (outcomes[1].error, len(outcomes[1].metrics)) == (None, 4)


@pytest.mark.filterwarnings("ignore:plant is Plant.fmu")
@pytest.mark.parametrize("isolated", [False, pytest.param(True, marks=pytest.mark.cluster)])
def test_a_file_that_is_replaced_meanwhile_changes_no_sample(
    built: Mapping[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, isolated: bool
) -> None:
    """The FMUs are loaded again after the second sample, which fails."""
    fmu = tmp_path / "Plant.fmu"
    fmu.write_bytes(built["RovDepthPlant"].read_bytes())
    (tmp_path / "mine.toml").write_text(f"{VEHICLE}\n[components]\nplant = '{fmu}'\n")
    made = plan(scenario.load(tmp_path / "mine.toml"))
    inertias: list[dict[str, FmiValue]] = [{"plant.inertia": inertia} for inertia in (5.5, -1.0, 5.5)]
    monkeypatch.setattr(Plan, "block", lambda plan, numbers: [inertias[number] for number in numbers])
    monkeypatch.setattr(Plan, "settings", lambda plan, values: {"parameters": values})
    outcomes: list[Outcome] = []
    for finished in LocalWorkers(1, isolated).run(made, Job.of(made, None), Batches(range(3), 3)):
        outcomes += finished.outcomes
        fmu.write_bytes(b"no FMU")
    assert "plant.inertia = -1.0: expected" in (outcomes[1].error or "")
    assert outcomes[0].metrics == outcomes[2].metrics
    assert [outcome.error is None for outcome in outcomes] == [True, False, True]


def test_a_batch_ends_after_its_time_and_the_rest_is_run_in_others(vehicle: Plan) -> None:
    """By this clock a sample takes 1 ms, and from the third one on 0.15 s and more."""
    readings = count()

    def clock() -> float:
        reading = next(readings)
        return 0.001 * reading if reading < 5 else 0.15 * reading

    batches, numbers = [], []
    for finished in LocalWorkers(1, clock=clock).run(vehicle, Job.of(vehicle, None), Batches(range(9), 9)):
        batches.append(len(finished.numbers))
        numbers += finished.numbers
        assert len(finished.numbers) == len(finished.values) == len(finished.outcomes)
    assert batches == [1, 2, *[1] * 6]  # the second was of three
    assert sorted(numbers) == list(range(9))


def test_batches_grow_to_a_quarter_of_a_second_and_end_at_about_the_same_time() -> None:
    batches = Batches(range(1000), 1000)
    assert len(batches.take(2)) == 1  # nobody knows yet how long one takes
    batches.note(1, 0.01)
    assert len(batches.take(2)) == 25
    batches.note(25, 0.0025)
    assert len(batches.take(2)) == 163  # a third of what is left for each
    rest = []
    while batch := batches.take(2):
        rest += batch
    assert rest == list(range(1 + 25 + 163, 1000))


def test_what_is_left_of_a_batch_is_handed_out_again_first() -> None:
    batches = Batches(range(10), 10)
    batches.note(1, 0.001)
    assert batches.take(1) == [0, 1, 2, 3]
    batches.note(1, 0.001, [1, 2, 3])
    assert batches.left == 9
    assert batches.take(1) == [1, 2, 3]
    assert batches.take(1) == [4, 5]


def test_a_batch_of_groups_is_whole_groups_until_the_last() -> None:
    batches = Batches(range(100), 100)
    assert len(batches.take(1, 16)) == 16
    batches.note(16, 2.0)  # a group takes as long as two batches may
    assert len(batches.take(1, 16)) == 16
    batches.note(16, 0.16)
    assert len(batches.take(1, 8)) == 16  # of the 23 that are a third of what is left
    assert [len(batches.take(1, 32)) for _ in range(3)] == [32, 20, 0]


def test_a_restart_that_cannot_run_discards_nothing(vehicle: Plan, tmp_path: Path) -> None:
    path = sweep(vehicle, tmp_path, local(1))
    before = path.read_bytes()
    with pytest.raises(SweepError, match="no recordings and no timeout"):
        sweep(vehicle, tmp_path, ensemble(1), recorded=(), restart=True)
    assert path.read_bytes() == before
    done: list[int] = []
    assert sweep(vehicle, tmp_path, local(1), restart=True, progress=done.append).read_bytes() == before
    assert (done[0], sum(done)) == (0, COUNT)


@pytest.mark.slow
def test_an_ensemble_gives_the_same_table(
    vehicle: Plan, tmp_path: Path, scenario_fmus: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where a metric fails, here of half the samples by the sign of the noise: each is run alone."""

    def refuse_positive(recording: Recording, signal: str) -> float:
        if recording[signal][0] > 0.0:
            raise OrchestrationError("positive")
        return 0.0

    monkeypatch.setitem(metrics.FUNCTIONS, "mean", refuse_positive)
    batches: list[int] = []
    together = sweep(vehicle, tmp_path / "together", ensemble(2), progress=batches.append)
    assert batches == [0, 16, 14]  # the vectors of two threads at least
    errors = table.read(together)[0]["error"].to_pylist()
    assert set(errors) == {None, "metric first: positive"}
    assert together.read_bytes() == swept(vehicle, tmp_path / "threads", 2)[0]

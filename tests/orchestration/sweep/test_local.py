"""A sweep on this machine without a cluster: threads, processes or ensembles, the rows are the same."""

import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from itertools import count
from pathlib import Path

import psutil
import pytest

from fmus.fmi.variable_types import FmiValue
from orchestration.errors import EnsembleError, OrchestrationError
from orchestration.many import ensemble, local_runs, runners
from orchestration.many.job import Batches, Failure, Finished, Run
from orchestration.many.local_runs import LocalRuns
from orchestration.results import metrics
from orchestration.results.recording import Recording, run_by_run
from orchestration.scenarios import scenario
from orchestration.sweep import table
from orchestration.sweep.plan import Plan, plan
from orchestration.sweep.run import job_of, samples_of, sweep
from orchestration.system.experiment import Experiment

Make = Callable[..., Plan]
COUNT = 30
ANY = Experiment(1.0, 0.1)
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
        made,
        folder,
        LocalRuns(workers, isolated, vectorise=False),
        progress=lambda done: started.update(children() - before),
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
        sweep(vehicle, tmp_path / "again", LocalRuns(2, vectorise=False), progress=interrupt)
    assert threading.active_count() == before
    assert COUNT // 3 <= sum(done) < COUNT
    more: list[int] = []
    path = sweep(vehicle, tmp_path / "again", LocalRuns(2, vectorise=False), progress=more.append)
    assert (more[0], sum(more)) == (sum(done), COUNT)
    assert path.read_bytes() == swept(vehicle, tmp_path / "once", 1)[0]


@pytest.mark.slow
def test_a_row_names_the_fmus_that_warned_in_its_sample_alone(planned: Make, tmp_path: Path) -> None:
    made = planned('[sweep.vary."r.misdeed"]\nvalues = ["none", "warning", "none", "error"]\n')
    rows = table.read(sweep(made, tmp_path, LocalRuns(1)))[0]
    assert rows["warned"].to_pylist() == [None, "r", None, None]
    assert table.names(rows.schema, "warned") == ["warned"]


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
    path = sweep(made, tmp_path, LocalRuns(1), progress=lambda done: started.update(children() - before))
    assert table.read(path)[0]["error"].to_pylist() == errors
    assert started


def made_in_a_thread(made: Plan, count: int) -> list[Finished]:
    job = job_of(made, None)
    batches = Batches(samples_of(made, job.base, range(count)), count)
    with LocalRuns(1, vectorise=False) as place:
        return [one for finished in place.runs(job, batches) for one in finished]


def failed(finished: Finished) -> str:
    assert isinstance(finished.done.result, Failure)
    return finished.done.result.reason


def test_a_sample_that_fails_in_a_thread_is_a_row_and_the_next_one_runs(
    vehicle: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The FMU refuses an inertia that the plan would not draw."""
    refused: list[dict[str, FmiValue]] = [{"plant.inertia": -1.0}, {"plant.inertia": 5.5}]
    monkeypatch.setattr(Plan, "block", lambda plan, numbers: [refused[number] for number in numbers])
    first, second = made_in_a_thread(vehicle, 2)
    assert "plant.inertia = -1.0: expected" in failed(first)
    assert len(second.done.result.metrics) == 4


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
    job, finished = job_of(made, None), list[Finished]()
    batches = Batches(samples_of(made, job.base, range(3)), 3)
    with LocalRuns(1, isolated, vectorise=False) as place:
        for more in place.runs(job, batches):
            finished += more
            fmu.write_bytes(b"no FMU")
    first, second, third = finished
    assert "plant.inertia = -1.0: expected" in failed(second)
    assert first.done.result == third.done.result


def test_a_batch_ends_after_its_time_and_the_rest_is_run_in_others(
    vehicle: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By this clock a sample takes 1 ms, and from the third one on 0.15 s and more."""
    readings = count()

    def clock() -> float:
        reading = next(readings)
        return 0.001 * reading if reading < 5 else 0.15 * reading

    job, numbers, lengths = job_of(vehicle, None), list[int](), list[int]()
    batches = Batches(samples_of(vehicle, job.base, range(9)), 9)
    for module in (local_runs, runners):
        monkeypatch.setattr(module, "perf_counter", clock)
    with LocalRuns(1, vectorise=False) as place:
        for finished in place.runs(job, batches):
            lengths.append(len(finished))
            numbers += [one.key.number for one in finished]
    assert lengths == [1, 2, *[1] * 6]  # the second was of three
    assert sorted(numbers) == list(range(9))


def numbered(numbers: Iterable[int]) -> list[Run]:
    return [Run(number, ANY, list) for number in numbers]


def test_batches_grow_to_a_quarter_of_a_second_and_end_at_about_the_same_time() -> None:
    batches = Batches(numbered(range(1000)), 1000)
    assert len(batches.take(2)) == 1  # nobody knows yet how long one takes
    batches.note(1, 0.01)
    assert len(batches.take(2)) == 25
    batches.note(25, 0.0025)
    assert len(batches.take(2)) == 163  # a third of what is left for each
    rest = []
    while batch := batches.take(2):
        rest += batch
    assert rest == numbered(range(1 + 25 + 163, 1000))


def test_what_is_left_of_a_batch_is_handed_out_again_first() -> None:
    batches = Batches(numbered(range(10)), 10)
    batches.note(1, 0.001)
    assert batches.take(1) == numbered([0, 1, 2, 3])
    batches.note(1, 0.001, numbered([1, 2, 3]))
    assert batches.left == 9
    assert batches.take(1) == numbered([1, 2, 3])
    assert batches.take(1) == numbered([4, 5])


def test_a_batch_of_groups_is_whole_groups_until_the_last() -> None:
    batches = Batches(numbered(range(100)), 100)
    assert len(batches.take(1, 16)) == 16
    batches.note(16, 2.0)  # a group takes as long as two batches may
    assert len(batches.take(1, 16)) == 16
    batches.note(16, 0.16)
    assert len(batches.take(1, 8)) == 16  # of the 23 that are a third of what is left
    assert [len(batches.take(1, 32)) for _ in range(3)] == [32, 20, 0]


def test_a_batch_of_groups_has_at_most_the_samples_that_it_may_have() -> None:
    batches = Batches(numbered(range(1000)), 1000)
    batches.note(1, 1e-6)
    assert [len(batches.take(1, 8, most)) for most in (8, 64, 333)] == [8, 64, 304]


def test_a_restart_that_cannot_run_discards_nothing(vehicle: Plan, tmp_path: Path) -> None:
    alone = LocalRuns(1, vectorise=False), LocalRuns(1, vectorise=False)
    path = sweep(vehicle, tmp_path, alone[0])
    before = path.read_bytes()
    scenario = replace(vehicle.scenario, experiment=replace(vehicle.scenario.experiment, tolerance=1e-4))
    with pytest.raises(EnsembleError, match="tolerance: an Ensemble does not"):
        sweep(replace(vehicle, scenario=scenario), tmp_path, LocalRuns(1, vectorise=True), restart=True)
    assert path.read_bytes() == before
    done: list[int] = []
    assert sweep(vehicle, tmp_path, alone[1], restart=True, progress=done.append).read_bytes() == before
    assert (done[0], sum(done)) == (0, COUNT)


def made_of(tmp_path: Path, text: str) -> Plan:
    path = tmp_path / "other.toml"
    path.write_text(text)
    return plan(scenario.load(path))


def note_of(made: Plan, workers: int) -> str:
    """What is said of where the samples run, before the first does."""

    def stop(note: str) -> None:
        raise KeyboardInterrupt(note)

    with pytest.raises(KeyboardInterrupt) as said, LocalRuns(workers, note=stop) as place:
        next(place.runs(job_of(made, None), Batches([], made.count)))
    return str(said.value)


def varying(name: str, low: float, high: float) -> str:
    """Another variable in place of the inertia."""
    varied = VEHICLE.replace("plant.inertia", name)
    return varied.replace("low = 5.0", f"low = {low}").replace("high = 6.0", f"high = {high}")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (varying("experiment.step_size", 0.01, 0.02), "experiment.step_size is varied"),
        (varying("plant.internal_step", 0.01, 0.02), "plant.internal_step is varied"),
        (VEHICLE.replace("stop_time", "tolerance = 1e-4\nstop_time"), "tolerance: an Ensemble does not"),
        (VEHICLE.replace(f"= {COUNT}", "= 7"), "7 runs are less than the 8 that step at once"),
        (VEHICLE.replace("stop_time = 4.0", "stop_time = 3e4"), "8 runs at once record"),
        (VEHICLE.replace(f"= {COUNT}", "= 8"), "compiling the FMUs takes longer than it saves in 1600 steps"),
    ],
)
def test_where_an_ensemble_cannot_run_samples_or_does_not_pay_simulators_do(
    text: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is compiled for these."""
    monkeypatch.setattr(ensemble, "is_compiled", lambda *_: False)
    assert reason in note_of(made_of(tmp_path, text), 1)


def test_threads_share_the_memory_of_recordings(tmp_path: Path) -> None:
    """Of these samples one group fits, not two."""
    made = made_of(tmp_path, VEHICLE.replace("stop_time = 4.0", "stop_time = 1.5e4"))
    assert "16 runs at once record 480 MB" in note_of(made, 2)


def test_the_note_says_what_runs_the_samples(planned: Make, tmp_path: Path) -> None:
    """A foreign FMU in a process; an ensemble that is asked for is refused."""
    reason = "r is no native FMU that l1-depth build wrote for this user"
    assert note_of(planned(), 1) == f"1 processes, runs one by one: {reason}"
    with pytest.raises(EnsembleError, match=reason):
        sweep(planned(), tmp_path, LocalRuns(1, vectorise=True), restart=True)


@pytest.mark.slow
def test_ensembles_give_the_same_table(
    vehicle: Plan, tmp_path: Path, scenario_fmus: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where a metric fails, here of half the samples by the sign of the noise: each is run alone."""

    @run_by_run
    def refuse_positive(recording: Recording, signal: str) -> float:
        if recording[signal][0] > 0.0:
            raise OrchestrationError("positive")
        return 0.0

    monkeypatch.setitem(metrics.FUNCTIONS, "mean", refuse_positive)
    monkeypatch.setattr(ensemble, "is_compiled", lambda *_: True)
    batches: list[int] = []
    notes: list[str] = []
    path = sweep(vehicle, tmp_path / "together", LocalRuns(2, note=notes.append), progress=batches.append)
    assert notes == ["2 threads, runs in ensembles"]
    assert sorted(batches) == [0, 6, 8, 8, 8]  # groups, until the last
    errors = table.read(path)[0]["error"].to_pylist()
    assert set(errors) == {None, "metric first: positive"}
    assert path.read_bytes() == swept(vehicle, tmp_path / "threads", 2)[0]


@pytest.mark.slow
def test_simulators_continue_what_ensembles_began(vehicle: Plan, tmp_path: Path, scenario_fmus: None) -> None:
    """The table is that of a sweep in one go."""

    def interrupt(more: int) -> None:
        if more:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sweep(vehicle, tmp_path / "again", LocalRuns(1, vectorise=True), progress=interrupt)
    done: list[int] = []
    path = sweep(vehicle, tmp_path / "again", LocalRuns(1, vectorise=False), progress=done.append)
    assert (done[0], sum(done)) == (8, COUNT)
    assert path.read_bytes() == swept(vehicle, tmp_path / "once", 1)[0]

"""A sweep on a real scheduler with several worker processes: whatever befalls them, the rows are the same."""

import importlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil
import pytest
from dask import config
from distributed import Client

from orchestration.errors import SweepError
from orchestration.many import ensemble
from orchestration.many.places import place_of
from orchestration.many.run_many import run_many
from orchestration.places import cluster
from orchestration.places.cluster import ClusterRuns
from orchestration.results.recording import Recording
from orchestration.run import simulate
from orchestration.scenarios import scenario
from orchestration.sweep import run as running
from orchestration.sweep import table
from orchestration.sweep.plan import Plan
from tests.local_cluster import local_cluster

pytestmark = pytest.mark.cluster


Make = Callable[..., Plan]
Started = tuple[Client, ClusterRuns]
COUNT = 60
SWEEP = f"""
[sweep]
samples = {COUNT}
seed = 7
timeout = 20
[sweep.vary."r.u"]
distribution = "uniform"
low = 1.0
high = 3.0
[sweep.vary."r.misdeed_time"]
distribution = "uniform"
low = 0.2
high = 0.8
[sweep.vary."r.misdeed"]
distribution = "choice"
values = ["none", "error"]
weights = [3, 1]
"""


DEADLY = """
import os, signal
import cloudpickle
from orchestration.places import cluster

def run_batch(plugin, pickled):
    if any(changes[1]["inputs"]["r.u"] == 3 for changes, _ in cloudpickle.loads(pickled)):
        os.kill(os.getpid(), signal.SIGKILL)
    return cluster.run_batch(plugin, pickled)
"""


HASTY = """
from orchestration.places import cluster

def run_batch(plugin, pickled):
    done, seconds = cluster.run_batch(plugin, pickled)
    return done[:1], seconds
"""


def threads(client: Client) -> dict[str, int]:
    """Of each worker, by its address."""
    numbers: Any = client.nthreads()
    return numbers


def swept(
    made: Plan,
    started: Started,
    folder: Path,
    progress: Callable[[int], object] = lambda done: None,
    recorded: tuple[str, ...] | None = None,
) -> Path:
    return running.sweep(made, folder, nullcontext(started[1]), recorded, progress=progress)


@pytest.fixture
def by_two(planned: Make, tmp_path: Path) -> tuple[Plan, bytes]:
    """A plan, and its table by two undisturbed workers."""
    made = planned(SWEEP)
    with local_cluster(2) as started:
        return made, swept(made, started, tmp_path / "two").read_bytes()


def test_one_two_and_four_workers_give_the_same_bytes(by_two: tuple[Plan, bytes], tmp_path: Path) -> None:
    made, expected = by_two
    for workers in (1, 4):
        with local_cluster(workers) as started:
            assert len(threads(started[0])) == workers
            assert swept(made, started, tmp_path / str(workers)).read_bytes() == expected
    samples, _ = table.read(tmp_path / "4" / "mine.sweep.parquet")
    rows = samples.to_pylist()
    assert [row["sample"] for row in rows] == list(range(COUNT))
    for row in rows:
        assert {name: row[name] for name in made.values(row["sample"])} == made.values(row["sample"])
        assert (row["error"] is None) == (row["r.misdeed"] == "none")
    assert {row["error"] is None for row in rows} == {True, False}


def test_a_killed_worker_loses_nothing(by_two: tuple[Plan, bytes], tmp_path: Path) -> None:
    made, expected = by_two
    killed: list[int] = []

    with local_cluster(2) as started:
        workers: Any = started[0].run(os.getpid)
        processing: Any = started[0].processing

        def kill_one_at_work(done: int) -> None:
            at_work = [address for address, tasks in processing().items() if tasks]
            if not killed and at_work:
                killed.append(workers[at_work[0]])
                os.kill(killed[0], signal.SIGKILL)

        path = swept(made, started, tmp_path / "killed", kill_one_at_work)
        assert killed
        assert not psutil.pid_exists(killed[0])
    assert path.read_bytes() == expected


def test_samples_that_end_or_hang_their_process_are_rows_with_that_error(
    planned: Make, tmp_path: Path
) -> None:
    misdeeds = ("none", "segfault", "hang", "none", "abort", "error")
    made = planned(f'[sweep]\ntimeout = 3\n[sweep.vary."r.misdeed"]\nvalues = {list(misdeeds)}\n')
    with local_cluster(2) as started:
        samples, _ = table.read(swept(made, started, tmp_path))
    assert [row["error"] for row in samples.to_pylist()] == [
        None,
        "the worker process ended: SIGSEGV",
        "it took longer than the timeout of 3 s",
        None,
        "the worker process ended: SIGABRT",
        "r at t = 0 s: fmi2DoStep returned error: the rudder is stuck",
    ]


def test_a_sample_whose_workers_die_again_and_again_is_found_among_the_others(
    planned: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not of its FMU, which runs in a process of its own: here the worker itself dies of sample 3."""
    made = planned('[sweep.vary."r.u"]\nvalues = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]\n')
    (tmp_path / "deadly.py").write_text(DEADLY)
    monkeypatch.syspath_prepend(tmp_path)  # of the workers as well
    monkeypatch.setattr(cluster, "run_batch", importlib.import_module("deadly").run_batch)
    one_death = config.set({"distributed.scheduler.allowed-failures": 0})  # the default of 3 takes a minute
    with one_death, local_cluster(2) as started:
        samples, _ = table.read(swept(made, started, tmp_path))
    rows = samples.to_pylist()
    assert [row["sample"] for row in rows if row["error"]] == [3]
    assert rows[3]["error"] == "every worker that ran it ended"


def test_what_a_worker_leaves_of_its_batch_is_run_in_another(
    by_two: tuple[Plan, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever its length: here every batch ends after its first sample."""
    made, expected = by_two
    (tmp_path / "hasty.py").write_text(HASTY)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(cluster, "run_batch", importlib.import_module("hasty").run_batch)
    batches: list[int] = []
    with local_cluster(2) as started:
        assert swept(made, started, tmp_path / "hasty", batches.append).read_bytes() == expected
    assert batches == [0, *[1] * COUNT]


def test_recordings_are_those_of_the_samples_run_alone(planned: Make, tmp_path: Path) -> None:
    made = planned(SWEEP.replace(f"samples = {COUNT}", "samples = 6"))
    with local_cluster(2) as started:
        samples, _ = table.read(swept(made, started, tmp_path, recorded=()))
    written = {path.name: Recording.read(path) for path in (tmp_path / "mine.recordings").iterdir()}
    good = [row["sample"] for row in samples.to_pylist() if row["error"] is None]
    assert set(written) == {f"sample-{sample}.parquet" for sample in good}
    for sample in good:
        one = made.of_sample(sample)
        alone = simulate(one.system, one.experiment)
        recording = written[f"sample-{sample}.parquet"]
        assert recording.names == alone.names
        assert recording.values.tolist() == alone.values.tolist()


def test_what_was_done_before_is_not_run_again(by_two: tuple[Plan, bytes], tmp_path: Path) -> None:
    made, expected = by_two
    done = 0

    def interrupt(more: int) -> None:
        nonlocal done
        done += more
        if done > 5:
            raise KeyboardInterrupt

    with local_cluster(2) as started:
        with pytest.raises(KeyboardInterrupt):
            swept(made, started, tmp_path / "again", interrupt)
        assert 5 < done < COUNT
        more: list[int] = []
        again = swept(made, started, tmp_path / "again", more.append)
    assert (more[0], sum(more)) == (done, COUNT)
    assert again.read_bytes() == expected


@contextmanager
def processes(folder: Path, *workers: str) -> Iterator[str]:
    """A scheduler and workers, started by hand as on several machines; gives the scheduler's address."""
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    file = folder / "scheduler.json"
    started = [
        subprocess.Popen(
            [*dask, "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", file],
            stderr=subprocess.DEVNULL,
        )
    ]
    try:
        for name in workers:
            command = [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", file]
            options = ["--name", name, "--nthreads", "2", "--no-dashboard", "--local-directory", folder]
            started.append(subprocess.Popen([*command, *options], stderr=subprocess.DEVNULL))
        with Client(scheduler_file=str(file), timeout=60) as client:
            if workers:
                client.wait_for_workers(len(workers), timeout=60)
            address = client.scheduler_info()["address"]
        yield address
    finally:
        for process in started:
            process.terminate()
        for process in started:
            process.wait(30)


def test_a_cluster_by_its_address_gives_the_same_bytes(by_two: tuple[Plan, bytes], tmp_path: Path) -> None:
    """Two workers of two threads each, which cannot see the FMU's file."""
    made, expected = by_two
    with (
        processes(tmp_path, "one", "two") as address,
        cluster.runs(address, None, print) as place,
        Client(address) as client,
    ):
        assert sum(threads(client).values()) == 4
        assert swept(made, (client, place), tmp_path / "remote").read_bytes() == expected
        plugins: Any = client.run(
            lambda dask_worker: [name for name in dask_worker.plugins if "sweep" in name]
        )
        assert not [name for names in plugins.values() for name in names]


def test_a_worker_steps_runs_together(scenario_fmus: None, monkeypatch: pytest.MonkeyPatch) -> None:
    def counts(runs: Recording) -> list[int]:
        return [len(runs.values)] * len(runs.values)

    monkeypatch.setattr(ensemble, "is_compiled", lambda *_: True)
    chosen = scenario.load(scenario.find("nominal-extended"))
    given = replace(chosen.experiment, stop_time=1.0)
    experiments = [
        replace(given, parameters={**given.parameters, "plant.inertia": 5.0 + 0.1 * i}) for i in range(8)
    ]
    with local_cluster(1) as (client, _):
        address = client.scheduler_info()["address"]
        assert list(run_many(chosen.system, experiments, reduce=counts, where=address)) == [8] * 8


def test_a_cluster_whose_workers_are_gone_is_told(
    planned: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "LOOK_S", 0.2)
    monkeypatch.setattr(cluster, "WITHOUT_WORKERS_S", 1.0)
    made = planned('[sweep]\ntimeout = 60\n[sweep.vary."r.misdeed"]\nvalues = ["hang"]\n')
    with local_cluster(1) as started:
        threading.Timer(1.0, started[0].cluster.scale, (0,)).start()  # type: ignore[union-attr]
        with pytest.raises(SweepError, match="no workers for 1 s; finished samples are kept"):
            swept(made, started, tmp_path)


def test_workers_of_this_machine_beside_a_cluster_are_refused(refused: Callable[..., str]) -> None:
    message = refused("sweep", "monte-carlo", "--where", "tcp://a:1", "--workers", "2")
    assert "tcp://a:1 with 2 workers: expected none" in message


def test_a_scheduler_that_is_not_there_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "PATIENCE_S", 1.0)
    with (
        pytest.raises(SweepError, match=r"no Dask scheduler at tcp://127\.0\.0\.1:1: "),
        place_of("tcp://127.0.0.1:1"),
    ):
        pass


def test_a_cluster_without_workers_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "PATIENCE_S", 1.0)
    with (
        processes(tmp_path) as address,
        pytest.raises(SweepError, match="has no workers"),
        place_of(address),
    ):
        pass

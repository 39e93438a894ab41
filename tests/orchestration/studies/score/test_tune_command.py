"""`l1-depth tune`: what it refuses, what it writes, and that it continues after whatever ended it."""

import os
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any

import psutil
import pytest

from orchestration.scenarios.free_parameter import FreeParameter
from orchestration.studies.score import tune, tune_problem
from orchestration.studies.score.tune import Problem, SearchResult, Tuning
from orchestration.studies.score.tune_command import print_gains

Command = Callable[..., Any]
OPTIONS = ("--evaluations", "3", "--seeds", "2", "--workers", "2")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["l1-pie"], "nearest is 'l1-pi'"),
        (["L1DepthController"], "expected --free NAME=LOW:HIGH; tunable are "),
        (["l1", "--free", "integral_gian=1:2"], "nearest is 'integral_gain'"),
        (["l1", "--free", "integral_gain"], "expected NAME=LOW:HIGH"),
        (["l1", "--set", "controller.filter_bandwidth=1"], "filter_bandwidth: it is set, and free"),
        (["l1", "--set", "controller.augmentation=pie"], "augmentation"),
        (["l1", "--map", "measured_depth=z"], "--map: no effect with l1, a controller of the protocol"),
        (["l1", "--open-inputs", "start"], "--open-inputs: no effect with l1"),
        (["l1", "--no-rates"], "--no-rates: no effect with l1"),
        (["l1", "--plants", "3", "--cases", "nominal"], "--cases: no effect with --plants"),
        (["l1", "--bound", "overshoot"], "--bound overshoot: expected METRIC=NUMBER"),
        (["l1", "--out", f"{__file__}/results"], "Not a directory: expected a folder that can be written"),
    ],
)
def test_what_cannot_be_tuned_is_refused(refused: Command, arguments: list[str], message: str) -> None:
    assert message in refused("tune", *arguments)
    assert not Path("results").exists()


def test_a_tuning_without_its_library_says_how_to_install_it(
    refused: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    def version(distribution: str) -> str:
        raise PackageNotFoundError(distribution)

    monkeypatch.setattr(tune, "version", version)
    message = refused("tune", "l1", *OPTIONS)
    assert message == "l1-depth: tuning needs cmaes: pip install 'l1-depth[study]'\n"


@pytest.mark.parametrize(
    ("gain", "first", "verdict"),
    [
        (5.0, 3.0, "The cost is flat. In the last half"),
        (5.0, 2.0, "The search found nothing better after its first quarter. In the last half"),
        (10.0, 2.0, "The cost is limited by the range of kp: a wider one in --free may lower it."),
    ],
)
def test_a_cost_that_a_limit_or_an_idle_search_determines_is_not_called_flat(
    capsys: pytest.CaptureFixture[str], gain: float, first: float, verdict: str
) -> None:
    gains = {"kp": gain, "kd": 5.0}
    search = SearchResult(1, gains, {}, (first,) * 3 + (2.0,) * 9)
    free = (FreeParameter("kp", 1.0, 10.0), FreeParameter("kd", 1.0, 10.0))
    tuning = Tuning(Problem(free), (search,), (search,))
    assert tuning.is_flat
    print_gains(tuning, "pid")
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith(verdict)
    assert "; the one seed is " in last
    print_gains(replace(tuning, searches=tuning.searches * 2), "pid")
    assert "; the median of 2 seeds is " in capsys.readouterr().out


def test_two_evaluations_do_not_tell_whether_the_cost_is_flat(capsys: pytest.CaptureFixture[str]) -> None:
    """Fewer than two generations of 6 evaluations each, as CMA-ES has them of two gains."""
    free = (FreeParameter("kp", 1.0, 10.0), FreeParameter("kd", 1.0, 10.0))
    for count in (2, 11):
        search = SearchResult(1, {"kp": 5.0, "kd": 5.0}, {}, (2.0,) * count)
        tuning = Tuning(Problem(free), (search,), (search,))
        assert not tuning.is_flat
        print_gains(tuning, "pid")
        last = capsys.readouterr().out.splitlines()[-1]
        message = "evaluations are too few to tell whether the cost is flat: expected 12 or more."
        assert last == f"{count} {message}"


@pytest.mark.slow
def test_the_step_is_halved_until_half_of_it_hardly_changes_the_cost(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    changes = iter([-0.021, 0.02, 0.02, 0.02])  # after the search twice, after that at 10 ms, and written
    monkeypatch.setattr(tune_problem, "change_at_half_the_step", lambda *_: next(changes))
    done = command("tune", "pid", *OPTIONS)
    assert done.stdout.splitlines()[-2] == "Half the step of 10 ms changes the error by 2 %."
    written = tomllib.loads(Path("results/pid.toml").read_text())["tuning"]
    assert (written["step"], written["change_at_half_the_step"]) == (0.01, 0.02)
    assert [path.name for path in Path("results").iterdir()] == ["pid.toml"]


# Long enough (120 evaluations of some 10 ms) for a signal to arrive before the last of them.
LONG = ("--evaluations", "20", "--seeds", "2", "--workers", "2")


def _process(folder: Path) -> subprocess.Popen[str]:
    program = "from orchestration.cli import main; main()"
    return subprocess.Popen(
        [sys.executable, "-c", program, "tune", "adrc", *LONG, "--out", str(folder)],
        stderr=subprocess.PIPE,
        text=True,
    )


def _wait_for_evaluations(journal: Path, count: int) -> None:
    while not journal.exists() or journal.read_text().count("\n") < count:
        time.sleep(0.005)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_tuning_continues_after_an_end_to_the_same_file(
    command: Command, tmp_path: Path, number: signal.Signals
) -> None:
    journal = tmp_path / "ended" / "adrc.20ms.tune.jsonl"
    process = _process(tmp_path / "ended")
    _wait_for_evaluations(journal, 4)
    workers = psutil.Process(process.pid).children(recursive=True)
    os.kill(process.pid, number)
    _, error = process.communicate(timeout=60)
    psutil.wait_procs(workers, timeout=20)
    assert not [worker for worker in workers if worker.is_running()]
    if number == signal.SIGINT:
        assert process.returncode == 130
        assert "of 120 evaluations are done and kept; the same command continues" in error
    done = journal.read_text().count("\n")
    assert 4 <= done < 120
    command("tune", "adrc", *LONG, "--out", "ended")
    command("tune", "adrc", *LONG, "--out", "whole")
    assert Path("ended", "adrc.toml").read_bytes() == Path("whole", "adrc.toml").read_bytes()
    assert [path.name for path in Path("ended").iterdir()] == ["adrc.toml"]


@pytest.mark.slow
def test_the_gains_of_any_fmu_are_tuned_for_scenarios(command: Command) -> None:
    command("new", "pid")
    options = ("--free", "kp=1:20", "--evaluations", "4", "--seeds", "1", "--workers", "1")
    done = command("tune", "pid.py", *options)
    assert done.stdout.splitlines()[-1] == "results/pid.toml"
    document = tomllib.loads(Path("results/pid.toml").read_text())
    assert 1.0 <= document["parameters"]["controller.kp"]["value"] <= 20.0
    written = document["tuning"]
    assert (written["controller"], written["evaluations"]) == ("pid", 8)

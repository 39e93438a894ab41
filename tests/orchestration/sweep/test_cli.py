"""The command `sweep`; where it is interrupted, in a process of its own, as a user meets it."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from orchestration.sweep import table

MakeFile = Callable[..., Path]
COMMAND = [sys.executable, "-c", "from orchestration.cli import main; main()", "sweep"]


def started(folder: Path, *arguments: object) -> subprocess.Popen[str]:
    """In a session of its own, as at another terminal."""
    (folder / "tmp").mkdir(exist_ok=True)
    return subprocess.Popen(
        [*COMMAND, *map(str, arguments)],
        cwd=folder,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(folder / "tmp")},
        start_new_session=True,
    )


def ended(process: subprocess.Popen[str], folder: Path, expect: int = 0) -> tuple[str, str]:
    """What it said; nothing may be left in its temporary folder."""
    out, error = process.communicate(timeout=120)
    assert process.returncode == expect, error
    assert not list((folder / "tmp").iterdir())
    return out, error


def test_it_writes_a_table_and_prints_a_summary(
    sweep_file: MakeFile, tmp_path: Path, command: Callable[..., Any]
) -> None:
    before = {*tmp_path.iterdir(), sweep_file()}
    done = command("sweep", sweep_file(), "--workers", 1, "--recordings", "r.y")
    out = done.stdout
    assert "mine: 12 samples, 0 failed" in out
    assert "one by one" not in out  # what ran the samples is no result
    assert "l1-depth: 1 processes, runs one by one: " in done.stderr
    assert "results/mine.sweep.parquet" in out
    assert "results/mine.recordings" in out
    assert len(list((tmp_path / "results" / "mine.recordings").glob("sample-*.parquet"))) == 12
    assert set(tmp_path.iterdir()) == before | {tmp_path / "results", tmp_path / "tmp"}


@pytest.mark.slow
def test_a_sweep_without_a_sample_that_succeeds_fails(
    sweep_file: MakeFile, tmp_path: Path, refused: Callable[..., str]
) -> None:
    misdeeds = (
        '[sweep.vary."r.misdeed"]\nvalues = ["error"]\n[sweep.vary."r.misdeed_time"]\nvalues = [0.1, 0.2]\n'
    )
    message = refused("sweep", sweep_file(misdeeds), "--workers", 1)
    assert "every sample failed, 0 with: r at t = 0.1 s: fmi2DoStep returned error" in message
    results, _ = table.read(tmp_path / "results" / "mine.sweep.parquet")
    assert results[table.ERROR].null_count == 0


@pytest.mark.cluster
def test_one_sample_alone_has_the_values_and_metrics_of_its_row(sweep_file: MakeFile, tmp_path: Path) -> None:
    ended(started(tmp_path, sweep_file(), "--workers", 1), tmp_path)
    results, _ = table.read(tmp_path / "results" / "mine.sweep.parquet")
    ended(started(tmp_path, sweep_file(), "--sample", 7, "--out", "one"), tmp_path)
    document = json.loads((tmp_path / "one" / "mine.sample-7.json").read_text())
    row = results.to_pylist()[7]
    values = {name: metric["value"] for name, metric in document["metrics"].items()}
    assert values == {name: row[name] for name in ("mean", "effort")}
    assert document["scenario"]["inputs"]["r.u"] == row["r.u"]
    assert (tmp_path / "one" / "mine.sample-7.csv").is_file()


@pytest.mark.cluster
def test_an_interrupted_sweep_says_how_to_go_on_and_the_same_command_does(
    sweep_file: MakeFile, tmp_path: Path
) -> None:
    """Ctrl-C reaches every process of the terminal, so do workers hear of it."""
    hangs = """[sweep]
samples = 4
timeout = 2
[sweep.vary."r.u"]
distribution = "uniform"
low = 1
high = 2
[sweep.vary."r.misdeed"]
values = ["none", "hang"]
"""
    path = sweep_file(hangs)
    process = started(tmp_path, path, "--workers", 1)
    log = tmp_path / "results" / "mine.sweep.jsonl"
    until = time.monotonic() + 60
    while not log.is_file() or len(log.read_text().splitlines()) < 2:
        assert time.monotonic() < until
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    _, error = ended(process, tmp_path, expect=130)
    assert "of 8 samples are done and kept; the same command continues" in error
    done = len(log.read_text().splitlines()) - 1
    assert 0 < done < 8
    assert f"interrupted: {done} of 8" in error
    out, _ = ended(started(tmp_path, path, "--workers", 1), tmp_path)
    assert "mine: 8 samples, 4 failed" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--recordings", "r.z"], "recordings: no variable 'r.z'; nearest is 'r.y'"),
        (["--recordings", "r.u"], "recordings: r.u: expected an output or an input driven by a signal"),
    ],
)
def test_a_mistake_is_one_line_before_anything_runs(
    sweep_file: MakeFile, tmp_path: Path, refused: Callable[..., str], arguments: list[str], message: str
) -> None:
    assert message in refused("sweep", sweep_file(), *arguments)
    assert not (tmp_path / "results").exists()

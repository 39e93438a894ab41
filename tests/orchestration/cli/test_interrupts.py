"""An interrupt of a command: status 130, one line, no process and no temporary file left."""

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path

import psutil
import pytest

from fmus.files import TEMPORARY_VARIABLE
from orchestration.cli import run_interruptible
from orchestration.cli.app import app
from orchestration.report.find import found_results
from orchestration.report.result import RunResult
from orchestration.results import files
from orchestration.results.recording import Recording
from tests.foreign_fmus import Misdeed

SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
# a command, and a function that it calls when it is at work
AT_WORK = {
    "new pid": "fmus.block.block_file.write_new_block",
    "build ExamplePlant --out out": "fmus.generate.builder.build_orders",
    "check {fmu}": "fmus.compliance.examine.examine",
    "prove ExamplePlant": "fmus.prove.eva.proof",
    "diff {fmu} {fmu}": "orchestration.diff.command._changes",
    "verify {fmu}": "fmus.fmi.description.describe",
    "inspect my.fmu": "fmus.fmi.description.describe",
    "cache": "fmus.store.entries",
    "explain faults": "orchestration.cli.explain.sections",
    "scenarios": "orchestration.scenarios.layers.shipped",
    "run nominal-l1 --out .": "orchestration.system.prepared_run.prepare_checked",
    "live nominal-l1 --out live.html": "orchestration.report.live_page.live_page",
    "sweep monte-carlo": "orchestration.sweep.run.sweep",
    "report .": "orchestration.report.find.found_results",
    "score L1DepthController --out .": "orchestration.studies.score.score.score_controllers",
    "tune l1-pi --out .": "orchestration.studies.score.tune_problem.problem_of",
    "compare --out .": "orchestration.studies.score.score.compare",
    "margins nominal-l1": "orchestration.studies.margins.margins.judge",
    "design --plant RovDepthPlant --out .": "orchestration.studies.design.rules.design_l1",
    "reproduce": "orchestration.scenarios.run_files.run_all",
    "fit RovDepthPlant --free inertia --data {fmu} --out .": "orchestration.studies.fit.dive.read_dive",
    "package nominal-l1": "orchestration.exchange.ssp_write.ramp_sources",
}


@pytest.fixture
def _restored(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A command changes the handlers and the environment of its process, here that of the tests."""
    for name in ("TMPDIR", "TEMP", "TMP", TEMPORARY_VARIABLE):
        monkeypatch.setenv(name, "")
    monkeypatch.setattr(tempfile, "tempdir", None)
    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    yield
    signal.set_wakeup_fd(-1)
    for number, handler in handlers.items():
        signal.signal(number, handler)


def test_every_command_is_interrupted_below() -> None:
    commands = {info.callback.__name__ for info in app.registered_commands if info.callback}
    assert {words.split()[0] for words in AT_WORK} == commands


@pytest.mark.usefixtures("_restored")
@pytest.mark.parametrize(
    ("words", "number"),
    [(words, signal.SIGINT) for words in AT_WORK] + [("scenarios", number) for number in SIGNALS[1:]],
)
def test_an_interrupt_of_a_command_at_work_is_status_130_and_one_line(
    words: str,
    number: signal.Signals,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def interrupted(*arguments: object, **options: object) -> None:
        os.kill(os.getpid(), number)
        time.sleep(60.0)

    module, _, function = AT_WORK[words].rpartition(".")
    monkeypatch.setattr(import_module(module), function, interrupted)
    arguments = words.format(fmu=Path(__file__)).split()
    monkeypatch.setattr(sys, "argv", ["l1-depth", *arguments])
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    before = set(psutil.Process().children(recursive=True))
    with pytest.raises(SystemExit) as end:
        run_interruptible()
    captured = capsys.readouterr()
    assert (end.value.code, captured.err.splitlines()[-1:]) == (130, [captured.err.strip()])
    assert "interrupted" in captured.err
    assert not list(tmp_path.iterdir())
    assert not set(psutil.Process().children(recursive=True)) - before


@pytest.mark.usefixtures("_restored")
def test_a_recording_that_cannot_be_written_outlives_the_command(
    short_scenario: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    write = files.write

    def refuse_once(path: Path, content: object) -> None:
        monkeypatch.setattr(files, "write", write)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files, "write", refuse_once)
    monkeypatch.setattr(sys, "argv", ["l1-depth", "run", str(short_scenario()), "--out", str(tmp_path)])
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    with pytest.raises(SystemExit, match="1"):
        run_interruptible()
    rescued = Path(capsys.readouterr().err.rpartition("the recording is in ")[2].strip())
    assert Recording.read(rescued).time[-1] == 0.2


@pytest.fixture
def started(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts `l1-depth` after some code, in a session of its own, as at another terminal."""
    (tmp_path / "tmp").mkdir()
    processes = []

    def start(code: str, *arguments: object) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [
                sys.executable,
                "-c",
                f"{code}\nfrom orchestration.cli import main; main()",
                *map(str, arguments),
            ],
            cwd=tmp_path,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, "TMPDIR": str(tmp_path / "tmp")},
            start_new_session=True,
        )
        processes.append(process)
        return process

    yield start
    for process in processes:
        process.kill()
        process.communicate()


def _check_end(process: subprocess.Popen[str], folder: Path, more: str = "") -> None:
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130
    assert re.fullmatch(f"l1-depth: interrupted{more}\n", error)
    assert not list((folder / "tmp").iterdir())


def _wait_for(condition: Callable[[], object]) -> None:
    until = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.02)


def _is_idle(process: subprocess.Popen[str]) -> bool:
    (command,) = psutil.Process(process.pid).children()  # see `fmus/fmi/parent_process.py`
    used = command.cpu_times()
    time.sleep(0.5)
    return command.cpu_times() == used


INTERRUPT_AT_IMPORT = """
import os, signal, sys
class Interrupt:
    def find_spec(self, name, path, target=None):
        if name == "{module}":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupt())
"""


@pytest.mark.parametrize("module", ["tempfile", "typer", "orchestration.cli.shared", "numpy"])
def test_an_interrupt_during_the_imports_is_one_line(
    module: str, started: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    _check_end(started(INTERRUPT_AT_IMPORT.format(module=module), "run", "nominal-l1"), tmp_path)


INTERRUPT_IN_A_SCHEMA = """
import enum, os, signal, sys
get = enum.property.__get__
def interrupted(*arguments):
    frame = sys._getframe(1)
    caller = frame.f_code.co_name
    while frame and not frame.f_code.co_filename.startswith("<frozen importlib"):
        frame = frame.f_back
    if caller == "create_schema_validator" and frame is None:
        enum.property.__get__ = get
        os.kill(os.getpid(), signal.SIGINT)
    return get(*arguments)
enum.property.__get__ = interrupted
"""


def test_an_interrupt_while_a_schema_is_built_is_one_line(
    started: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    """Pydantic, in Rust, makes a SchemaError of any exception in the Python that it calls."""
    _check_end(started(INTERRUPT_IN_A_SCHEMA, "run", "nominal-l1"), tmp_path)


def test_an_interrupt_inside_a_library_in_cpp_does_not_abort_it(
    started: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    """The library calls Python while it is imported; an exception there would end the process by SIGABRT."""
    code = INTERRUPT_AT_IMPORT.format(module="fmus.compliance.examine").replace(
        "os.kill(os.getpid(), signal.SIGINT)", "enum.EnumType.__setattr__ = interrupted; import lief"
    )
    interrupted = """
import enum
set_attribute = enum.EnumType.__setattr__
def interrupted(*arguments):
    os.kill(os.getpid(), signal.SIGINT)
    set_attribute(*arguments)
"""
    (tmp_path / "any.fmu").touch()
    _check_end(started(interrupted + code, "check", "any.fmu"), tmp_path)


@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGHUP, marks=pytest.mark.slow)])
def test_the_worker_processes_end_with_the_command_and_write_nothing(
    number: signal.Signals, started: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    # the signal comes twice, from the group and passed on, on a busy machine more than 1 s apart
    as_one = "from orchestration.cli import interrupts; interrupts.SAME_S = 5.0"
    process = started(as_one, "sweep", "monte-carlo", "--where", "processes", "--workers", "2")
    journal = tmp_path / "results" / "monte-carlo.sweep.jsonl"
    _wait_for(lambda: journal.exists() and journal.read_bytes().count(b"\n") > 4)  # nothing is imported then
    workers = psutil.Process(process.pid).children(recursive=True)
    os.killpg(process.pid, number)
    _check_end(process, tmp_path, r": \d+ of 1000 samples are done and kept; the same command continues")
    assert len(workers) >= 3
    psutil.wait_procs(workers, timeout=60)
    assert not any(worker.is_running() for worker in workers)


def test_a_second_interrupt_ends_a_run_whose_fmu_hangs(
    misbehaving: Callable[..., str], started: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    quick = "from orchestration.cli import interrupts; interrupts.SAME_S = interrupts.GRACE_S = 0.1"
    process = started(quick, "run", misbehaving(Misdeed.HANG))
    _wait_for(lambda: list((tmp_path / "tmp").rglob("*.so")))
    _wait_for(lambda: _is_idle(process))  # it hangs; before that one interrupt would be enough
    process.send_signal(signal.SIGINT)
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    _check_end(process, tmp_path)


@pytest.mark.slow
def test_an_fmu_that_ends_the_process_at_once_is_named_and_the_status_is_not_0(
    misbehaving: Callable[..., str], started: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    process = started("", "run", misbehaving(Misdeed.EXIT_AT_ONCE), "--out", "out")
    out, error = process.communicate(timeout=60)
    assert (process.returncode, out) == (70, "")
    assert error.startswith("l1-depth: rudder ended the process with exit status 0: the run is lost")
    assert not [*(tmp_path / "out").iterdir(), *(tmp_path / "tmp").iterdir()]


def test_an_fmu_that_crashes_while_it_is_freed_loses_nothing_of_the_run(
    misbehaving: Callable[..., str], started: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    process = started("", "run", misbehaving(Misdeed.CRASH_IN_FREE), "--out", "out", "--formats", "none")
    out, error = process.communicate(timeout=60)
    assert (process.returncode, out.splitlines()) == (139, ["out/mine.csv", "out/mine.json"])
    assert error.startswith(
        "l1-depth: rudder ended the process with SIGSEGV: the files of the run are written; with --timeout"
    )
    (run,) = found_results([tmp_path / "out"])
    assert isinstance(run, RunResult)
    assert run.recording.time[-1] == 1.0
    assert not list((tmp_path / "tmp").iterdir())

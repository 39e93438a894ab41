"""The process of a command: without a HOME that can be written, and with an FMU that changes it."""

import os
import pty
import pwd
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

from orchestration.cli.interrupts import _writable_cache
from tests.described_fmus import described
from tests.foreign_fmus import Misdeed

COMMAND = (sys.executable, "-c", "from orchestration.cli import main; main()")
CACHES = ("HOME", "XDG_CACHE_HOME", "ZIG_GLOBAL_CACHE_DIR", "MPLCONFIGDIR", "L1_DEPTH_FMUS")


def ended(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """A command in a process of its own; nothing may be left of its temporary files."""
    temporary = folder / "tmp"
    temporary.mkdir(exist_ok=True)
    done = subprocess.run(
        [*COMMAND, *arguments],
        cwd=folder,
        env={**os.environ, "TMPDIR": str(temporary)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert not list(temporary.iterdir())
    return done


@pytest.mark.parametrize(("argument", "unbuffered"), [("scenarios", ""), ("--version", "1")])
def test_a_command_whose_output_nobody_reads_ends_without_a_word(argument: str, unbuffered: str) -> None:
    """Its status is that of other tools in a shell: 128 + SIGPIPE."""
    reader, output = os.pipe()
    os.close(reader)
    try:
        done = subprocess.run(
            [*COMMAND, argument],
            stdout=output,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
            env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
        )
    finally:
        os.close(output)
    assert (done.returncode, done.stderr) == (141, "")


@pytest.mark.parametrize(("closed", "fmu", "status"), [("2>&-", "none.fmu", 1), (">&- 2>&-", "a.fmu", 0)])
def test_where_an_output_is_closed_nothing_is_printed(
    tmp_path: Path, closed: str, fmu: str, status: int
) -> None:
    """Neither a traceback, nor an error message in place of the results."""
    described(tmp_path / "a.fmu", ("u",), ("y",))
    command = ["sh", "-c", f'"$@" {closed}', "sh", *COMMAND, "inspect", str(tmp_path / fmu)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (status, "", "")


@pytest.fixture
def _no_caches(monkeypatch: pytest.MonkeyPatch) -> None:
    """No variable names a home or a cache, as tests otherwise have it."""
    for name in CACHES:
        monkeypatch.setenv(name, "")  # so that it is as before in the end
        monkeypatch.delenv(name)


# it compiles the C library, too
@pytest.mark.slow
@pytest.mark.usefixtures("_no_caches")
def test_what_is_built_and_run_needs_no_home_that_can_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "home").touch()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    done = ended(tmp_path, "run", "example-l1")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "results" / "example-l1.png").is_file()
    # a busy machine announces the wait for the compiler, and progress, besides
    said = [line for line in done.stderr.splitlines() if line.startswith(f"l1-depth: {tmp_path}/home/")]
    assert len(said) == 1, done.stderr
    assert ".cache cannot be written: built files are not kept" in said[0]


@pytest.mark.usefixtures("_no_caches")
def test_the_cache_of_a_user_without_home_is_that_of_the_account(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home = tmp_path / "account"
    home.mkdir()
    account = pwd.getpwuid(os.getuid())
    fields = list(account)
    fields[5] = str(home)
    monkeypatch.setattr(pwd, "getpwuid", lambda number: pwd.struct_passwd(fields))
    with _writable_cache(str(tmp_path)):
        assert os.environ["HOME"] == str(home)
        assert not os.environ.keys() & {"XDG_CACHE_HOME", "ZIG_GLOBAL_CACHE_DIR"}


@pytest.mark.usefixtures("_no_caches")
def test_a_cache_that_can_only_be_read_is_still_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cache = tmp_path / "cache of the user"
    (cache / "l1-depth").mkdir(parents=True)
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    access = os.access
    # root may write everywhere
    monkeypatch.setattr(os, "access", lambda path, mode: not mode & os.W_OK and access(path, mode))
    with _writable_cache(str(tmp_path)):
        assert os.environ["XDG_CACHE_HOME"] == str(cache)
        assert os.environ["ZIG_GLOBAL_CACHE_DIR"].startswith(str(tmp_path / "cache"))
    assert capsys.readouterr().err == ""


@pytest.mark.slow
def test_an_fmu_that_changes_the_permissions_of_new_files_hides_no_results(
    misbehaving: Callable[..., str], tmp_path: Path
) -> None:
    (tmp_path / "usual").touch()
    done = ended(
        tmp_path, "run", misbehaving(Misdeed.HIDE_FILES, 0.5, 2.0), "--checkpoint", "saved", "--every", "1"
    )
    assert done.returncode == 0, done.stderr
    results = [*(tmp_path / "results").iterdir()]
    assert len(results) == 3
    for path in (*results, tmp_path / "saved"):
        assert path.stat().st_mode == (tmp_path / "usual").stat().st_mode, path


@pytest.mark.slow
def test_an_fmu_that_limits_the_size_of_files_is_named_and_harmless_in_a_process_of_its_own(
    misbehaving: Callable[..., str], tmp_path: Path
) -> None:
    done = ended(tmp_path, "run", misbehaving(Misdeed.LIMIT_FILES, 0.5))
    assert done.returncode == 1
    assert done.stderr == (
        "l1-depth: results/mine.csv: File too large: an FMU may have limited this process; "
        "with --timeout FMUs have one of their own\n"
    )
    assert not list((tmp_path / "results").iterdir())
    assert ended(tmp_path, "run", "mine.toml", "--timeout", "60").returncode == 0


@pytest.mark.slow
def test_an_interrupt_at_the_terminal_reaches_a_run_whose_fmu_has_left_it(
    misbehaving: Callable[..., str], tmp_path: Path
) -> None:
    arguments = [
        "run",
        misbehaving(Misdeed.LEAVE_SESSION, 0.5, 60.0),
        "--real-time",
        "1",
        "--out",
        str(tmp_path),
    ]
    process, terminal = pty.fork()
    if not process:
        os.chdir(tmp_path)
        os.execv(COMMAND[0], [*COMMAND, *arguments])
    try:
        until = time.monotonic() + 60.0
        while not any(os.getsid(c.pid) == c.pid for c in psutil.Process(process).children()):
            assert time.monotonic() < until
            time.sleep(0.02)
        os.write(terminal, b"\x03")
        while not (ended := os.waitpid(process, os.WNOHANG))[0]:
            assert time.monotonic() < until
            time.sleep(0.02)
        assert os.waitstatus_to_exitcode(ended[1]) == 130
    finally:
        with suppress(ProcessLookupError):
            os.kill(process, signal.SIGKILL)
        os.close(terminal)

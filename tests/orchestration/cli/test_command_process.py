"""The process of a command without a HOME that can be written."""

import os
import pwd
import subprocess
import sys
from pathlib import Path

import pytest

from orchestration.cli.interrupts import _writable_cache

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


@pytest.fixture
def _no_caches(monkeypatch: pytest.MonkeyPatch) -> None:
    """No variable names a home or a cache, as tests otherwise have it."""
    for name in CACHES:
        monkeypatch.setenv(name, "")  # so that it is as before in the end
        monkeypatch.delenv(name)


@pytest.mark.usefixtures("_no_caches")
def test_what_is_built_and_run_needs_no_home_that_can_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "home").touch()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    done = ended(tmp_path, "run", "example-l1")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "results" / "example-l1.png").is_file()
    line = f"l1-depth: {tmp_path}/home/.cache cannot be written: what is built is not kept"
    assert done.stderr.startswith(line)
    assert done.stderr.count("\n") == 1


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

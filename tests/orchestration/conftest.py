"""The command line in this process: what a test claims of it seldom needs another."""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest

from orchestration.cli.commands import run_command


@dataclass(frozen=True)
class Done:
    """What a command printed."""

    stdout: str
    stderr: str


@pytest.fixture
def command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., Done]:
    """Runs `l1-depth` with arguments in `tmp_path`; `expect` is its exit status.

    Nothing may be left in the folder of temporary files.
    """
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))

    def run(*arguments: object, expect: int = 0) -> Done:
        try:
            status = run_command([str(argument) for argument in arguments])
        except SystemExit as end:
            status = end.code
        captured = capsys.readouterr()
        assert status == expect, captured.err
        assert not list(temporary.iterdir())
        return Done(captured.out, captured.err)

    return run


@pytest.fixture
def refused(command: Callable[..., Done]) -> Callable[..., str]:
    """The one line on standard error of a command that must fail with status 1."""

    def run(*arguments: object) -> str:
        done = command(*arguments, expect=1)
        assert done.stderr.startswith("l1-depth: ")
        assert done.stderr.count("\n") == 1
        return done.stderr

    return run


@pytest.fixture(scope="session")
def vehicle_fmus(built: Mapping[str, Path]) -> None:
    """Scenarios of the vehicle with L1 control find their FMUs; `scenario_fmus` builds all blocks."""
    assert all(built[name].is_file() for name in ("L1DepthController", "RovDepthPlant"))

"""The command cache shows what is kept and clears it, and takes nothing from a command that runs."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fmus import store
from fmus.registry import FOLDER_VARIABLE

Command = Callable[..., Any]
HOLDING = (
    "import sys; from fmus.store import keep_fmus; keep_fmus(); print('runs', flush=True); sys.stdin.read()"
)


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """Files of each kind in a cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv(FOLDER_VARIABLE)
    for kind in store.MOST:
        store.put(kind, "key", b"content")
    store.write(store.folder(store.FMUS) / "installation" / "native" / "Plant.fmu", bytes(2_000_000))
    return files()


def files() -> dict[str, int]:
    return {kind: len([*store.entries(kind)]) for kind in (*store.MOST, store.FMUS)}


def shown(output: str) -> dict[str, list[str]]:
    """Kind -> files, MB and note, below the folder and the heading."""
    return {line.split()[0]: line.split(maxsplit=3)[1:] for line in output.splitlines()[2:]}


def test_every_kind_is_shown_with_its_size(command: Command, kept: dict[str, int]) -> None:
    output = command("cache").stdout
    assert output.splitlines()[0] == str(store.folder())
    assert {kind: int(count) for kind, (count, *_) in shown(output).items()} == kept | {"gpu": 0}
    assert shown(output)["fmus"][1:] == ["2.00", "FMUs that scenarios run"]
    assert files() == kept


def test_all_is_cleared_but_the_records_of_builds(command: Command, kept: dict[str, int]) -> None:
    assert shown(command("cache", "clear").stdout)["fmus"] == ["1", "2.00", "freed"]
    assert files() == {**dict.fromkeys(kept, 0), "builds": 1}
    command("cache", "clear", "builds")
    assert not any(files().values())


def test_a_link_is_not_followed(command: Command, kept: dict[str, int], tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    store.folder("libraries").rename(mine)
    store.folder("libraries").symlink_to(mine)
    assert "libraries is a link: remove it" in command("cache", "clear").stdout
    assert [*mine.iterdir()] == [mine / "key"]


def test_one_kind_is_cleared_alone(command: Command, kept: dict[str, int]) -> None:
    assert shown(command("cache", "clear", "libraries").stdout).keys() == {"libraries"}
    assert files() == {**kept, "libraries": 0}


def test_a_folder_that_others_can_write_is_named(command: Command, kept: dict[str, int]) -> None:
    store.folder("libraries").chmod(0o770)
    shown_kinds = shown(command("cache").stdout)
    assert "libraries can be written by other users: remove it, or set" in shown_kinds["libraries"][2]
    assert "other users" not in shown_kinds["fmus"][2]


def test_a_kind_that_is_not_there_is_named(command: Command, kept: dict[str, int]) -> None:
    assert (
        "no kind 'library'; nearest is 'libraries'" in command("cache", "clear", "library", expect=2).stderr
    )
    assert files() == kept


def test_what_another_command_runs_is_kept_until_it_ends(command: Command, kept: dict[str, int]) -> None:
    """Also where it is killed."""
    with subprocess.Popen(
        [sys.executable, "-c", HOLDING], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout
        assert other.stdout.readline() == "runs\n"
        output = command("cache", "clear", *kept).stdout
        assert shown(output)["fmus"] == ["0", "0.00", "kept: another command runs FMUs"]
        assert files() == {**dict.fromkeys(kept, 0), "builds": 1, "fmus": 1}
        other.kill()
    command("cache", "clear", *kept)
    assert not any(files().values())


def test_a_folder_of_the_users_is_not_cleared(
    command: Command, kept: dict[str, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "mine"))
    fmu = tmp_path / "mine" / "native" / "Plant.fmu"
    store.write(fmu, b"an FMU")
    assert f"FMUs of scenarios are in {tmp_path / 'mine'}" in command("cache", "clear", *kept).stdout
    assert fmu.is_file()

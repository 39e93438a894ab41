"""Help of the commands, and what a mistake is answered with."""

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import typer

from fmus.files import write_archive
from orchestration.cli import shared
from orchestration.cli.app import app
from orchestration.scenarios import scenario
from tests.described_fmus import XML, members
from tests.shared_builds import Fmus

Command = Callable[..., Any]


def test_help_names_every_command(command: Command) -> None:
    text = command("--help").stdout
    assert all(f" {info.callback.__name__} " in text for info in app.registered_commands if info.callback)


def test_scenarios_are_listed_where_no_fmu_is_built(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("L1_DEPTH_FMUS", str(tmp_path))
    lines = command("scenarios").stdout.splitlines()
    assert [line.split()[0] for line in lines] == list(scenario.shipped())
    assert lines[-1].split(maxsplit=1)[1] == "Nominal, plain L1"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "nominal-l2"], "no scenario 'nominal-l2'; nearest is 'nominal-l1'"),
        (["run", "none.toml"], "no file none.toml"),
        (["build", "Exampleplan"], "no block named 'Exampleplan'; nearest is 'ExamplePlant'"),
        (["package", "nominal-l1.ssp"], "no scenario 'nominal-l1.ssp'; nearest is 'nominal-l1'"),
        (["run", "none.ssp", "--flavour", "python"], "a package: expected none, it holds its own FMUs"),
        (["build", "--platform", "linux46"], "no platform 'linux46'; nearest is 'linux64'"),
        (["build", "--platform", "linux64,"], "no platform ''"),
        (["build", "--platform", "win64", "--all-platforms"], "--platform: no effect with --all-platforms"),
        (["build", "ExamplePlant", "--flavour", "python", "--platform", "win64"], "flavour: expected none"),
        (["inspect", "broken.fmu"], "broken.fmu is not an FMU: expected a zip"),
        (["build", "ExamplePlant", "--out", "broken.fmu"], "l1-depth: broken.fmu: "),
    ],
)
def test_a_failure_is_one_line_and_exit_status_1(
    refused: Command, tmp_path: Path, arguments: list[str], message: str
) -> None:
    (tmp_path / "broken.fmu").write_text("not a zip")
    assert message in refused(*arguments)


def test_a_value_out_of_range_is_refused_before_the_run(refused: Command, short_scenario: Command) -> None:
    path = short_scenario(more='\n[parameters]\n"plant.inertia" = -1.0\n')
    assert "short.toml:26: plant.inertia = -1.0: expected 0.1 to 1e6 kg" in refused("run", path)


def test_a_very_long_number_is_told_in_short(refused: Command, short_scenario: Command) -> None:
    path = short_scenario(more=f'\n[parameters]\n"plant.inertia" = 1{"0" * 4000}\n')
    assert re.search(r"plant\.inertia = 1000[0.]{30,40}: expected", refused("run", path))


def test_a_mistyped_name_offers_the_nearest(command: Command, refused: Command) -> None:
    assert "'build'" in command("buidl", expect=2).stderr
    assert "--out" in command("run", "nominal-l1", "--oot", "x", expect=2).stderr
    assert "nearest is 'pdf'" in refused("run", "nominal-l1", "--formats", "png,pfd")


def test_bad_usage_is_exit_status_2(command: Command) -> None:
    done = command("run", expect=2)
    assert "SCENARIO" in done.stderr
    done = command("build", "--flavour", "wasm", expect=2)
    assert "'wasm' is not one of 'native', 'python'" in done.stderr


def test_help_and_bad_usage_load_nothing_heavy() -> None:
    """Nothing of these is what takes the time of a command that runs nothing."""
    code = """
import contextlib, sys
from orchestration.cli.commands import run_command
for arguments in (["--help"], ["run", "-h"], ["buidl"], ["--version"]):
    with contextlib.suppress(SystemExit):
        run_command(arguments)
print(*sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in done.stdout.splitlines()[-1].split()}
    assert "typer" in loaded
    assert not loaded & {"numpy", "scipy", "matplotlib", "fmpy", "casadi", "pandas", "pyarrow", "dask"}


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("run nominal-extended-", "nominal-extended-smooth"),
        ("build Rov", "RovDepthPlant"),
        ("rep", "reproduce"),
    ],
)
def test_shells_complete_commands_scenarios_and_blocks(
    command: Command, monkeypatch: pytest.MonkeyPatch, words: str, offered: str
) -> None:
    monkeypatch.setenv("_L1_DEPTH_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", f"l1-depth {words}")
    monkeypatch.setenv("COMP_CWORD", str(len(words.split())))
    assert offered in command().stdout.split()


def _help_texts() -> dict[str, list[str]]:
    """Command -> its description, and the help of each argument and option."""
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    texts = {"": ["".join(typer.main.get_command(app).help or "")]}
    for name, described in commands.items():
        texts[name] = [described.help, *(parameter.help for parameter in described.params)]
    return texts


@pytest.mark.parametrize("name", _help_texts())
def test_help_is_whole_sentences_and_loses_no_word_to_markup(
    command: Command, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr("typer.rich_utils.MAX_WIDTH", 400)  # nothing is wrapped
    printed = " ".join(command(*name.split(), "--help").stdout.split())
    for text in _help_texts()[name]:
        assert " ".join(text.split()) in printed
        assert text[0].isupper()
        assert text.endswith(".")


def test_inspect_prints_json_for_programs(command: Command, built: Fmus) -> None:
    document = json.loads(command("inspect", built["L1Controller"], "--json").stdout)
    assert (document["name"], document["fmi_version"]) == ("L1Controller", "2.0")
    variables = {variable["name"]: variable for variable in document["variables"]}
    assert variables["augmentation"]["permitted"] == {"1": "none", "2": "pi", "3": "nonlinear_p"}
    gain = variables["adaptation_gain"]
    assert (gain["causality"], gain["type"]) == ("parameter", "Real")
    assert float(gain["start"]) > 0.0
    assert set(gain) == {"name", "causality", "type", "unit", "start", "permitted", "description"}


def test_inspect_shows_an_fmu_for_model_exchange_alone(command: Command, built: Fmus, tmp_path: Path) -> None:
    description = members(built["ExamplePlant"])[XML].replace(b"CoSimulation", b"ModelExchange")
    path = write_archive(tmp_path / "exchange.fmu", {XML: description})
    expected = command("inspect", built["ExamplePlant"]).stdout
    assert command("inspect", path).stdout == expected


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "nominal-l1", "--every", "1"], "--every 1: expected --checkpoint FILE beside it"),
        (["sweep", "monte-carlo", "--sample", "1", "--restart"], "--restart: no effect with --sample"),
        (["sweep", "monte-carlo", "--sample", "1", "--recordings", "all"], "--recordings: no effect with"),
        (["sweep", "monte-carlo", "--sample", "1", "--workers", "2"], "--workers: no effect with --sample"),
    ],
)
def test_an_option_without_effect_is_refused(refused: Command, arguments: list[str], message: str) -> None:
    assert message in refused(*arguments)


def test_a_log_gets_a_line_of_progress_from_time_to_time(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Standard error is no terminal here."""
    clock = [0.0]
    monkeypatch.setattr("orchestration.cli.shared.time.monotonic", lambda: clock[-1])
    with shared.progress("score", 100) as bar:
        for now in (1.0, 29.9, 30.0, 31.0, 59.9, 60.0):
            clock.append(now)
            bar.advance(10, "of plants")
    assert capsys.readouterr().err.splitlines() == [
        "score of plants: 30 of 100",
        "score of plants: 60 of 100",
    ]


def test_where_nobody_knows_how_many_parts_there_are_a_line_says_how_many_are_done(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = [0.0]
    monkeypatch.setattr("orchestration.cli.shared.time.monotonic", lambda: clock[-1])
    with shared.progress("fit rover, evaluations", 0) as bar:
        for now in (1.0, 30.0):
            clock.append(now)
            bar.advance(note="0.1 m2")
    assert capsys.readouterr().err.splitlines() == ["fit rover, evaluations 0.1 m2: 2"]


def test_a_log_gets_a_line_for_each_of_few_parts(capsys: pytest.CaptureFixture[str]) -> None:
    with shared.progress("reproduce", 2) as bar:
        bar.advance(note="nominal-l1")
        bar.advance(note="nominal-extended")
    assert capsys.readouterr().err.splitlines() == [
        "reproduce nominal-l1: 1 of 2",
        "reproduce nominal-extended: 2 of 2",
    ]

"""The command margins."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Command = Callable[..., Any]
HOLD = ("--signal", "plant.depth", "--window", "0.1", "0.2")


def written(folder: Path) -> dict[str, dict[str, Any]]:
    """Group and name -> figure of margins.json."""
    document = json.loads((folder / "margins.json").read_text())
    return {f"{metric['group']}: {metric['name']}": metric for metric in document["metrics"]}


def test_every_figure_has_its_unit_its_assumption_and_its_source(
    command: Command, short_scenario: Callable[..., Path], tmp_path: Path
) -> None:
    """What a group assumes is printed once, and each part of the rest with its number."""
    short_scenario()
    done = command("margins", "short.toml", *HOLD, "--over", "controller.adaptation_gain=100", "--out", "out")
    written_last = done.stdout.replace("\\", "/").splitlines()[-2:]
    assert written_last == ["out/margins.png", "out/margins.json"]
    assert (tmp_path / "out" / "margins.png").read_bytes().startswith(b"\x89PNG")
    figures = written(tmp_path / "out")
    assert {figure["group"] for figure in figures.values()} == {
        "L1-norm condition", "linear loop", "through the FMUs", "prediction error",
    }  # fmt: skip
    for name, figure in figures.items():
        assert figure["assumption"], name
        assert figure["source"], name
        assert figure["name"].split(",")[0] in done.stdout
    # the hold at 0.1 s is the surface, where theta_hat hardly adapts: sigma_hat alone, by Gamma
    at_rest = figures["linear loop: delay margin, at this adaptation gain"]
    assert at_rest["assumption"].startswith("kappa = 100.0")
    assert figures["through the FMUs: delay margin, control"]["value"] == 0.6  # nothing is lost in 0.1 s
    table, _, below = done.stdout.partition("└")
    lines = below.splitlines()
    of_group = {line.partition(": ")[0]: line for line in lines if not line.startswith("[")}
    numbered = dict(re.findall(r"(?m)^\[(\d+)\] (.+)$", below))
    assert len(set(numbered.values())) == len(numbered) > 5
    rows = [[cell.strip() for cell in row.strip("│").split("│")] for row in table.splitlines() if "│" in row]
    # a long name goes on in the next line; a terminal of Windows has the same bars in the heading
    rows = [row for row in rows if row[2] not in ("", "Value")]
    for (*_, note), figure in zip(rows, figures.values(), strict=True):
        printed = (
            f"{of_group[figure['group']].removeprefix(figure['group'] + ': ')}; {numbered.get(note, '')}"
        )
        parts = f"{figure['assumption']}; {figure['source']}".split("; ")
        assert sorted(filter(None, printed.split("; "))) == sorted(parts)
    for text in ("linear at rest", "quiet: standard deviation", "measured", "it holds below 1"):
        assert below.count(text) == 1


@pytest.mark.slow
def test_theory_alone_takes_no_runs_of_other_delays(
    command: Command, short_scenario: Callable[..., Path], tmp_path: Path
) -> None:
    short_scenario()
    command("margins", "short.toml", "--theory", "--out", "out")
    assert {figure["group"] for figure in written(tmp_path / "out").values()} == {
        "L1-norm condition", "linear loop", "prediction error",
    }  # fmt: skip


@pytest.mark.slow
def test_a_foreign_controller_is_judged_by_runs_alone_and_told_why(
    command: Command, short_scenario: Callable[..., Path], tmp_path: Path
) -> None:
    short_scenario()
    foreign = ("--controller", "PidDepthController", "--over", "controller.model_damping=2")
    done = command("margins", "short.toml", *foreign, *HOLD, "--out", "out")
    assert {figure["group"] for figure in written(tmp_path / "out").values()} == {"through the FMUs"}
    assert not (tmp_path / "out" / "margins.png").exists()  # no linear loop is known
    assert "not judged: they follow from the equations of a law" in done.stdout


@pytest.mark.slow
def test_a_vehicle_without_a_description_is_told_where_to_write_it(
    command: Command, short_scenario: Callable[..., Path], tmp_path: Path
) -> None:
    """With it the loop is judged. Before, there is no table."""
    short_scenario()
    command("new", "rover", "--vehicle")
    options = ("margins", "short.toml", "--theory", "--plant", "rover.py", *HOLD)
    before = command(*options).stdout
    assert "names their inertia: expected it in NAME.vehicle.toml beside the vehicle" in before
    assert "Margin " not in before
    (tmp_path / "rover.vehicle.toml").write_text('[variables]\ninertia = "mass"\n')
    assert "linear loop" in command(*options).stdout


def test_a_scenario_without_a_hold_is_told_so(command: Command, short_scenario: Callable[..., Path]) -> None:
    short_scenario()
    done = command("margins", "short.toml", "--theory", "--controller", "PidDepthController")
    assert "controller.depth_reference is never constant: expected a hold, or --signal" in done.stdout


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--signal", "plant.depth"), "--signal and --window: expected both, or none of them"),
        (("--over", "controller.adaptation_gain=high"), "expected component.parameter=number,number"),
        (("--theory", "--over", "a.b=1"), "--over: no effect with --theory"),
        ((*HOLD[:1], "plant.dept", *HOLD[2:]), "no variable 'plant.dept'; nearest is 'plant.depth'"),
        ((*HOLD[:3], "0.1", "20"), "window 0.1 to 20 s: expected a part of the run, 0 to 0.2 s"),
        ((*HOLD[:3], "0.2", "0.1"), "window 0.2 to 0.1 s: expected a part of the run"),
        ((*HOLD, "--over", "controller.gamma=1"), "no variable 'controller.gamma'"),
    ],
)
def test_a_wrong_option_is_one_line(
    refused: Callable[..., str], short_scenario: Callable[..., Path], options: tuple[str, ...], message: str
) -> None:
    short_scenario()
    assert message in refused("margins", "short.toml", *options)

"""The hints of messages work when they are followed to the letter."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.described_fmus import described

Command = Callable[..., Any]

BLOCK = """
from dataclasses import dataclass
from fmus import numerics
from fmus.block import Block, variable

@dataclass(frozen=True)
class Parameters:
    internal_step: float = variable(0.1, "Longest internal step", unit="s", min=1e-3, max=1.0)

@dataclass(frozen=True)
class Inputs:
    x: float = variable(0.5, "A number", min=-10.0, max=10.0)

@dataclass(frozen=True)
class State:
    x: float = 0.0

@dataclass(frozen=True)
class Outputs:
    y: float = variable(0.0, "Output")

def step(t, h, s, u, p, c):
    return State({expression})

def output(t, state, p, c):
    return Outputs(state.x)

BLOCK = Block.of_module(__name__, "Counts", "Counts")
"""


@pytest.fixture
def error(command: Command) -> Callable[..., str]:
    """The last line on standard error of a command that must fail with status 1."""
    return lambda *arguments: command(*arguments, expect=1).stderr.splitlines()[-1]


@pytest.mark.parametrize(
    "own",
    [
        {"measured_depth": "gauge", "voltage[1]": "left", "voltage[2]": "right"},
        {"depth": "gauge", "control_force": "thrust"},
    ],
)
def test_the_mappings_that_messages_ask_for_let_another_plant_run(
    error: Callable[..., str], short_scenario: Callable[..., Path], tmp_path: Path, own: dict[str, str]
) -> None:
    """One name after the other, until nothing is refused but an FMU without a library."""
    short_scenario()
    described(tmp_path / "boat.fmu", [name for name in own.values() if name != "gauge"], ("gauge",))
    hints = []
    for _ in own:
        message = error("run", "short.toml", "--plant", "boat.fmu", *hints)
        shown = re.findall(r"--map plant\.(\S+)=NAME", message)
        (name,) = (name for name in shown if name in own)
        hints += ["--map", f"plant.{name}={own[name]}"]
    assert "boat.fmu has no binary" in error("run", "short.toml", "--plant", "boat.fmu", *hints)


def test_open_inputs_at_their_start_values_are_the_rest_of_what_a_message_asks_for(
    error: Callable[..., str], short_scenario: Callable[..., Path], tmp_path: Path
) -> None:
    short_scenario()
    described(tmp_path / "boat.fmu", ("left", "right"), ("measured_depth", "depth_rate"))
    message = error("run", "short.toml", "--plant", "boat.fmu")
    (hint,) = re.findall(r"; (--open-inputs start) leaves its inputs at their start values", message)
    followed = error("run", "short.toml", "--plant", "boat.fmu", *hint.split())
    assert "boat.fmu has no binary" in followed


def test_the_nearest_name_for_a_mapping_can_be_given_as_it_is_shown(
    error: Callable[..., str], short_scenario: Callable[..., Path], tmp_path: Path
) -> None:
    short_scenario()
    described(tmp_path / "boat.fmu", ("left", "right"), ("gauge", "speed"))
    options = ("run", "short.toml", "--plant", "boat.fmu")
    message = error(*options, "--map", "plant.measured_dept=gauge")
    (nearest,) = re.findall(r"nearest is '(\S+)'$", message)
    still_lacking = "plant is boat.fmu, which lacks voltage[1], voltage[2];"
    assert still_lacking in error(*options, "--map", f"{nearest}=gauge")


@pytest.mark.parametrize("name", ["score", "tune"])
def test_the_options_that_the_help_shows_are_taken_and_others_are_not(
    command: Command, error: Callable[..., str], name: str
) -> None:
    """Without --plant both commands know one component, the controller: others are refused, not ignored."""
    described_in_help = " ".join(command(name, "--help").stdout.replace("│", " ").split())
    assert "component" not in described_in_help
    assert "Set controller.variable=value; with --plant plant.variable=value." in described_in_help
    for option in ("--set plant.mass=3.0", "--map plant.voltage[1]=left"):
        message = error(name, "PidDepthController", *option.split())
        assert message.startswith(f"l1-depth: {option.partition('=')[0]}: expected controller.")
    assert "--set controller: expected" in error(name, "PidDepthController", "--set", "controller=x.fmu")


def test_the_mappings_that_messages_ask_for_give_a_vehicle_to_tune(
    error: Callable[..., str], tmp_path: Path
) -> None:
    """One after the other, until nothing is refused but an FMU without a library."""
    described(tmp_path / "boat.fmu", ("thrust",), ("z",))
    options = ("tune", "PidDepthController", "--free", "kp=1:2", "--plant", "boat.fmu")
    own, hints = {"depth": "z", "control_force": "thrust"}, list[str]()
    for _ in own:
        (hint,) = re.findall(r"(--map \S+)=NAME", error(*options, *hints))
        hints += f"{hint}={own[hint.partition('plant.')[2]]}".split()
    assert "boat.fmu has no binary" in error(*options, *hints, "--evaluations", "1", "--seeds", "1")


@pytest.mark.parametrize(
    "expression",
    [
        "sum(s.x for _ in range(int(u.x)))",
        "sum(s.x for _ in range(1, int(u.x)))",
        "sum(s.x for _ in range(round(u.x)))",
        "(1.0, 2.0)[int(u.x)]",
    ],
)
def test_what_is_advised_in_place_of_an_expression_is_not_refused(
    command: Command, error: Callable[..., str], tmp_path: Path, expression: str
) -> None:
    """A constant number of turns, or a choice: `trunc` would be refused in the same place."""
    followed = {
        "use a constant number of turns": "sum(s.x for _ in range(3))",
        "use fmus.numerics.choose": "numerics.choose(u.x, (1.0, 2.0))",
    }
    block = tmp_path / "counts.py"
    block.write_text(BLOCK.replace("{expression}", expression))
    advice = error("build", "counts.py").rpartition("; ")[2]
    block.write_text(BLOCK.replace("{expression}", followed[advice]))
    command("build", "counts.py")

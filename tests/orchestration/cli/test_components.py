"""Options --controller and --plant: each puts an FMU, a block or a Python file in a component's place."""

import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from orchestration.cli import chosen_scenario
from orchestration.cli.changes import Changes
from orchestration.results.recording import Recording
from tests.described_fmus import described

Command = Callable[..., Any]

BOAT = """
from dataclasses import dataclass

from fmus.block import Block, variable
from fmus.numerics import clip


@dataclass(frozen=True)
class Inputs:
    control_force: float = variable(0.0, "Force, positive down", unit="N", min=-6.0, max=6.0)


@dataclass(frozen=True)
class State:
    depth: float = 0.0
    rate: float = 0.0


@dataclass(frozen=True)
class Outputs:
    depth: float = variable(0.0, "Depth, positive down", unit="m")


def step(t, h, s, u, p, _):
    rate = s.rate + h * (clip(u.control_force, -6.0, 6.0) - 2.5 * s.rate) / 5.5
    return State(s.depth + h * rate, rate)


def output(t, s, p, _):
    return Outputs(s.depth)


BOAT = Block.of_module(__name__, "Boat", "A mass of 5.5 kg with linear damping", step_size=0.02)
"""

PROPORTIONAL = """
from dataclasses import dataclass

from fmus.block import Block, variable


@dataclass(frozen=True)
class Inputs:
    depth_reference: float = variable(0.0, "Reference", unit="m")
    measured_depth: float = variable(0.0, "Depth", unit="m")


@dataclass(frozen=True)
class State:
    force: float = 0.0


@dataclass(frozen=True)
class Outputs:
    control_force: float = variable(0.0, "Force, positive down", unit="N")


def step(t, h, s, u, p, _):
    return State(10.0 * (u.depth_reference - u.measured_depth))


def output(t, s, p, _):
    return Outputs(s.force)


P = Block.of_module(__name__, "Proportional", "Proportional control", step_size=0.02)
"""
NO_FIGURE = ("--formats", "none")
OURS = {"controller": "L1DepthController", "plant": "RovDepthPlant"}
FILES = {"controller": PROPORTIONAL, "plant": BOAT}


@pytest.mark.parametrize("component", OURS)
def test_an_fmu_a_block_and_a_python_file_take_the_place_of_a_component(
    command: Command,
    built: Mapping[str, Path],
    short_scenario: Callable[..., Path],
    tmp_path: Path,
    component: str,
) -> None:
    """Our own FMU under another name leaves the recording as it is."""
    short_scenario()
    shutil.copy(built[OURS[component]], tmp_path / "my.fmu")
    (tmp_path / "own.py").write_text(FILES[component])
    for options in ((), *((f"--{component}", fmu) for fmu in ("my.fmu", OURS[component], "own.py"))):
        command("run", "short.toml", *options, *NO_FIGURE)
    results = tmp_path / "results"
    ours, other, block = (
        (results / f"{name}.csv").read_text().splitlines()[1:]
        for name in ("short", "short-my", f"short-{OURS[component]}")
    )
    assert ours == other == block
    (own,) = results.glob(f"short-{'Boat' if component == 'plant' else 'Proportional'}.json")
    document = json.loads(own.read_text())
    assert document["scenario"]["title"] == f"short, {component} {own.stem.removeprefix('short-')}"


@pytest.mark.parametrize("component", OURS)
def test_a_scenario_without_the_component_has_none_to_replace(
    refused: Callable[..., str], tmp_path: Path, component: str
) -> None:
    (tmp_path / "one.toml").write_text(
        '[components]\nblock = "ExamplePlant"\n[experiment]\nstop_time = 1\nstep_size = 0.1\n'
    )
    message = refused("run", "one.toml", f"--{component}", "L1Controller")
    assert f"no component '{component}' to replace; known: 'block'" in message


@pytest.mark.parametrize("component", OURS)
def test_one_option_gives_a_component_once(
    refused: Callable[..., str], short_scenario: Callable[..., Path], component: str
) -> None:
    short_scenario()
    message = refused("run", "short.toml", f"--{component}", "a.fmu", "--set", f"{component}=b.fmu")
    assert f"{component} = b.fmu: expected one FMU, got a.fmu too" in message


@pytest.mark.parametrize(
    ("changes", "source"),
    [
        ({"controller": "P.fmu"}, "allocation.voltage[1]"),
        ({"plant": "Boat.fmu"}, "controller.demanded_force"),
        ({"plant": "Boat.fmu", "controller": "PidDepthController"}, "controller.demanded_force"),
        ({"plant": "Boat.fmu", "controller": "P.fmu"}, "controller.control_force"),
    ],
)
def test_force_and_voltages_meet(
    short_scenario: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    changes: dict[str, Any],
    source: str,
) -> None:
    """Each of a controller and a vehicle has voltages or a force; a vehicle without a sensor, its depth."""
    monkeypatch.chdir(tmp_path)
    short_scenario()
    described(tmp_path / "P.fmu", ("depth_reference", "measured_depth"), ("control_force",))
    described(tmp_path / "Boat.fmu", ("control_force",), ("depth", "depth_rate"))
    system = chosen_scenario.load("short.toml", changes=Changes.of_options(**changes)).system
    actuator = "voltage[1]" if "plant" not in changes else "control_force"
    joined = {target: given for given, target, *_ in system.connections}
    assert joined[f"plant.{actuator}"] == source
    assert ("allocation" in system.components) == (source == "allocation.voltage[1]")
    sensor = "measured_depth" if "plant" not in changes else "depth"
    assert joined["controller.measured_depth"] == f"plant.{sensor}"


def test_a_disturbance_that_a_vehicle_lacks_is_named(command: Command, tmp_path: Path) -> None:
    """Its constant of the base is not: without a current there is none."""
    described(tmp_path / "boat.fmu", ("voltage[1]", "voltage[2]"), ("depth", "depth_rate", "measured_depth"))
    error = command("run", "hold-current", "--plant", "boat.fmu", expect=1).stderr.splitlines()
    assert "plant is boat.fmu, which lacks initial_depth, current_velocity: left out" in error[0]
    error = command("run", "hold-regular-waves", "--plant", "boat.fmu", expect=1).stderr.splitlines()
    lacks = "initial_depth, wave_pressure_head, wave_velocity, wave_acceleration"
    assert f"plant is boat.fmu, which lacks {lacks}: left out" in error[0]


@pytest.mark.slow
def test_a_vehicle_of_ten_lines_follows_the_laws_of_motion(
    command: Command, short_scenario: Callable[..., Path], tmp_path: Path
) -> None:
    """M z'' = F - D z', by explicit Euler, computed here from the recorded force."""
    short_scenario(2.0)
    (tmp_path / "boat.py").write_text(BOAT)
    command("run", "short.toml", "--plant", "boat.py", "--controller", "PidDepthController", *NO_FIGURE)
    recording = Recording.read(tmp_path / "results" / "short-PidDepthController-Boat.csv")
    depth, rate = 0.0, 0.0
    for recorded, force in zip(recording["plant.depth"], recording["plant.control_force"], strict=True):
        assert recorded == pytest.approx(depth, abs=1e-9)  # the digits of the file
        rate += 0.02 * (force - 2.5 * rate) / 5.5
        depth += 0.02 * rate
    assert depth > 0.0

"""A Python class as the controller of the vehicle: one result wherever it runs, and that of a block's law."""

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.generate import builder
from fmus.registry import Flavour
from orchestration.cli.commands import run_command
from orchestration.many.run_many import run_many
from orchestration.results.recording import Recording
from orchestration.run import Simulator, simulate
from orchestration.scenarios import scenario
from orchestration.scenarios.fmu_files import fmu_file
from orchestration.scenarios.scenario import Scenario

PID = """
from controller_fmu.baselines import pid
from controller_fmu.depth_interface import DepthInputs
from fmus.block import NoValues

P = pid.Parameters(voltage_limit=2.0)  # small, so that the anti-windup acts


class Pid:
    period = 0.02
    inputs = (
        "depth_reference", "depth_reference_rate", "depth_reference_acceleration", "measured_depth",
        "measured_depth_rate", "roll", "pitch",
    )
    outputs = ("voltage[1]", "voltage[2]")

    def reset(self):
        self.state = None

    def step(self, time, inputs):
        u = DepthInputs(**inputs)
        before = self.state or pid.initial_state(time, u, P, NoValues())
        self.state = pid.step(time, self.period, before, u, P, NoValues())
        first, second = pid.output(time, self.state, P, NoValues()).voltage
        return {"voltage[1]": first, "voltage[2]": second}
"""

LEAD = """
import numpy as np


class Lead:
    period = 0.04
    kp = 16.5
    kd = 14.0
    seed = 3

    def reset(self):
        self.depth = None
        self.random = np.random.default_rng(self.seed)

    def step(self, time, inputs):
        depth = inputs["measured_depth"]
        rate = 0.0 if self.depth is None else (depth - self.depth) / self.period
        self.depth = depth
        error = inputs["depth_reference"] - depth
        force = self.kp * error - self.kd * rate + 0.001 * self.random.normal()
        return {"control_force": np.clip(force, -6.0, 6.0)}
"""


VOLTAGES = ("controller.voltage[1]", "controller.voltage[2]")


@pytest.fixture
def lead(tmp_path: Path, scenario_fmus: None) -> str:
    (tmp_path / "lead.py").write_text(LEAD)
    return f"{tmp_path / 'lead.py'}:Lead"


def loaded(
    controller: str,
    flavour: Flavour = Flavour.NATIVE,
    stop: float = 5.0,
    recorded: tuple[str, ...] = ("controller.control_force",),
    **parameters: Any,
) -> Scenario:
    """The dive without noise of the sensor, whose first measurement is so the reference."""
    overrides: dict[str, Any] = {
        "experiment": {"stop_time": stop},
        "record": dict.fromkeys(recorded, True),
        "metrics": dict.fromkeys(("settling_time", "overshoot", "holding_thrust", "lag"), False),
    }
    settings = {"controller": controller, "plant.sensor_noise": 0.0}
    given = {f"controller.{name}": value for name, value in parameters.items()}
    path, settings = scenario.find("nominal-extended"), settings | given
    made = {str(Path(controller).absolute()): fmu_file(controller)}
    return scenario.load(path, overrides, flavour, settings=settings, made=made)


def run(chosen: Scenario, **options: Any) -> Recording:
    return simulate(chosen.system, chosen.experiment, **options)


def test_the_law_of_a_block_gives_the_recording_of_the_block(
    tmp_path: Path, scenario_fmus: None, python_fmus: None
) -> None:
    """The same functions on the same numbers, but for the step that they integrate over.

    The class takes its period of 0.02 s, the block the distance of two communication points, which rounding
    moves by 1e-15 s at 10 s: an error of 0.1 m and ki = 5.5 N/(m.s) in 500 steps make 3e-13 N, or 6e-13 V of
    two thrusters of 0.25 N/V. At the start the error is 0 without noise, and so is its integral over a
    step, which the class has at once.
    """
    (tmp_path / "own.py").write_text(PID)
    builder.build_if_stale("PidDepthController", flavour=Flavour.PYTHON)
    own = run(loaded(f"{tmp_path / 'own.py'}:Pid", Flavour.PYTHON, 10.0, VOLTAGES))
    block = run(loaded("PidDepthController", Flavour.PYTHON, 10.0, VOLTAGES, voltage_limit=2.0))
    voltages = block["controller.voltage[1]"]
    assert np.abs(voltages).max() == 2.0
    assert voltages.std() > 0.1  # V: it is no constant
    for name in (*VOLTAGES, "plant.depth", "plant.total_force"):
        np.testing.assert_allclose(own[name], block[name], rtol=0.0, atol=1e-11)


@pytest.mark.slow
def test_one_recording_wherever_and_however_often_it_runs(lead: str) -> None:
    """In this process, after a reset, in a process of its own, in those of many runs; with other gains."""
    chosen = loaded(lead)
    first = run(chosen)
    assert first["controller.control_force"].std() > 0.1  # N
    with Simulator(chosen.system) as simulator:
        again = [simulator.run(chosen.experiment) for _ in range(2)]
    apart = run(chosen, timeout=60.0)
    softer = replace(chosen.experiment, parameters={**chosen.experiment.parameters, "controller.kp": 8.0})
    many = [*run_many(chosen.system, [chosen.experiment, softer, chosen.experiment], workers=1)]
    for other in (*again, apart, many[0], many[2]):
        assert isinstance(other, Recording)
        assert np.array_equal(other.values, first.values)
    assert not np.array_equal(many[1].values, first.values)
    assert np.array_equal(many[1].values, run(loaded(lead, kp=8.0)).values)


@pytest.mark.slow
def test_a_scenario_file_names_it_relative_to_itself(lead: str, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(
        'base = "nominal-extended"\n[components]\ncontroller = "lead.py:Lead"\n'
    )
    components = scenario.load_scenario(tmp_path / "mine.toml").system.components
    assert components["controller"] == loaded(lead).system.components["controller"]
    assert "allocation" in components


@pytest.mark.slow
def test_the_command_tunes_it(lead: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    file = lead.rpartition("/")[2]
    small = (
        "--free",
        "kp=1:20",
        "--evaluations",
        "2",
        "--cases",
        "hold-step",
        "--seeds",
        "1",
        "--workers",
        "1",
    )
    assert not run_command(["tune", file, *small])
    written = tomllib.loads(Path("results/Lead.toml").read_text())["parameters"]
    assert 1.0 <= written["controller.kp"]["value"] <= 20.0

"""Disturbed vehicles against frequency responses in closed form, and the figures of the page."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.registry import Flavour, fmu_path
from orchestration.results import metrics
from orchestration.results.recording import Recording
from orchestration.run import simulate
from orchestration.scenarios import scenario
from orchestration.system.experiment import Experiment
from orchestration.system.open_inputs import OpenInputs
from orchestration.system.signals import Signal, sine
from orchestration.system.system import System

PAGE = Path(__file__).parents[2] / "docs" / "explanation" / "disturbances.md"
OMEGA = 2.0 * math.pi * 0.2  # rad/s
DEEP: dict[str, Any] = {
    "plant.initial_depth": 5.0,
    "plant.net_weight": 0.0,
    "plant.free_surface": False,
    "plant.thruster_ideal": True,
    "plant.sensor_ideal": True,
}


def rows() -> dict[str, list[str]]:
    """Scenario -> the cells of its row in the page's table of figures."""
    lines = [line.strip("| \n").split("|") for line in PAGE.read_text(encoding="utf-8").splitlines()]
    return {
        cells[0].strip(" `"): cells[1:] for cells in lines if cells[0].startswith("`hold-") and len(cells) > 4
    }


@pytest.mark.parametrize("name", [name for name in scenario.shipped() if name.startswith("hold-")])
@pytest.mark.parametrize(("augmentation", "first"), [("pi", 0), ("none", 3)])
def test_the_page_shows_the_figures_of_the_scenarios(
    scenario_fmus: None, name: str, augmentation: str, first: int
) -> None:
    loaded = scenario.load(scenario.find(name), settings={"controller.augmentation": augmentation})
    measured = metrics.evaluate(simulate(loaded.system, loaded.experiment), loaded.metrics)
    shown = rows()[name][first : first + 3]
    for metric, cell in zip(("rmse", "peak_error", "recovery_time"), shown, strict=False):
        assert (metric in measured) == bool(cell.strip())
        if metric in measured:
            assert float(cell) == pytest.approx(measured[metric], rel=6e-3), metric  # three digits


def disturbed(
    force: Signal, stop: float, step: float, connections: list[Any] | None = None, **values: float
) -> Recording:
    """A vehicle under water and without weight, which a force acts on."""
    plant = fmu_path("RovDepthPlant", Flavour.NATIVE)
    named = {f"plant.{name}": value for name, value in values.items()}
    experiment = Experiment(
        stop, step, parameters=DEEP | {"plant.internal_step": step} | named,
        signals={"plant.external_force": force},
        record=("plant.depth",), open_inputs=OpenInputs.START,
    )  # fmt: skip
    return simulate(System({"plant": plant}, connections or []), experiment)


@pytest.mark.parametrize(("stiffness", "damping"), [(20.0, 10.0), (4.0, 30.0)])
def test_a_pd_controlled_vehicle_answers_a_sine_as_its_frequency_response_says(
    scenario_fmus: None, stiffness: float, damping: float
) -> None:
    """z = 1 N / (k_p - M w^2 + j w (D + k_d)): u = -k_p (z - 5 m) - k_d z', by two connections with a factor.

    Voltages are held for 1 ms after a measurement 1 ms old, which takes about 1.5 ms k_p from the damping.
    """
    gain, step = 0.25, 0.001
    proportional = {"factor": -stiffness / gain, "offset": 5.0 * stiffness / gain}
    connections = [
        ("plant.depth", "plant.voltage[1]", proportional),
        ("plant.depth_rate", "plant.voltage[2]", {"factor": -damping / gain}),
    ]
    own = disturbed(sine(1.0, 0.2), 60.0, step, connections, quadratic_damping=0.0)
    late = own.time >= 40.0  # four periods, after ten time constants
    angle = OMEGA * own.time[late]
    basis = np.column_stack([np.sin(angle), np.cos(angle), np.ones_like(angle)])
    (real, imaginary, mean), *_ = np.linalg.lstsq(basis, own["plant.depth"][late], rcond=None)
    exact = 1.0 / (stiffness - 5.5 * OMEGA**2 + 1j * OMEGA * (2.5 + damping))
    assert mean == pytest.approx(5.0, abs=1e-4)
    assert abs(complex(real, imaginary) - exact) < 2e-3 * abs(exact)

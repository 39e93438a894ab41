"""Synthetic dives of the shipped vehicle, whose parameters are known."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from orchestration import Experiment, Recording, run_many
from orchestration.studies.fit.dive import Dive
from orchestration.studies.vehicle import Vehicle
from orchestration.system.system import System
from tests.orchestration.studies.fit.dives import COMMANDS, TRUE, as_dive
from tests.shared_builds import Fmus


@pytest.fixture(scope="session")
def vehicle(built: Fmus) -> Vehicle:
    assert built["RovDepthPlant"].is_file()
    return Vehicle.of("RovDepthPlant")


@pytest.fixture(scope="session")
def recorded(built: Fmus) -> Callable[..., list[Recording]]:
    """Recordings of dives with other seeds of the sensor's noise, or other parameters."""

    def run(count: int = 1, **parameters: Any) -> list[Recording]:
        experiment = Experiment(
            stop_time=60.0,
            step_size=0.02,
            parameters={**TRUE, **{f"plant.{name}": value for name, value in parameters.items()}},
            signals={f"plant.{name}": command for name, command in COMMANDS.items()},
            record=["plant.depth", "plant.measured_depth"],
            open_inputs="start",
        )
        seeds = [{**experiment.parameters, "plant.sensor_seed": seed} for seed in range(1, count + 1)]
        runs = (replace(experiment, parameters=values) for values in seeds)
        return [*run_many(System({"plant": built["RovDepthPlant"]}), runs)]

    return run


@pytest.fixture(scope="session")
def dive(recorded: Callable[..., list[Recording]]) -> Callable[..., Dive]:
    """A dive with the readings of the vehicle's own sensor, every 40 ms, noisy and in steps of 2 mm."""

    def made(name: str = "dive", **parameters: Any) -> Dive:
        (run,) = recorded(**parameters)
        return as_dive(run, run["plant.measured_depth"], name)

    return made

"""The paper's vehicle with the ranges that it ships with, and its designs."""

import pytest

from orchestration.design.rules import Conditions, L1Design, PidDesign, design_l1, design_pid
from orchestration.design.vehicle_data import VehicleData, data_of, draws_of
from orchestration.score.vehicle import Vehicle

CONDITIONS = Conditions(step=0.02, speed=0.02, depth=0.8)  # of the paper's trajectory


@pytest.fixture(scope="session", autouse=True)
def _built(scenario_fmus: None) -> None:
    """The FMUs of the scenarios are built."""


@pytest.fixture(scope="session")
def conditions() -> Conditions:
    return CONDITIONS


@pytest.fixture(scope="session")
def data(scenario_fmus: None) -> VehicleData:
    vehicle = Vehicle.of_base("vehicle")
    return data_of(vehicle, draws_of(vehicle))


@pytest.fixture(scope="session")
def l1(data: VehicleData) -> L1Design:
    return design_l1(data, CONDITIONS)


@pytest.fixture(scope="session")
def pid(data: VehicleData) -> PidDesign:
    return design_pid(data, CONDITIONS)

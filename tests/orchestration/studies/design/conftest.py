"""Vehicles with the ranges that they ship with, and their designs."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache

import pytest

from orchestration.studies.design.rules import Conditions, L1Design, PidDesign, design_l1, design_pid
from orchestration.studies.design.vehicle_data import Draws, VehicleData, data_of, draws_of
from orchestration.studies.margins import linear_margins
from orchestration.studies.vehicle import Vehicle
from tests.shared_builds import Fmus

CONDITIONS = Conditions(step=0.02, speed=0.02, depth=0.8)  # of the paper's trajectory


@dataclass(frozen=True)
class Designed:
    """A vehicle, what it varies, its data, and its designs."""

    vehicle: Vehicle
    draws: Draws
    data: VehicleData
    l1: L1Design
    pid: PidDesign


@cache
def _designed(name: str) -> Designed:
    vehicle = Vehicle.of(name)
    draws = draws_of(vehicle)
    data = data_of(vehicle, draws)
    return Designed(vehicle, draws, data, design_l1(data, CONDITIONS), design_pid(data, CONDITIONS))


@pytest.fixture(scope="session", autouse=True)
def _built(built: Fmus) -> None:
    """The FMUs of vehicles that are designed for, and of the controllers that are, are built."""
    vehicles = "RovDepthPlant", "RovHeavePitchPlant", "BlueRov2Plant"
    assert all(built[name].is_file() for name in (*vehicles, "L1DepthController", "PidDepthController"))


@pytest.fixture(scope="session", autouse=True)
def _coarse() -> Iterator[None]:
    """Margins are sought between an eighth of the frequencies: those of these loops lie far apart."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(linear_margins, "_PER_DECADE", 50)
        yield


@pytest.fixture(scope="session")
def designed() -> Callable[[str], Designed]:
    """Returns the design for a block, made once."""
    return _designed


@pytest.fixture
def conditions() -> Conditions:
    return CONDITIONS


@pytest.fixture
def data(designed: Callable[[str], Designed]) -> VehicleData:
    return designed("RovDepthPlant").data


@pytest.fixture
def l1(designed: Callable[[str], Designed]) -> L1Design:
    return designed("RovDepthPlant").l1


@pytest.fixture
def pid(designed: Callable[[str], Designed]) -> PidDesign:
    return designed("RovDepthPlant").pid

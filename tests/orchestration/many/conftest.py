from collections.abc import Mapping
from pathlib import Path

import pytest

from orchestration import Ensemble, System
from orchestration.many.device import Device
from tests.orchestration.many.host_device import HostDevice
from tests.orchestration.many.instances import CONNECTIONS
from tests.shared_builds import built_once, session_folder


@pytest.fixture(scope="session")
def system(built: Mapping[str, Path], tmp_path_factory: pytest.TempPathFactory) -> System:
    """The vehicle and its controller, compiled for groups of instances once a session."""
    vehicle = System({"plant": built["RovDepthPlant"], "controller": built["L1DepthController"]}, CONNECTIONS)
    built_once(
        session_folder(tmp_path_factory, "ensemble") / "vehicle", lambda path: Ensemble(vehicle).close()
    )
    return vehicle


@pytest.fixture(params=[None, HostDevice()], ids=["processor", "device"])
def device(request: pytest.FixtureRequest) -> Device | None:
    """Where an ensemble runs: in vectors, or by the program of a GPU."""
    return request.param

from contextlib import suppress

import pytest

from orchestration.many.ensemble_loop import Device

DEVICES: list[Device | None] = [None]
with suppress(ModuleNotFoundError):  # where the room is removed
    from tests.orchestration.places.host_device import HostDevice

    DEVICES.append(HostDevice())


@pytest.fixture(params=DEVICES, ids=["processor", "device"][: len(DEVICES)])
def device(request: pytest.FixtureRequest) -> Device | None:
    """Where an ensemble runs: in vectors, or by the program of a GPU."""
    return request.param

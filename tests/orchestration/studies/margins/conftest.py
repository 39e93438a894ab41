"""The shipped FMUs for the tests of margins."""

import pytest

from tests.shared_builds import Fmus


@pytest.fixture(scope="session", autouse=True)
def _built(built: Fmus) -> None:
    """The FMUs of the scenarios that are judged here are built, and one of a vehicle that is described."""
    own = "RovDepthPlant", "L1DepthController", "ExamplePlant", "L1Controller", "DepthReference"
    assert all(built[name].is_file() for name in (*own, "BlueRov2Plant"))

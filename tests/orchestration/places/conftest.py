"""The sweeps of the room below, which run in other places too."""

import pytest

from tests.orchestration.sweep.conftest import planned, sweep_file

__all__ = ["planned", "sweep_file"]


@pytest.fixture(scope="session", autouse=True)
def _built(scenario_fmus: None) -> None:
    """Every block's FMU stands where the shipped sweeps find it."""

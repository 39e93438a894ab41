"""Its tests run our blocks."""

import pytest

from orchestration.study.protocol import Protocol, read_protocol


@pytest.fixture(scope="session", autouse=True)
def _built(scenario_fmus: None) -> None:
    """Every block's FMU stands where scenarios find it."""


@pytest.fixture(scope="session")
def protocol() -> Protocol:
    return read_protocol()

"""The shipped FMUs for the tests of margins."""

import pytest


@pytest.fixture(scope="session", autouse=True)
def _built(scenario_fmus: None) -> None:
    """The FMUs of the scenarios are built."""

"""Its tests run scenarios."""

import pytest


@pytest.fixture(scope="session", autouse=True)
def _built(scenario_fmus: None) -> None:
    """Every block's FMU stands where scenarios find it."""

"""What the tests of the master share."""

from collections.abc import Iterator

import cloudpickle
import pytest


@pytest.fixture
def importable(request: pytest.FixtureRequest) -> Iterator[None]:
    """A file that pytest alone can import; what it defines travels with what is run."""
    cloudpickle.register_pickle_by_value(request.module)
    yield
    cloudpickle.unregister_pickle_by_value(request.module)

"""The pair of the comparison, built once, and the C program that gives what must come out."""

from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version

import pytest

from tests.speed import pair as pair_module
from tests.speed.importers import LOOPS, Bare
from tests.speed.pair import Pair


@pytest.fixture(scope="session")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    return pair_module.build(tmp_path_factory.mktemp("pair"))


@pytest.fixture(scope="session")
def bare(pair: Pair) -> Bare:
    return Bare(pair)


@pytest.fixture
def installed() -> Callable[[str], str]:
    """The loop's name, if its importer is installed."""

    def check(loop: str) -> str:
        try:
            version(LOOPS[loop].distribution)
        except PackageNotFoundError:
            pytest.fail(f"{LOOPS[loop].distribution} is not installed: .ci/run installs it")
        return loop

    return check

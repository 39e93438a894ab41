"""The pair of the comparison, built once, and the C program that gives what must come out."""

import pytest

from tests.speed import pair as pair_module
from tests.speed.importers import Bare
from tests.speed.pair import Pair


@pytest.fixture(scope="session")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    return pair_module.build(tmp_path_factory.mktemp("pair"))


@pytest.fixture(scope="session")
def bare(pair: Pair) -> Bare:
    return Bare(pair)

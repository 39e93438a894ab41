"""What tests share: FMUs built once a session, and small helpers around blocks."""

from pathlib import Path

import pytest

from fmus import catalogue
from fmus.block import Block
from fmus.instance import Instance


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Every block's FMU, freshly built, by name."""
    folder = tmp_path_factory.mktemp("built")
    return {name: catalogue.build(name, folder) for name in catalogue.block_names()}


@pytest.fixture(scope="session", autouse=True)
def _fmus_of_the_scenarios() -> None:
    """Scenarios find the present blocks' FMUs in the default folder, as after `l1-depth build`."""
    for name in catalogue.block_names():
        catalogue.build_if_stale(name)


class Driver:
    """An instance whose variables go by name."""

    def __init__(self, block: Block, **values: float) -> None:
        self.instance = Instance(block, "test")
        self.references = {v.name: v.value_reference for v in block.variables}
        for name, value in values.items():
            self[name] = value

    def __getitem__(self, name: str) -> float:
        return self.instance.get(self.references[name])

    def __setitem__(self, name: str, value: float) -> None:
        self.instance.set(self.references[name], value)

    def begin(self, t: float = 0.0) -> "Driver":
        self.instance.start(t)
        self.instance.begin_stepping()
        return self

    def step(self, h: float) -> "Driver":
        self.instance.do_step(self.instance.time, h)
        return self


@pytest.fixture(scope="session")
def driver() -> type[Driver]:
    return Driver

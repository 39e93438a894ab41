"""Its tests run our blocks."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import tomli_w

from orchestration.studies.score.protocol import Protocol, read_protocol


@pytest.fixture(scope="session", autouse=True)
def _built(scenario_fmus: None) -> None:
    """Every block's FMU stands where scenarios find it."""


@pytest.fixture(scope="session")
def protocol() -> Protocol:
    return read_protocol()


@pytest.fixture(scope="session")
def small_protocol(protocol: Protocol, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Writes a protocol of two cases, one controller and three plants, with changes to its tables."""

    def write(**changes: Any) -> Path:
        data = dict(protocol.file.data)
        data["cases"] = {name: data["cases"][name] for name in ("nominal", "hold-step")}
        data["cost"] = {**data["cost"], "cases": ["nominal"]}
        data["controllers"] = {"l1-pi": data["controllers"]["l1-pi"]}
        data["plants"] = {**data["plants"], "count": 3}
        data["repetitions"] = 2
        path = tmp_path_factory.mktemp("protocol") / "small.toml"
        path.write_text(tomli_w.dumps(data | changes), encoding="utf-8")
        return path

    return write

"""A scenario whose signals are components is the same experiment."""

from pathlib import Path

import numpy as np
import pytest

from orchestration.errors import ScenarioError
from orchestration.exchange.signal_sources import with_sources
from orchestration.master import simulate
from orchestration.scenarios import scenario


@pytest.mark.parametrize(
    ("name", "rounding"), [("nominal-extended", 0.0), ("nominal-extended-smooth", 1e-11)]
)
def test_the_run_is_the_scenarios_own(name: str, rounding: float) -> None:
    """Bit by bit; a smooth ramp but for the rounding of s^3, a product in C and a power in Python."""
    chosen = scenario.load(scenario.find(name))
    system, experiment = with_sources(chosen)
    own, driven = simulate(chosen.system, chosen.experiment), simulate(system, experiment)
    assert driven.names[0] == "depth_reference.depth_reference"
    np.testing.assert_allclose(driven.values, own.values, rtol=0.0, atol=rounding)


def refused(tmp_path: Path, declared: str) -> str:
    path = tmp_path / "mine.toml"
    path.write_text(f'base = "nominal-l1"\n[signals."controller.depth_reference"]\n{declared}\n')
    with pytest.raises(ScenarioError) as caught:
        with_sources(scenario.load(path))
    return str(caught.value)


def test_a_cosine_is_refused() -> None:
    chosen = scenario.load(scenario.find("example-l1"))
    with pytest.raises(ScenarioError, match=r"controller\.reference: expected kind = 'ramps'.* got 'cosine'"):
        with_sources(chosen)


def test_more_points_than_the_block_has_are_refused(tmp_path: Path) -> None:
    points = [[float(i), 0.1] for i in range(13)]
    assert "expected at most 12 points, got 13" in refused(tmp_path, f'kind = "ramps"\npoints = {points}')

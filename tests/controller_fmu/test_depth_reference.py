"""The reference block against the scenarios' own ramps."""

from typing import Any

import numpy as np
import pytest

from controller_fmu.depth_reference import BLOCK, POINTS
from fmus.block.instance import BlockError
from orchestration.system.signal_derivatives import derivative
from orchestration.system.signals import Ramps

ROUNDING = 1e-12  # of a depth of 1 m; both evaluate the same formula


def reference(driver: Any, points: list[tuple[float, float]], **values: Any) -> Any:
    for i, (t, depth) in enumerate(points, start=1):
        values |= {f"point_time[{i}]": t, f"point_depth[{i}]": depth}
    return driver(BLOCK, **values)


def spread(seed: int) -> list[tuple[float, float]]:
    """As many points as there is room for, at random."""
    random = np.random.default_rng(seed)
    times = np.cumsum(random.uniform(0.1, 30.0, POINTS)) - 20.0
    return [(float(t), float(z)) for t, z in zip(times, random.uniform(-1.0, 1.0, POINTS), strict=True)]


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_it_gives_what_the_scenarios_ramps_give(driver: Any, smooth: bool, seed: int) -> None:
    points = spread(seed)
    expected = Ramps(points, smooth)
    block = reference(driver, points, smooth=smooth).begin(-30.0)
    while block.instance.time < points[-1][0] + 10.0:
        assert block["depth_reference"] == pytest.approx(expected(block.instance.time), abs=ROUNDING)
        block.step(0.37)


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_its_derivatives_are_those_of_the_scenarios_signals(driver: Any, smooth: bool, seed: int) -> None:
    """Also at the points themselves: those of the time after them."""
    points = spread(seed)
    rate, acceleration = (derivative(Ramps(points, smooth), order) for order in (1, 2))
    for t in (-30.0, *(t + shift for t, _ in points for shift in (0.0, 0.03))):
        block = reference(driver, points, smooth=smooth).begin(t)
        assert block["depth_reference_rate"] == pytest.approx(rate(t), abs=ROUNDING)
        assert block["depth_reference_acceleration"] == pytest.approx(acceleration(t), abs=ROUNDING)


def test_a_long_step_gives_the_same_as_many_short_ones(driver: Any) -> None:
    one, many = driver(BLOCK).begin(), driver(BLOCK).begin()
    one.step(20.0)
    many.step(0.02, count=1000)
    assert one["depth_reference"] == pytest.approx(0.4, abs=ROUNDING)
    assert many["depth_reference"] == pytest.approx(0.4, abs=ROUNDING)


def test_points_out_of_order_are_refused_by_name(driver: Any) -> None:
    with pytest.raises(BlockError, match=r"expected point_time\[3\] later than point_time\[2\]"):
        driver(BLOCK, **{"point_time[3]": 40.0}).begin()

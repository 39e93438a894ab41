"""Every law with each of its gains at 0: where it comes to rest, a limit of its force moves no rest."""

from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from controller_fmu.baselines import adrc, mrac, pid, sliding_mode, super_twisting
from controller_fmu.l1 import depth_controller
from controller_fmu.l1.parameters import Augmentation
from controller_fmu.observer import VelocitySource
from fmus.block import Block
from fmus.block.block_file import blocks_in, write_new_block

from .assumed_vehicle import moved

H = 0.1  # s
STOP_TIME = 50.0  # s
WEIGHT = 1.0  # N, downwards: what a proportional law alone leaves as an error
# m, of the last 10 s: between the 4 mm by which L1's estimates still move and the 1.7 m of a wound-up law
REST = 0.01
LIMITED, FREE = {"voltage_limit": 12.0, "force_limit": 6.0}, {"voltage_limit": 1e4, "force_limit": 1e4}
OF_ALL = {
    "velocity_source": VelocitySource.MEASURED, "augmentation": Augmentation.PI, "integral_gain": 0.5,
    "internal_step": H, "observer_period": H, "period": H,
}  # fmt: skip
NO_GAINS = ("limit", "table", "observer")


def started(block: Block, values: dict[str, Any]) -> Any:
    p = block.parameters()
    return replace(p, **{name: value for name, value in (OF_ALL | values).items() if hasattr(p, name)})


def gains(block: Block) -> list[str]:
    """The scalar tunable parameters that may be 0 and are not, but limits and tables."""
    start = vars(block.parameters())
    tunable = [v for v in block.of_causality("parameter") if v.variability == "tunable"]
    names = [v.name for v in tunable if v.type == "Real" and v.refuse(0.0) is None and start.get(v.name)]
    return [name for name in names if not any(word in name for word in NO_GAINS)]


def depths(block: Block, p: Any) -> np.ndarray:
    """Depths [m] from rest at the surface to a reference of 3 m."""
    calculated, z, v, rows = block.calculate(p), 0.0, 0.0, []
    names = {declared.name for declared in fields(block.inputs)}

    def inputs() -> Any:
        values = {"depth_reference": 3.0, "measured_depth": z, "measured_depth_rate": v}
        return block.inputs(**{name: value for name, value in values.items() if name in names})

    state = block.initial_state(0.0, inputs(), p, calculated)
    for k in range(round(STOP_TIME / H)):
        given = block.output(k * H, state, p, calculated)
        force = given.control_force if hasattr(given, "control_force") else 0.25 * sum(given.voltage)
        state = block.step(k * H, H, state, inputs(), p, calculated)
        z, v = moved(H, z, v, force + WEIGHT)
        rows.append(z)
    return np.array(rows)


def assert_a_limit_moves_no_rest(block: Block, gain: str, value: float) -> bool:
    """Returns whether there is a rest."""
    limited, free = (depths(block, started(block, {gain: value, **limits})) for limits in (LIMITED, FREE))
    assert np.isfinite(limited).all(), gain
    last = round(10.0 / H)
    if np.ptp(free[-last:]) > REST:
        return False
    np.testing.assert_allclose(limited[-last:], free[-1], rtol=0.0, atol=2.0 * REST, err_msg=gain)
    return True


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Block]:
    """The block of `l1-depth new pid`."""
    (file, *_) = write_new_block("pid", tmp_path_factory.mktemp("new"))
    with blocks_in(file) as (block,):
        yield block


@pytest.mark.parametrize("law", [pid, mrac, sliding_mode, super_twisting, adrc, depth_controller])
def test_a_shipped_law_without_one_of_its_gains_rests_where_it_would_without_a_limit(law: Any) -> None:
    rests = [assert_a_limit_moves_no_rest(law.BLOCK, gain, 0.0) for gain in gains(law.BLOCK)]
    assert not rests or any(rests)


@pytest.mark.parametrize("value", [0.0, 1e-6])
def test_a_new_block_without_one_of_its_gains_rests_where_it_would_without_a_limit(
    template: Block, value: float
) -> None:
    assert set(gains(template)) >= {"kp", "ki", "kd"}
    rests = {gain: assert_a_limit_moves_no_rest(template, gain, value) for gain in gains(template)}
    assert rests["ki"]


def test_the_anti_windup_of_a_new_block_still_unwinds_its_integral(template: Block) -> None:
    """A tracking time that never acts leaves the overshoot of an integral that wound up."""
    with_it, without = (
        depths(template, started(template, {"tracking_time": time, **LIMITED})).max() for time in (1.0, 1e6)
    )
    assert with_it < 3.5
    assert without > 4.5

"""The block that turns a force into voltages, against the controller that does so itself."""

from typing import Any

import pytest

from controller_fmu.l1.depth_controller import BLOCK as CONTROLLER
from controller_fmu.thrust_allocation import BLOCK

GAINS = {"thruster_gain[1]": 0.2, "thruster_gain[2]": 0.5, "voltage_limit": 2.0}
TILT = {"roll": 0.3, "pitch": -0.2}


@pytest.mark.parametrize("depth_reference", [0.1, -0.1, 50.0])  # the last one saturates
def test_it_gives_the_voltages_of_a_controller_that_allocates_itself(
    driver: Any, depth_reference: float
) -> None:
    controller = driver(CONTROLLER, **GAINS, **TILT, depth_reference=depth_reference).begin().step(2.0)
    block = driver(BLOCK, **GAINS, **TILT, control_force=controller["demanded_force"]).begin()
    for i in (1, 2):
        assert block[f"voltage[{i}]"] == controller[f"voltage[{i}]"]
    assert (abs(block["voltage[1]"]) == 2.0) == (depth_reference == 50.0)


def test_the_voltages_are_those_of_the_inputs_of_the_last_step(driver: Any) -> None:
    block = driver(BLOCK).begin()
    block["control_force"] = 1.0
    assert block["voltage[1]"] == 0.0
    assert block.step(0.02)["voltage[1]"] == 2.0  # 1 N / (2 * 0.25 N/V)

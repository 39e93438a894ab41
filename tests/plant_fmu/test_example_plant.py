"""The example's plant against the matrix exponential."""

from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from fmus.generate import builder


def test_free_and_forced_response(driver: Any) -> None:
    plant = driver(builder.load_block("ExamplePlant"))
    plant["initial_state[1]"], plant["initial_state[2]"] = 1.0, -0.5
    plant["control"], plant["disturbance"] = 2.0, 0.3
    plant.begin()
    plant.step(1e-3, count=1000)
    a = np.array([[0.0, 1.0, 0.0], [-1.0 + 4.0, -1.4 - 4.5, 2.3], [0.0, 0.0, 0.0]])
    exact = expm(a) @ [1.0, -0.5, 1.0]
    # RK4 at |lambda| h = 0.006 over 1000 steps
    assert [plant["state[1]"], plant["state[2]"]] == pytest.approx(exact[:2], rel=1e-10)
    assert plant["output"] == plant["state[1]"]


def test_the_input_gain_and_the_output_row_act(driver: Any) -> None:
    """From rest one step of h: x' = (0, omega u), y = C x."""
    values = {"omega": 2.0, "control": 3.0, "output_vector[1]": 0.0, "output_vector[2]": 0.5}
    plant = driver(builder.load_block("ExamplePlant"), **values).begin().step(1e-4)
    assert plant["state[2]"] == pytest.approx(2.0 * 3.0 * 1e-4, rel=1e-3)  # damping: 5.9 per second
    assert plant["output"] == 0.5 * plant["state[2]"]

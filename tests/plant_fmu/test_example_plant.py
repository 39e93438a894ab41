"""The example's plant against the matrix exponential."""

from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from fmus import catalogue


def test_free_and_forced_response(driver: Any) -> None:
    plant = driver(catalogue.load_block("ExamplePlant"))
    plant["initial_state[1]"], plant["initial_state[2]"] = 1.0, -0.5
    plant["control"], plant["disturbance"] = 2.0, 0.3
    plant.begin()
    for _ in range(1000):
        plant.step(1e-3)
    a = np.array([[0.0, 1.0, 0.0], [-1.0 + 4.0, -1.4 - 4.5, 2.3], [0.0, 0.0, 0.0]])
    exact = expm(a) @ [1.0, -0.5, 1.0]
    # RK4 at |lambda| h = 0.006 over 1000 steps
    assert [plant["state[1]"], plant["state[2]"]] == pytest.approx(exact[:2], rel=1e-10)
    assert plant["output"] == plant["state[1]"]

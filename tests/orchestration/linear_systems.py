"""Coupled linear systems as FMUs, and their solutions by the matrix exponential."""

from typing import Any

import numpy as np
from scipy.linalg import expm

from orchestration.system.system import System
from tests.shared_builds import Build

# x_1' = -x_1 + u_1, x_2' = -2 x_2 + u_2 and u_1 = 0.5 y_2, u_2 = -3 y_1: the gains stand in b and in d
POLES, GAINS = (-1.0, -2.0), (0.5, -3.0)
START = (1.0, 0.5)
LOOP = (("one.y[1]", "two.u[1]"), ("two.y[1]", "one.u[1]"))
RESUMABLE: dict[str, Any] = {"saves_state": True, "serialises_state": True}


def alone(linear: Build, **options: Any) -> System:
    """x' = -x + u and y = x from 1, if no option says otherwise."""
    return System({"one": linear(**options)})


def coupled(linear: Build, through: float = 0.0, **capabilities: Any) -> System:
    """y_i = x_i + through u_i: with `through` not 0 the outputs form an algebraic loop."""
    fmus = {
        name: linear(a=a, b=(gain,), d=((through,),), initial_state=start, **capabilities)
        for name, a, gain, start in zip(("one", "two"), POLES, GAINS, START, strict=True)
    }
    return System(fmus, LOOP)


def solution(times: np.ndarray, through: float = 0.0) -> np.ndarray:
    """(y_1, y_2) at the times, shape (n, 2): from y = x + through P y and x' = diag(a) x + diag(b) P y."""
    swap = np.array([[0.0, 1.0], [1.0, 0.0]])
    outputs = np.linalg.inv(np.eye(2) - through * swap)
    matrix = np.diag(POLES) + np.diag(GAINS) @ swap @ outputs
    return np.array([outputs @ expm(matrix * t) @ START for t in times])

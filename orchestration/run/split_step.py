"""A step in two halves without an exchange between them: what this changes is an error of the FMUs' solvers.

An FMU that computes exactly, or with fixed steps that fit, reaches the same state as in one step. One whose
solver starts anew in every step, with a tolerance of its own, does not.
"""

import numpy as np

from orchestration.run.failure import step_unless_discarded
from orchestration.run.loop import python_loop
from orchestration.run.loop_data import InputMode, LoopFunctions
from orchestration.run.snapshot import Snapshot
from orchestration.run.wiring import WiredRun


def step_together_and_split(
    run: WiredRun, loop: LoopFunctions, before: Snapshot, point: int, start: float, end: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """The bus at `end` [s] after one step, and after two with inputs that go on as in the one.

    before: the snapshot at `start`; point: the communication point at or before it
    None if a component discards a step; raises OrchestrationError if a step fails otherwise. Call
    `before.restore` afterwards.
    """
    wiring = run.wiring
    before.restore()
    if not step_unless_discarded(run, loop, point, start, end):
        return None
    together, slopes = wiring.bus.copy(), wiring.slopes.copy()
    before.restore()
    _carry_on(run, together, slopes, start)
    halves = python_loop(wiring._replace(gauss_seidel=0))  # which would exchange within a half
    middle = start + 0.5 * (end - start)
    if not (
        step_unless_discarded(run, halves, point, start, middle)
        and step_unless_discarded(run, halves, point, middle, end)
    ):
        return None
    return together, wiring.bus.copy()


def _carry_on(run: WiredRun, bus: np.ndarray, slopes: np.ndarray, start: float) -> None:
    """Let every connection carry the inputs, and slopes, that a step from `start` [s] left on the bus."""
    connections = run.wiring.connections
    target, is_sloped = connections.target, connections.input_mode == InputMode.FMU_DERIVATIVE
    connections.value[:] = run.wiring.bus[target] = bus[target]
    connections.slope[:] = np.where(is_sloped, slopes[target], 0.0)
    connections.sample_time[:] = start
    connections.sample_interval[:] = np.inf

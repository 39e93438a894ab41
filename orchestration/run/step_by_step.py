"""Runs that are led step by step: the methods of `Simulator` for loops of the caller's own."""

from collections import deque
from typing import Any

import numpy as np

from orchestration.errors import OrchestrationError
from orchestration.results.recording import Recording
from orchestration.run.snapshot import SavedState
from orchestration.run.stepped_run import SteppedRun
from orchestration.run.variable_access import Reader, Writer
from orchestration.system.values import Value


class StepByStep:
    """One run at a time, from `Simulator.start` to the next `start` or `run`, or to `close`.

        simulator.start(Experiment(10.0, 0.01), external=["plant.force"])
        while not simulator.is_done:
            simulator.set("plant.force", -2.0 * simulator.get("plant.position"))
            simulator.step()
        recording = simulator.recording()

    Without anything set, the recording is that of `run`, to the last bit. The second run of an error estimate
    takes what was set at the points that both have; a loop that the caller closes is none in it.
    """

    _stepped: SteppedRun | None = None

    def _started(self) -> SteppedRun:
        if self._stepped is None:
            raise OrchestrationError("no run is started: expected start(experiment) first")
        return self._stepped

    @property
    def time(self) -> float:
        """The present communication point [s]."""
        return self._started().time

    @property
    def point(self) -> int:
        """Index of the present communication point."""
        return self._started().position

    @property
    def points(self) -> np.ndarray:
        """The communication points of the run [s]."""
        return self._started().prepared.points

    @property
    def is_terminated(self) -> bool:
        """Whether an FMU has terminated the simulation, at the present communication point."""
        return self._started().is_terminated

    @property
    def can_save(self) -> bool:
        """Whether every FMU can save its state."""
        return self._started().can_save

    @property
    def is_done(self) -> bool:
        """Whether the run is at its stop time, or an FMU has terminated the simulation."""
        return self._started().is_done

    def step(self) -> None:
        """Step to the next communication point.

        Raises SimulationError if the step fails: its `recording` holds the values recorded until then;
        OrchestrationError if the run is done.
        """
        self._started().step()

    def get(self, name: str) -> Any:
        """The value of "component.variable" at the present communication point."""
        return self._started().variables.get(name)

    def set(self, name: str, value: Value) -> None:
        """Set "component.variable", from the present communication point on.

        It is an external input, an input that the experiment gives a constant value, or a tunable parameter;
        the latter two are recorded if `record` names them. Raises SystemDefinitionError for another variable,
        and for a value of another type or outside the declared range.
        """
        self._started().variables.set(name, value)

    def reader(self, *names: str) -> Reader:
        """A function that returns the present number of one variable, or a tuple of several: a quick `get`.

        It serves this run alone. Booleans are 0.0 and 1.0, as in a recording.
        """
        return self._started().variables.reader(*names)

    def writer(self, *names: str) -> Writer:
        """A function that sets one variable, or several in this order: a quick `set`, for this run alone."""
        return self._started().variables.writer(*names)

    def save(self) -> SavedState:
        """The whole system at the present communication point: every FMU, the connections, and the record.

        Raises OrchestrationError if an FMU cannot save its state.
        """
        return self._started().save()

    def restore(self, state: SavedState) -> None:
        """Go back to a state that this run saved, also after a failure, or on to one on another way.

        Raises OrchestrationError for a state of another run, and after an FMU returned fatal.
        """
        self._started().restore(state)

    def recording(self) -> Recording:
        """The values recorded until now, those of the present communication point included."""
        return self._started().recording_now()


def replay(run: StepByStep, first: SteppedRun) -> Recording:
    """Lead a run at twice the step of another one to its present point, with what was set there.

    Raises OrchestrationError where the first one is not two steps from its start.
    """
    if first.position < 2:
        raise OrchestrationError(f"expected at least two steps, got {first.position}")
    remaining = deque(first.variables.written)
    while not run.is_done and 2 * (run.point + 1) <= first.position:
        while remaining and remaining[0][0] <= 2 * run.point:
            _, name, value = remaining.popleft()
            run.set(name, value)
        run.step()
    return run.recording()

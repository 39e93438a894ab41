"""The runs of a task side by side: a simulator for each, or all as instances of one ensemble."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Protocol

import numpy as np

from orchestration.errors import EnsembleError, OrchestrationError
from orchestration.many.ensemble import Ensemble
from orchestration.many.ensemble_choice import check_ensemble
from orchestration.many.stepped_ensemble import SteppedEnsemble
from orchestration.results.recording import Recording
from orchestration.run import Simulator
from orchestration.run.saved_state import SavedState
from orchestration.scenarios.task import Task
from orchestration.system.experiment import Experiment
from orchestration.system.open_inputs import OpenInputs
from orchestration.system.signals import values_at
from orchestration.system.system import CheckedSystem, check
from orchestration.system.values import Value

_LARGEST_SEED = 2**31 - 1000  # of the generator in our sensors, and of most others
Array = np.ndarray


class Episode:
    """The run of one environment, after `reset`.

    names: of the values that are read: of variables, then of the task's signals
    """

    def __init__(self, task: Task) -> None:
        self._task, self.simulator = task, Simulator(task.system)
        self._variables, signals = read_names(task)
        self._signals = [task.signals[name] for name in signals]
        self.names = (*self._variables, *signals)
        self._experiment = _recorded(task, self._variables)
        self._of_signals: Array | None = None  # a row for each communication point
        self._first: SavedState | None = None

    def reset(self, random: np.random.Generator) -> None:
        """Begin another episode."""
        task = self._task
        drawn = _drawn(task, random)
        with suppress(OrchestrationError):  # after an FMU returned fatal
            if self._first:
                self.simulator.restore(self._first)
                return
        experiment = replace(self._experiment, parameters={**task.experiment.parameters, **drawn})
        self.simulator.start(experiment, external=task.actions)
        if self._of_signals is None:  # the communication points of every episode are the same
            table = [values_at(signal, self.simulator.points) for signal in self._signals]
            self._of_signals = np.array(table).T
        self._read = self.simulator.reader(*self._variables)
        self._write = self.simulator.writer(*task.actions)
        if self.simulator.can_save and not drawn:
            self._first = self.simulator.save()

    def values(self) -> tuple[float, ...]:
        """The present values of `names`."""
        values = self._read() if len(self._variables) > 1 else (self._read(),)
        if self._of_signals is None or not self._signals:
            return values
        return (*values, *self._of_signals[self.simulator.point].tolist())

    def act(self, action: Sequence[float]) -> None:
        """Set the actions, in their own units, from the present point on."""
        self._write(*action)


class TaskRuns(Protocol):
    """Runs side by side, after `reset`.

    names: as of `Episode`; values: of `names`, shape (names, runs)
    time [s], is_done, is_terminated: shape (runs,)
    """

    names: tuple[str, ...]

    def reset(self, randoms: Sequence[np.random.Generator], which: Array) -> None:
        """Begin another episode in those that are True, shape (runs,)."""
        ...

    def act(self, values: Array, which: Array) -> None:
        """Set the actions, in their own units; values: shape (runs, actions)."""
        ...

    def step(self, which: Array) -> None: ...

    def values(self) -> Array: ...

    def time(self) -> Array: ...

    def is_done(self) -> Array: ...

    def is_terminated(self) -> Array: ...

    def recordings(self) -> list[Recording]: ...

    def close(self) -> None: ...


class SimulatedRuns:
    """Runs that have a simulator each."""

    def __init__(self, task: Task, count: int) -> None:
        self._episodes = [Episode(task) for _ in range(count)]
        self._simulators = [episode.simulator for episode in self._episodes]
        self.names = self._episodes[0].names

    def reset(self, randoms: Sequence[np.random.Generator], which: Array) -> None:
        for episode, random, is_meant in zip(self._episodes, randoms, which.tolist(), strict=True):
            if is_meant:
                episode.reset(random)

    def act(self, values: Array, which: Array) -> None:
        for episode, action, is_meant in zip(self._episodes, values.tolist(), which.tolist(), strict=True):
            if is_meant:
                episode.act(action)

    def step(self, which: Array) -> None:
        for simulator, is_meant in zip(self._simulators, which.tolist(), strict=True):
            if is_meant:
                simulator.step()

    def values(self) -> Array:
        return np.array([episode.values() for episode in self._episodes]).T

    def time(self) -> Array:
        return np.array([simulator.time for simulator in self._simulators])

    def is_done(self) -> Array:
        return np.array([simulator.is_done for simulator in self._simulators])

    def is_terminated(self) -> Array:
        return np.array([simulator.is_terminated for simulator in self._simulators])

    def recordings(self) -> list[Recording]:
        return [simulator.recording() for simulator in self._simulators]

    def close(self) -> None:
        for simulator in self._simulators:
            simulator.close()


class EnsembleRuns:
    """Runs as instances of an ensemble: all are at the same point, and end together.

    Raises EnsembleError for a task that is for simulators.
    """

    _run: SteppedEnsemble

    def __init__(self, task: Task, count: int, is_asked_for: bool) -> None:
        self._task, self._count = task, count
        self._variables, signals = read_names(task)
        self.names = (*self._variables, *signals)
        self._experiment = _recorded(task, self._variables)
        system = checked_system(task)
        for name in (*task.seeds, *task.vary):
            variable = system.port(name, "vary").variable
            if variable.causality != "parameter" or name.endswith(".internal_step"):
                raise EnsembleError(f"{name}: expected a parameter but internal_step to draw")
        check_ensemble(task.system, self._experiment, count, is_asked_for, task.actions)
        self._ensemble = Ensemble(task.system)
        self._signals = [task.signals[name] for name in signals]
        self._of_signals: Array | None = None  # a row for each signal

    def reset(self, randoms: Sequence[np.random.Generator], which: Array) -> None:
        drawn = [_drawn(self._task, random) for random in randoms]
        vary = {name: [values[name] for values in drawn] for name in drawn[0]}
        self._run = self._ensemble.start(self._experiment, vary, self._count, self._task.actions)
        if self._of_signals is None:  # the communication points of every episode are the same
            table = [values_at(signal, self._run.points) for signal in self._signals]
            self._of_signals = np.array(table)

    def act(self, values: Array, which: Array) -> None:
        self._run.write(self._task.actions, values.T)

    def step(self, which: Array) -> None:
        if not self._run.is_done:
            self._run.step()

    def values(self) -> Array:
        values = self._run.read(self._variables)
        if self._of_signals is None or not self._signals:
            return values
        present = self._of_signals[:, self._run.point, None]
        return np.concatenate([values, np.repeat(present, self._count, axis=1)])

    def time(self) -> Array:
        return np.full(self._count, self._run.time)

    def is_done(self) -> Array:
        return np.full(self._count, self._run.is_done)

    def is_terminated(self) -> Array:
        return np.zeros(self._count, bool)

    def recordings(self) -> list[Recording]:
        recorded = self._run.recordings()
        return [recorded.run(instance) for instance in range(self._count)]

    def close(self) -> None:
        self._ensemble.close()


def task_runs(task: Task, count: int, ensemble: bool | None) -> TaskRuns:
    """So many runs of a task: instances of an ensemble where they can be and that pays, else simulators.

    ensemble: True also where it does not pay, EnsembleError where it cannot be; False never
    """
    if ensemble is not False:
        try:
            return EnsembleRuns(task, count, bool(ensemble))
        except EnsembleError:
            if ensemble:
                raise
    return SimulatedRuns(task, count)


def _drawn(task: Task, random: np.random.Generator) -> dict[str, Value]:
    """The values of an episode."""
    drawn: dict[str, Value] = {name: int(random.integers(1, _LARGEST_SEED)) for name in task.seeds}
    return drawn | {name: draw(random) for name, draw in task.vary.items()}


def read_names(task: Task) -> tuple[list[str], list[str]]:
    """What is read: the names of variables, and of the task's signals."""
    names = dict.fromkeys((*task.observations, *task.reads))
    return [n for n in names if n not in task.signals], [n for n in names if n in task.signals]


def _recorded(task: Task, variables: Sequence[str]) -> Experiment:
    """The experiment, which also records what the agent does and sees: that is read most quickly."""
    record = task.experiment.record
    if not record:  # which is all outputs and actions
        return task.experiment
    ports = checked_system(task).ports
    outputs = [n for n in variables if n in ports and ports[n].variable.causality == "output"]
    return replace(task.experiment, record=[*dict.fromkeys((*record, *outputs, *task.actions))])


def checked_system(task: Task) -> CheckedSystem:
    """The system, checked with the inputs that the agent drives."""
    driven = dict.fromkeys((*task.experiment.driven_inputs, *task.actions))
    return check(task.system, driven, open_inputs=OpenInputs(task.experiment.open_inputs))

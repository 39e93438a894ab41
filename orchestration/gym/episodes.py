"""The episodes of a task: of one run, or of many side by side with simulators or in an ensemble."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from orchestration.errors import EnsembleError, OrchestrationError
from orchestration.many.ensemble import Ensemble, check_ensemble
from orchestration.many.ensemble_loop import Device
from orchestration.many.places import AUTO, PROCESSOR
from orchestration.many.stepped_ensemble import SteppedEnsemble
from orchestration.results.recording import Recording
from orchestration.run import Simulator
from orchestration.run.access import SavedState
from orchestration.run.run import Run
from orchestration.scenarios.changes import with_values
from orchestration.scenarios.task import Task
from orchestration.system.experiment import Experiment
from orchestration.system.prepared_run import check_for
from orchestration.system.signals import values_at
from orchestration.system.values import Value

_LARGEST_SEED = 2**31 - 1000  # of the generator in our sensors, and of most others
Array = np.ndarray
Look = tuple[Any, Any, Any, Any]
"""Values of the names of a plan, time [s], and whether a run is done and whether an FMU terminated it.

Numbers of one run; of many arrays of shape (names, runs) and (runs,).
"""


class EpisodePlan:
    """The plan that all episodes of a task have in common.

    variables: that are read; names: of these, then of the task's signals; system: with the actions as inputs
    experiment: also records what the agent does and sees, since what is recorded is read most quickly
    """

    def __init__(self, task: Task) -> None:
        self.task = task
        self.system = check_for(task.system, task.experiment, task.actions)
        names = dict.fromkeys((*task.observations, *task.reads))
        self.variables = [name for name in names if name not in task.signals]
        signals = [name for name in names if name in task.signals]
        self.names = (*self.variables, *signals)
        self._signals = [task.signals[name] for name in signals]
        self._of_signals: Array | None = None
        ports, record = self.system.ports, task.experiment.record  # without names all outputs and actions
        seen = [n for n in self.variables if n in ports and ports[n].variable.causality == "output"]
        record = [*dict.fromkeys((*record, *seen, *task.actions))] if record else ()
        self.experiment = replace(task.experiment, record=record)

    def signals(self, points: Array) -> Array:
        """Returns the task's signals, a row for each communication point: the same in every episode."""
        if self._of_signals is None:
            table = [values_at(signal, points) for signal in self._signals]
            self._of_signals = np.array(table).reshape(-1, len(points)).T
        return self._of_signals

    def drawn(self, random: np.random.Generator) -> Experiment:
        """Returns the experiment of an episode."""
        drawn: dict[str, Value] = {name: int(random.integers(1, _LARGEST_SEED)) for name in self.task.seeds}
        drawn |= {name: draw(random) for name, draw in self.task.vary.items()}
        return with_values(self.experiment, drawn)


class Episode:
    """The episode of one environment in a simulator, or of many in an ensemble, after `reset`."""

    run: Run | SteppedEnsemble

    def __init__(self, plan: EpisodePlan, engine: Simulator | Ensemble) -> None:
        self._plan, self.engine = plan, engine
        self._first: SavedState | None = None  # the beginning, where all episodes begin alike

    def reset(self, *randoms: np.random.Generator) -> None:
        """Begins another episode, with a random generator for each environment."""
        plan, engine = self._plan, self.engine
        experiments = [plan.drawn(random) for random in randoms]
        with suppress(OrchestrationError):  # after an FMU returned fatal
            if self._first and isinstance(self.run, Run):
                self.run.restore(self._first)
                return
        if isinstance(engine, Simulator):
            self.run = run = engine.start(*experiments, external=plan.task.actions)
        else:
            self.run = run = engine.start(experiments, plan.task.actions)
        self._signals = plan.signals(run.points)
        self._read, self.act = run.reader(*plan.variables), run.writer(*plan.task.actions)
        self.step = run.step
        if isinstance(run, Run) and run.can_save and not (plan.task.seeds or plan.task.vary):
            self._first = run.save()

    def look(self) -> Look:
        """Returns what there is to see at the present point; what all environments share is one number."""
        run, values = self.run, self._read()
        if len(self._plan.variables) == 1:
            values = (values,)
        if self._signals.shape[1]:
            values = (*values, *self._signals[run.point].tolist())
        is_done = run.is_done
        return values, run.time, is_done, is_done and run.is_terminated


class SimulatedRuns:
    """Runs that have a simulator each."""

    def __init__(self, plan: EpisodePlan, count: int) -> None:
        self._episodes = [Episode(plan, Simulator(plan.task.system)) for _ in range(count)]

    def reset(self, randoms: Sequence[np.random.Generator], which: Array) -> None:
        """Begins another episode in those that are True, shape (runs,)."""
        for run in np.flatnonzero(which).tolist():
            self._episodes[run].reset(randoms[run])

    def act(self, values: Array, which: Array) -> None:
        """Sets the actions, in their own units; values: shape (runs, actions)."""
        for episode, action, is_meant in zip(self._episodes, values.tolist(), which.tolist(), strict=True):
            if is_meant:
                episode.act(*action)

    def step(self, which: Array) -> None:
        """Steps to the next communication point."""
        for episode, is_meant in zip(self._episodes, which.tolist(), strict=True):
            if is_meant:
                episode.step()

    def look(self) -> Look:
        """Returns what there is to see at the present points."""
        values, *others = zip(*[episode.look() for episode in self._episodes], strict=True)
        time, is_done, is_terminated = map(np.array, others)
        return np.array(values).T, time, is_done, is_terminated

    def recordings(self) -> list[Recording]:
        """Returns the recordings of the present episodes."""
        return [episode.run.recording() for episode in self._episodes]

    def close(self) -> None:
        """Frees the FMUs."""
        for episode in self._episodes:
            episode.engine.close()


class EnsembleRuns:
    """Runs as instances of an ensemble: all are at the same point, and end together.

    device: on which they step, and on which values are then arrays
    Raises EnsembleError for a task that is for simulators.
    """

    def __init__(
        self, plan: EpisodePlan, count: int, is_asked_for: bool, device: Device | None = None
    ) -> None:
        self._count, task = count, plan.task
        self._arrays = device.arrays if device else np
        for name in (*task.seeds, *task.vary):
            if name.endswith(".internal_step"):
                raise EnsembleError(f"{name}: expected one for all environments that step together")
        check_ensemble(task.system, plan.experiment, count, is_asked_for, task.actions)
        self._episode = Episode(plan, Ensemble(task.system, device=device))

    def reset(self, randoms: Sequence[np.random.Generator], which: Array) -> None:
        """Begins another episode in all."""
        self._episode.reset(*randoms)

    def act(self, values: Array, which: Array) -> None:
        """Sets the actions, in their own units; values: shape (runs, actions)."""
        self._episode.act(*values.T)

    def step(self, which: Array) -> None:
        """Steps to the next communication point."""
        self._episode.step()

    def look(self) -> Look:
        """Returns what there is to see at the present point."""
        values, time, *others = self._episode.look()
        is_done, is_terminated = (np.full(self._count, value) for value in others)
        of_all = self._arrays.empty((len(values), self._count))
        for i, value in enumerate(values):
            of_all[i] = value
        return of_all, self._arrays.full(self._count, time), is_done, is_terminated

    def recordings(self) -> list[Recording]:
        """Returns the recordings of the present episodes."""
        recorded = self._episode.run.recording()
        return [recorded.run(i) for i in range(self._count)]

    def close(self) -> None:
        """Frees the FMUs."""
        self._episode.engine.close()


def task_runs(
    plan: EpisodePlan, count: int, where: str, device: Device | None = None
) -> SimulatedRuns | EnsembleRuns:
    """Returns so many runs: instances of an ensemble, or simulators.

    where: "auto": an ensemble where it can be and pays; "processor": simulators; "vectors", or a device such
    as "gpu": an ensemble, EnsembleError where it cannot be
    device: of the place
    """
    if where not in (AUTO, PROCESSOR):
        return EnsembleRuns(plan, count, True, device)
    if where == AUTO:
        with suppress(EnsembleError):
            return EnsembleRuns(plan, count, False)
    return SimulatedRuns(plan, count)

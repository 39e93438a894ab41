"""The master algorithm: connects FMI 2.0 co-simulation FMUs and steps them together.

Communication points are t_i = start + i h, never accumulated; a last shorter step lands on the stop
time. At each point: outputs are read, exchanged and recorded, scheduled changes are made.

    Jacobi         every component steps from t_i to t_{i+1} with the outputs of t_i
    Gauss-Seidel   in the order of the components, each with the newest outputs there are

Both hold inputs over a step: first order in h. The loop delays are given in docs/architecture.md.
"""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Self

import numpy as np

from orchestration.component import Component, Values
from orchestration.errors import OrchestrationError, SimulationError, SystemDefinitionError
from orchestration.experiment import GRID_TOLERANCE, Algorithm, Experiment, checked_settings, checked_value
from orchestration.recording import Recording
from orchestration.system import CheckedSystem, Port, System, check

_LOOP_PASSES = 100
_LOOP_TOLERANCE = 1e-12


def simulate(
    system: System,
    experiment: Experiment,
    progress: Callable[[int, int], None] | None = None,
) -> Recording:
    """Run an experiment on a system and return what was recorded.

    progress: called with (communication points done, in all).
    Raises SystemDefinitionError or FmuLoadError before anything runs, SimulationError after: its
    `recording` is what there is until then. Every FMU is freed either way.
    """
    checked = check(system, [*experiment.inputs, *experiment.signals])
    settings = checked_settings(checked, experiment)
    with ExitStack() as stack:
        components = {
            name: stack.enter_context(Component(name, Path(path), checked.descriptions[name]))
            for name, path in checked.components.items()
        }
        run = _Run(checked, experiment, components)
        try:
            with deferred_interrupt() as check_interrupt:
                run.initialise(settings)
                run.loop(progress, check_interrupt)
        except KeyboardInterrupt as error:
            raise SimulationError("interrupted", run.recorder.recording()) from error
        except Exception as error:  # also of a signal: what was recorded must not be lost
            reason = str(error) if isinstance(error, OrchestrationError) else repr(error)
            raise SimulationError(reason, run.recorder.recording()) from error
        return run.recorder.recording()


class Simulator:
    """A system whose FMUs stay loaded over many runs; a context manager.

    Raises SystemDefinitionError or FmuLoadError when it is made.
    """

    def __init__(self, system: System) -> None:
        self.system = system

    def run(self, experiment: Experiment, progress: Callable[[int, int], None] | None = None) -> Recording:
        """One experiment, as `simulate` runs it."""
        return simulate(self.system, experiment, progress)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> None:
        pass


@contextmanager
def deferred_interrupt() -> Iterator[Callable[[], None]]:
    """Keep an interrupt until the function given is called: it must not strike inside an FMU.

    Outside the main thread, which receives no interrupts, nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    received: list[int] = []

    def check_interrupt() -> None:
        if received:
            raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, lambda number, frame: received.append(number))
    try:
        yield check_interrupt
    finally:
        signal.signal(signal.SIGINT, before)


class _Recorder:
    """Rows of signals, allocated once for the whole run."""

    def __init__(self, names: list[str], units: list[str], points: np.ndarray, provenance: dict) -> None:
        self._names, self._units, self._points = names, units, points
        self._rows = np.empty((len(points), len(names)))
        self._done = 0
        self._provenance = provenance
        self.copies: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def take(self, i: int) -> None:
        row = self._rows[i]
        for columns, array, places in self.copies:
            row[columns] = array[places]
        self._done = i + 1

    def recording(self) -> Recording:
        return Recording(
            names=tuple(self._names),
            units=tuple(self._units),
            time=self._points[: self._done].copy(),
            values=self._rows[: self._done].copy(),
            provenance=self._provenance,
        )


class _Run:
    """A checked system with live components, its arrays bound."""

    def __init__(
        self, checked: CheckedSystem, experiment: Experiment, components: dict[str, Component]
    ) -> None:
        self._checked, self._experiment, self._components = checked, experiment, components
        self._points = experiment.points()
        self._places: dict[str, tuple[np.ndarray, int]] = {}
        driven = {target.name for _, target in checked.connections} | set(experiment.signals)
        self._inputs = {name: self._bind(name, "input", driven) for name in components}
        self._outputs = {name: self._bind(name, "output", None) for name in components}
        self._links: dict[str, list[tuple[np.ndarray, int, np.ndarray, int]]] = {n: [] for n in components}
        for source, target in checked.connections:
            self._links[target.component].append((*self._places[source.name], *self._places[target.name]))
        self._signals = [(*self._places[name], value_at) for name, value_at in experiment.signals.items()]
        self._events = sorted(experiment.events, key=lambda event: event.time)
        self.recorder = self._make_recorder()

    def _bind(self, component: str, causality: str, only: set[str] | None) -> list[Values]:
        wanted = [
            v
            for v in self._checked.descriptions[component].modelVariables
            if v.causality == causality and (only is None or f"{component}.{v.name}" in only)
        ]
        groups = self._components[component].values(wanted)
        for group in groups:
            for i, variable in enumerate(group.variables):
                self._places[f"{component}.{variable.name}"] = (group.array, i)
        return groups

    def _make_recorder(self) -> _Recorder:
        recordable = [*self._experiment.signals] + [
            f"{name}.{v.name}"
            for name in self._components
            for group in self._outputs[name]
            for v in group.variables
        ]
        names = list(self._experiment.record) or recordable
        for name in names:
            if name not in recordable:
                self._checked.port(name, "record")
                raise SystemDefinitionError(f"record: {name} is neither an output nor driven by a signal")
        units = [self._checked.ports[name].variable.unit or "" for name in names]
        recorder = _Recorder(names, units, self._points, self._provenance())
        by_array: dict[int, tuple[np.ndarray, list[int], list[int]]] = {}
        for column, name in enumerate(names):
            array, place = self._places[name]
            _, columns, places = by_array.setdefault(id(array), (array, [], []))
            columns.append(column)
            places.append(place)
        recorder.copies = [(np.array(c), array, np.array(p)) for array, c, p in by_array.values()]
        return recorder

    def _provenance(self) -> dict[str, Any]:
        return {
            "fmus": {
                name: {"guid": d.guid, "model": d.modelName, "tool": d.generationTool}
                for name, d in self._checked.descriptions.items()
            },
            "algorithm": str(self._experiment.algorithm),
            "communication_step_size_s": self._experiment.step_size,
        }

    def initialise(self, settings: list[tuple[Port, Any]]) -> None:
        """Set parameters, enter initialisation mode, set inputs, exchange in dependency order, leave it."""
        experiment = self._experiment
        self._set(settings, "parameter")
        for component in self._components.values():
            component.initialise(experiment.start_time, experiment.stop_time)
        self._set(settings, "input")
        for name, value_at in experiment.signals.items():
            port = self._checked.ports[name]
            self._components[port.component].set(port.variable, value_at(experiment.start_time))
        self._exchange_initial_values()
        for component in self._components.values():
            component.begin_stepping()

    def _set(self, settings: list[tuple[Port, Any]], causality: str) -> None:
        for port, value in settings:
            if port.variable.causality == causality:
                self._components[port.component].set(port.variable, value)

    def _exchange_initial_values(self) -> None:
        order, loop = self._checked.initial_order()
        known: dict[str, float] = {}
        for _ in range(_LOOP_PASSES):
            settled = True
            for source, target in order:
                value = self._components[source.component].get(source.variable)
                before = known.get(target.name)
                settled &= before is not None and abs(value - before) <= _LOOP_TOLERANCE * max(
                    1.0, abs(value)
                )
                self._components[target.component].set(target.variable, value)
                known[target.name] = value
            if settled or not loop:
                return
        names = ", ".join(target.name for _, target in order)
        raise OrchestrationError(
            f"initial values of {names} did not settle in {_LOOP_PASSES} passes: the loop has no "
            "fixed point that repeated exchange finds; break it or give start values"
        )

    def loop(self, progress: Callable[[int, int], None] | None, check_interrupt: Callable[[], None]) -> None:
        """From the first communication point to the last."""
        step = {Algorithm.JACOBI: self._jacobi, Algorithm.GAUSS_SEIDEL: self._gauss_seidel}[
            self._experiment.algorithm
        ]
        last = len(self._points) - 1
        for name in self._components:
            self._read(name)
        due = self._due_events()
        for i, t in enumerate(self._points.tolist()):
            for array, place, value_at in self._signals:
                array[place] = value_at(t)
            for component in self._components.values():
                component.time = t
            for name, value in due(t):
                port = self._checked.ports[name]
                self._components[port.component].set(port.variable, checked_value(port, value))
            self.recorder.take(i)
            check_interrupt()
            if progress:
                progress(i, last)
            if i < last:
                step(t, float(self._points[i + 1]) - t)

    def _due_events(self) -> Callable[[float], Iterator[tuple[str, Any]]]:
        waiting = list(self._events)
        tolerance = GRID_TOLERANCE * self._experiment.step_size

        def due(t: float) -> Iterator[tuple[str, Any]]:
            while waiting and waiting[0].time <= t + tolerance:
                yield from waiting.pop(0).values.items()

        return due

    def _jacobi(self, t: float, h: float) -> None:
        for name in self._components:
            self._write(name)
        for component in self._components.values():
            component.do_step(t, h)
        for name in self._components:
            self._read(name)

    def _gauss_seidel(self, t: float, h: float) -> None:
        for name, component in self._components.items():
            self._write(name)
            component.do_step(t, h)
            self._read(name)

    def _write(self, component: str) -> None:
        for source, i, target, j in self._links[component]:
            target[j] = source[i]
        for group in self._inputs[component]:
            group.write()

    def _read(self, component: str) -> None:
        for group in self._outputs[component]:
            group.read()

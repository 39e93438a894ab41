"""A system whose FMUs stay loaded, and the runs that it makes."""

import math
import threading
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

import numpy as np
from fmpy.model_description import ScalarVariable

from orchestration.errors import OrchestrationError, SimulationError, SystemDefinitionError
from orchestration.fmi.description import describe
from orchestration.fmi.instance import FmuInstance
from orchestration.master.checkpoint import Checkpoint, Checkpoints, restore
from orchestration.master.compiled_loop import compiled as compiled_loop
from orchestration.master.initialisation import Group, groups, settle
from orchestration.master.interrupt import deferred_interrupt
from orchestration.master.loop import BUSY, REPORT_SIZE, Storage, plain
from orchestration.master.pacing import Pacing
from orchestration.master.progress import Progress
from orchestration.master.stepping import Run
from orchestration.master.wiring import Loom
from orchestration.results.recording import Recording
from orchestration.system.experiment import Experiment, Initialisation
from orchestration.system.prepared_run import PreparedRun, prepare_checked
from orchestration.system.system import CheckedSystem, System, check


class Simulator:
    """A system whose FMUs stay loaded over many runs; a context manager.

    FMUs are loaded for the first run and reset for the next; after a failure they are loaded anew.
    compiled: whether the communication loop runs compiled (a second, once a machine) or as Python, slower
    and with the same results to the last bit. Raises FmuLoadError for a file that is no FMU.
    """

    def __init__(self, system: System, compiled: bool = True) -> None:
        self.system = system
        self._loop = compiled_loop if compiled else plain
        self._descriptions = {name: describe(Path(path)) for name, path in system.components.items()}
        self._loaded = ExitStack()
        self._components: dict[str, FmuInstance] = {}
        self._must_reload = False
        self._running = threading.Lock()
        self._known: dict[tuple[str, ...], tuple[CheckedSystem, tuple[Group, ...]]] = {}

    def run(
        self,
        experiment: Experiment,
        progress: Progress | None = None,
        *,
        real_time: float | None = None,
        checkpoints: Checkpoints | None = None,
        resume: Checkpoint | None = None,
        storage: Storage | None = None,
    ) -> Recording:
        """Run an experiment and return what was recorded.

        progress: called some ten times a second with (communication points done, in all)
        real_time: simulated seconds in a second of the wall clock; without it, as fast as it goes
        checkpoints: where and how often to save the whole system; resume: go on from one of them

        Raises SystemDefinitionError or FmuLoadError before anything runs, SimulationError after: its
        `recording` is what there is until then.
        """
        if not self._running.acquire(blocking=False):
            raise OrchestrationError("this simulator is running: expected another one for a run meanwhile")
        try:
            return self._run(experiment, progress, _pacing(real_time), checkpoints, resume, storage)
        finally:
            self._running.release()

    def _run(
        self,
        experiment: Experiment,
        progress: Progress | None,
        pacing: Pacing | None,
        checkpoints: Checkpoints | None,
        resume: Checkpoint | None,
        storage: Storage | None,
    ) -> Recording:
        checked, order = self._checked(experiment.driven_inputs)
        prepared = prepare_checked(checked, experiment)
        if checkpoints or resume:
            _check_serialisable(checked)
        self._make_ready(storage)
        loom = Loom(prepared, self._components, storage)
        run = Run(prepared, self._components, loom, self._loop(loom.wiring))
        try:
            with deferred_interrupt() as check_interrupt:
                _initialise(prepared, order, self._components)
                run.read_outputs()
                if resume:
                    restore(resume, run, self._components)
                keeper = checkpoints.keeper(run, self._components) if checkpoints else None
                run.go(check_interrupt, progress, pacing, keeper)
            self._must_reload = False
            return run.recording(pacing)
        except KeyboardInterrupt as error:
            run.look()
            saved = _saved(checkpoints, run, self._components) if checkpoints else ""
            raise SimulationError(f"interrupted{saved}", run.recording(pacing)) from error
        except Exception as error:  # also of a signal: what was recorded must not be lost
            reason = str(error) if isinstance(error, OrchestrationError) else repr(error)
            raise SimulationError(reason, run.recording(pacing)) from error
        finally:
            run.free()

    def _checked(self, driven: tuple[str, ...]) -> tuple[CheckedSystem, tuple[Group, ...]]:
        """The checked system and the order of its initial values, kept for the next run."""
        if driven not in self._known:
            checked = check(self.system, driven, self._descriptions)
            self._known[driven] = checked, groups(checked)
        return self._known[driven]

    def _make_ready(self, storage: Storage | None) -> None:
        """Load what is not loaded, and reset what was used."""
        if self._must_reload or not all(each.is_fresh or each.reset() for each in self._components.values()):
            self.close()
        self._must_reload = True  # should anything fail before a run is done
        if not self._components:
            with ExitStack() as loading:
                self._components = {
                    name: loading.enter_context(self._loaded_component(name, storage))
                    for name in self.system.components
                }
                self._loaded = loading.pop_all()

    def _loaded_component(self, name: str, storage: Storage | None) -> FmuInstance:
        report = storage.report if storage else np.zeros(REPORT_SIZE, np.int64)
        report[BUSY] = -1 - list(self.system.components).index(name)
        try:
            return FmuInstance(name, Path(self.system.components[name]), self._descriptions[name])
        finally:
            report[BUSY] = 0

    def close(self) -> None:
        """Free every instance; the next run loads them again."""
        self._components, self._must_reload = {}, False
        self._loaded.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> None:
        self.close()


def _saved(checkpoints: Checkpoints, run: Run, components: Mapping[str, FmuInstance]) -> str:
    """Save an interrupted run; what to say of it."""
    try:
        checkpoints.save(run, components)
    except (OrchestrationError, OSError) as error:
        return f"; not saved: {error}"
    return f"; saved in {checkpoints.path}"


def _pacing(real_time: float | None) -> Pacing | None:
    if real_time is None:
        return None
    if not (math.isfinite(real_time) and real_time > 0.0):
        raise SystemDefinitionError(f"real time factor {real_time!r}: expected more than 0")
    return Pacing(real_time)


def _check_serialisable(checked: CheckedSystem) -> None:
    incapable = checked.components_without("canSerializeFMUstate")
    if incapable:
        raise SystemDefinitionError(
            f"checkpoint: {', '.join(incapable)} cannot serialise its state: expected canSerializeFMUstate"
        )


def _initialise(prepared: PreparedRun, order: Sequence[Group], components: Mapping[str, FmuInstance]) -> None:
    """Set parameters, enter initialisation mode, set inputs, exchange in dependency order, leave it."""
    experiment = prepared.experiment
    for name, component in components.items():
        component.set_all(_settings_of(prepared, name, "parameter"))
    for component in components.values():
        component.initialise(experiment.start_time, experiment.stop_time)
    for name, component in components.items():
        component.set_all(_settings_of(prepared, name, "input"))
    for name, values in zip(experiment.signals, prepared.signal_values, strict=True):
        port = prepared.system.ports[name]
        components[port.component].set(port.variable, float(values[0]))
    settle(order, components, Initialisation(experiment.initialisation))
    for component in components.values():
        component.exit_initialization_mode()


def _settings_of(prepared: PreparedRun, component: str, causality: str) -> list[tuple[ScalarVariable, Any]]:
    return [
        (port.variable, value)
        for port, value in prepared.settings
        if port.component == component and port.variable.causality == causality
    ]

"""Many instances of one system, which step together."""

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager

import numpy as np

from fmus.errors import nearest
from fmus.fmi.description import describe, is_independent
from fmus.fmi.instance import FmuInstance
from fmus.fmi.variable_types import FmiValue
from fmus.native.lanes import LANES
from fmus.platforms import INSTRUCTION_SETS, instruction_sets
from orchestration.errors import EnsembleError, OrchestrationError, SystemDefinitionError
from orchestration.many.ensemble_checks import (
    Vary,
    check_supported,
    checked_values,
    instance_count,
    varied_signals,
)
from orchestration.many.ensemble_loop import EnsembleLoop, build_loop, check_memory, loop_library
from orchestration.many.ensemble_recording import EnsembleRecording
from orchestration.many.lane_library import lane_library
from orchestration.many.stepped_ensemble import SteppedEnsemble
from orchestration.run.checked_systems import CheckedSystems
from orchestration.run.initialisation import ConnectionGroup, initialise
from orchestration.system.experiment import Experiment
from orchestration.system.prepared_run import PreparedRun, PreparedRuns
from orchestration.system.system import System

Values = dict[str, list[FmiValue]]
"""Variable -> its value at the start, of each instance."""


class Ensemble(AbstractContextManager["Ensemble"]):
    """Many instances of a system of native FMUs that this user built, in groups that step at once.

    Every instance has the bits of its own run by a `Simulator` (docs/how-to/ensembles.md says what that rests
    on). The equations are compiled from the sources in the FMUs, once for each FMU, and kept in the user's
    cache. A context manager, which frees the FMUs that the initial values are taken from.

    instructions: "x86-64-v4", "x86-64-v3" or "portable", by default the best that this processor has

    Raises EnsembleError for any other FMU, or without a compiler.
    """

    def __init__(self, system: System, instructions: str | None = None) -> None:
        self.system = system
        available = instruction_sets()
        self.instructions = instructions or available[0]
        if self.instructions not in INSTRUCTION_SETS:
            raise EnsembleError(
                f"instructions {instructions!r}: {nearest(self.instructions, INSTRUCTION_SETS)}"
            )
        if self.instructions not in available:
            raise EnsembleError(f"instructions {instructions!r}: this processor has {', '.join(available)}")
        self._loaded = ExitStack()
        self._instances: dict[str, FmuInstance] = {}
        self._running = threading.Lock()
        self._descriptions = {name: describe(path) for name, path in system.components.items()}
        self._checked, self._prepared_runs = CheckedSystems(system, self._descriptions), PreparedRuns()
        for name, description in self._descriptions.items():
            if not is_independent(description):
                raise EnsembleError(
                    f"{name}: {system.components[name]}: expected a native FMU that "
                    "l1-depth build wrote for this user; Simulator runs any FMU"
                )
        loop_library(self.instructions)
        self._libraries = {
            name: lane_library(name, path, self.instructions) for name, path in system.components.items()
        }
        for name, library in self._libraries.items():
            if library.wholes:
                raise EnsembleError(
                    f"{name}: an Ensemble has no whole numbers of an FMU of Reals alone; a Simulator has"
                )

    def run(
        self,
        experiment: Experiment,
        vary: Vary,
        *,
        threads: int = 1,
        progress: Callable[[int, int], object] | None = None,
    ) -> EnsembleRecording:
        """Run as many instances of an experiment as there are values to vary, and return what they recorded.

        vary: name of a parameter or of a constant input -> its values, shape (instances,); of an input with a
        signal in the experiment -> the signals in its place
        threads: that run groups of instances at once
        progress: called with the instances that are done, and all of them

        An instance that cannot begin, or cannot go on, is in `failures` of the result and disturbs no other.
        Raises SystemDefinitionError for what does not fit, EnsembleError for what only a `Simulator` can run,
        OrchestrationError if no instance can begin.
        """
        if threads < 1:
            raise OrchestrationError(f"threads: {threads}: expected at least 1")
        with self._begin_run():
            return self._run(experiment, vary, threads, progress)

    def start(
        self, experiment: Experiment, vary: Vary, instances: int, external: Sequence[str]
    ) -> SteppedEnsemble:
        """So many instances at the start time, to be led step by step.

        external: inputs that the caller sets between the steps, as of `Simulator.start`; at least one
        Raises what `run` raises; OrchestrationError if an instance cannot begin.
        """
        with self._begin_run():
            return self._start(experiment, vary, instances, external)

    @contextmanager
    def _begin_run(self) -> Iterator[None]:
        """Refuse another run meanwhile."""
        if not self._running.acquire(blocking=False):
            raise OrchestrationError("this ensemble is running: expected another one for a run meanwhile")
        try:
            yield
        finally:
            self._running.release()

    def _start(
        self, experiment: Experiment, vary: Vary, instances: int, external: Sequence[str]
    ) -> SteppedEnsemble:
        lengths = {name: len(values) for name, values in vary.items()}
        if instances < 1 or not external or {*lengths.values()} - {instances}:
            raise SystemDefinitionError(
                "start: expected an external input, and as many values as instances, at least 1: "
                f"got {list(external)}, {lengths} and {instances}"
            )
        system, groups = self._checked.check(experiment, external)
        prepared = self._prepared_runs.prepare(system, experiment, tuple(external))
        check_supported(prepared, groups)
        values, signals = self._varied(prepared, vary, instances)
        loop = self._started(prepared, groups, values, signals)
        for instance in np.flatnonzero(loop.failure.ravel()[:instances]).tolist():
            reason = self._reason(prepared, groups, values, instance)
            raise OrchestrationError(f"instance {instance} cannot begin: {reason}")
        return SteppedEnsemble(loop, instances)

    def _run(
        self,
        experiment: Experiment,
        vary: Vary,
        threads: int,
        progress: Callable[[int, int], object] | None,
    ) -> EnsembleRecording:
        system, groups = self._checked.check(experiment)
        prepared = self._prepared_runs.prepare(system, experiment)
        check_supported(prepared, groups)
        values, signals = self._varied(prepared, vary, count := instance_count(vary))
        loop = self._started(prepared, groups, values, signals)
        can_begin = ~loop.failure.ravel()[:count].astype(bool)
        reasons = {i: self._reason(prepared, groups, values, i) for i in np.flatnonzero(~can_begin).tolist()}
        with ThreadPoolExecutor(threads) as pool:
            apply = pool.map if threads > 1 else map
            for group, _ in enumerate(apply(loop.run_group, range(len(loop.rows)))):
                if progress:
                    progress(min(count, (group + 1) * LANES), count)
        for instance in np.flatnonzero(can_begin & (loop.failure.ravel()[:count] != 0)).tolist():
            reasons[instance] = loop.reason(instance)
        counts = loop.recorded.ravel()[:count]
        varied = values | {name: tuple(vary[name]) for name in signals}
        return EnsembleRecording(prepared, varied, loop.rows, counts, dict(sorted(reasons.items())))

    def _varied(self, prepared: PreparedRun, vary: Vary, count: int) -> tuple[Values, dict[str, np.ndarray]]:
        """What begins otherwise in each instance, and its signals: as `EnsembleLoop.varied`."""
        values: Values = {name: [value] * count for name, value in prepared.external.items()}
        values |= checked_values(prepared, vary)
        check_memory(prepared, self._libraries, count, sum(n in prepared.experiment.signals for n in vary))
        signals = varied_signals(prepared, vary)
        for name, of_instances in signals.items():
            values[name] = prepared.typed(name, of_instances[:, 0].ravel()[:count])
        return values, signals

    def _started(
        self,
        prepared: PreparedRun,
        groups: Sequence[ConnectionGroup],
        vary: Values,
        signals: Mapping[str, np.ndarray],
    ) -> EnsembleLoop:
        """The instances with their initial values; `failure` of those that cannot begin is not 0.

        What they have in common is taken from the FMUs, initialised as the first instance that can begin.
        """
        count, reason = len(next(iter(vary.values()))), ""
        for instance in range(count):
            reason = self._reason(prepared, groups, vary, instance)
            if not reason:
                break
        if reason:
            raise OrchestrationError(f"none of {count} instances can begin; the last: {reason}")
        common = {name: self._values(name) for name in self._libraries}
        loop = build_loop(prepared, self._libraries, self.instructions, common, signals, count)
        for name, values in vary.items():
            padded = np.array([*values, *values[-1:] * (-count % LANES)], float)
            loop.values(prepared.system.ports[name])[:] = padded.reshape(-1, LANES)
        for name, library in self._libraries.items():
            steps = loop.memory[name][:, LANES * library.internal_step :][:, :LANES]
            if (steps != steps[0, 0]).any():
                raise EnsembleError(
                    f"{name}.internal_step: expected one for all instances; Simulator has many"
                )
        for group in groups:
            loop.initialise(group)
        loop.initialise()
        return loop

    def _reason(
        self,
        prepared: PreparedRun,
        groups: Sequence[ConnectionGroup],
        vary: Values,
        instance: int,
    ) -> str:
        """Why an instance cannot begin, empty if it can: the FMUs are initialised as it."""
        own = {name: values[instance] for name, values in vary.items()}
        settings = [(port, own.pop(port.name, value)) for port, value in prepared.initial_settings]
        settings += [(prepared.system.ports[name], value) for name, value in own.items()]
        self._load_or_reset()
        try:
            initialise(prepared, groups, self._instances, settings)
        except OrchestrationError as error:
            return str(error)
        return ""

    def _load_or_reset(self) -> None:
        if self._instances and all(
            instance.is_fresh or instance.reset() for instance in self._instances.values()
        ):
            return
        self.close()
        with ExitStack() as loading:
            instances = {}
            for name, path in self.system.components.items():
                instance = FmuInstance(name, path, self._descriptions[name])
                instances[name] = loading.enter_context(instance)
            self._instances, self._loaded = instances, loading.pop_all()

    def _values(self, name: str) -> np.ndarray:
        """The variables of an initialised FMU by value reference."""
        instance = self._instances[name]
        state = instance.get_fmu_state()
        try:
            return self._libraries[name].values(instance.serialize_fmu_state(state))
        finally:
            instance.free_fmu_state(state)

    def close(self) -> None:
        """Free the FMUs; the next run loads them again."""
        self._instances = {}
        self._loaded.close()

    def __exit__(self, *error: object) -> None:
        self.close()

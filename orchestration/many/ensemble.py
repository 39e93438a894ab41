"""Many instances of one system, which step together."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from fmus.errors import nearest
from fmus.fmi.description import is_independent
from fmus.fmi.variable_types import FmiValue
from fmus.platforms import INSTRUCTION_SETS, instruction_sets
from orchestration.errors import EnsembleError, OrchestrationError, SystemDefinitionError
from orchestration.many.ensemble_checks import (
    Vary,
    check_supported,
    checked_values,
    instance_count,
    varied_signals,
)
from orchestration.many.ensemble_loop import EnsembleLoop, check_memory, loop_library
from orchestration.many.lane_library import LANES, lane_library
from orchestration.many.stepped_ensemble import EnsembleRecording, SteppedEnsemble
from orchestration.run.initialisation import ConnectionGroup, initialise
from orchestration.run.loaded_system import LoadedSystem
from orchestration.system.experiment import Experiment
from orchestration.system.prepared_run import PreparedRun
from orchestration.system.system import System

Values = dict[str, list[FmiValue]]
"""Variable -> its value at the start, of each instance."""
Signals = Mapping[str, np.ndarray]
"""As `varied` of `EnsembleLoop`."""


class Ensemble(LoadedSystem):
    """Many instances of a system of native FMUs that this user built, in groups that step at once.

    Every instance has the bits of its own run by a `Simulator` (docs/how-to/ensembles.md says what that rests
    on). The equations are compiled from the sources in the FMUs, once for each FMU, and kept in the user's
    cache. A context manager, which frees the FMUs that the initial values are taken from.

    instructions: "x86-64-v4", "x86-64-v3" or "portable", by default the best that this processor has

    Raises EnsembleError for any other FMU, or without a compiler.
    """

    _kind = "ensemble"

    def __init__(self, system: System, instructions: str | None = None) -> None:
        available = instruction_sets()
        self.instructions = instructions or available[0]
        if self.instructions not in INSTRUCTION_SETS:
            raise EnsembleError(
                f"instructions {instructions!r}: {nearest(self.instructions, INSTRUCTION_SETS)}"
            )
        if self.instructions not in available:
            raise EnsembleError(f"instructions {instructions!r}: this processor has {', '.join(available)}")
        super().__init__(system)
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
        """Runs as many instances of an experiment as there are values to vary; returns their recordings.

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
            run = self._start(experiment, vary, instance_count(vary))
            run.run_to_end(threads, progress)
            return run.recordings()

    def start(
        self, experiment: Experiment, vary: Vary, instances: int, external: Sequence[str]
    ) -> SteppedEnsemble:
        """Starts that many instances, which the caller steps.

        external: inputs that the caller sets between the steps, as of `Simulator.start`; at least one
        Raises what `run` raises; OrchestrationError if an instance cannot begin.
        """
        lengths = {name: len(values) for name, values in vary.items()}
        if instances < 1 or not external or {*lengths.values()} - {instances}:
            raise SystemDefinitionError(
                "start: expected an external input, and as many values as instances, at least 1: "
                f"got {list(external)}, {lengths} and {instances}"
            )
        with self._begin_run():
            run = self._start(experiment, vary, instances, tuple(external))
        for instance, reason in run.failures.items():
            raise OrchestrationError(f"instance {instance} cannot begin: {reason}")
        return run

    def _start(
        self, experiment: Experiment, vary: Vary, count: int, external: tuple[str, ...] = ()
    ) -> SteppedEnsemble:
        system, groups = self._check(experiment, external)
        prepared = self._prepared_runs.prepare(system, experiment, external)
        check_supported(prepared, groups)
        values: Values = {name: [value] * count for name, value in prepared.external.items()}
        values |= checked_values(prepared, vary)
        check_memory(prepared, self._libraries, count, sum(n in experiment.signals for n in vary))
        signals = varied_signals(prepared, vary)
        for name, of_all in signals.items():
            values[name] = prepared.typed(name, of_all[:, 0].ravel()[:count])
        loop = self._initialised(prepared, groups, values, signals)
        varied = {name: vary[name] if name in signals else values[name] for name in vary}
        run = SteppedEnsemble(loop, count, varied)
        run.failures = {i: self._reason(prepared, groups, values, i) for i in run.failures}
        return run

    def _initialised(
        self, prepared: PreparedRun, groups: Sequence[ConnectionGroup], values: Values, signals: Signals
    ) -> EnsembleLoop:
        """Returns the instances with their initial values; `failure` of those that cannot begin is not 0.

        What they have in common is taken from the FMUs, initialised as the first instance that can begin.
        """
        count, reason = len(next(iter(values.values()))), ""
        for instance in range(count):
            reason = self._reason(prepared, groups, values, instance)
            if not reason:
                break
        else:
            raise OrchestrationError(f"none of {count} instances can begin; the last: {reason}")
        common = {name: self._values(name) for name in self._libraries}
        loop = EnsembleLoop(prepared, self._libraries, self.instructions, common, signals, count)
        for name, of_all in values.items():
            padded = np.array([*of_all, *of_all[-1:] * (-count % LANES)], float)
            loop.values(prepared.system.ports[name])[:] = padded.reshape(-1, LANES)
        for name, library in self._libraries.items():
            steps = loop.memory[name][:, LANES * library.internal_step :][:, :LANES]
            if (steps != steps[0, 0]).any():
                raise EnsembleError(
                    f"{name}.internal_step: expected one for all instances; Simulator has many"
                )
        for group in (*groups, None):
            loop.initialise(group)
        return loop

    def _reason(
        self, prepared: PreparedRun, groups: Sequence[ConnectionGroup], values: Values, instance: int
    ) -> str:
        """Returns why an instance cannot begin, empty if it can: the FMUs are initialised as it."""
        own = {name: of_all[instance] for name, of_all in values.items()}
        settings = [(port, own.pop(port.name, value)) for port, value in prepared.initial_settings]
        settings += [(prepared.system.ports[name], value) for name, value in own.items()]
        self._load_or_reset()
        try:
            initialise(prepared, groups, self._instances, settings)
        except OrchestrationError as error:
            return str(error)
        return ""

    def _values(self, name: str) -> np.ndarray:
        """Returns the variables of an initialised FMU by value reference."""
        instance = self._instances[name]
        state = instance.get_fmu_state()
        try:
            return self._libraries[name].values(instance.serialize_fmu_state(state))
        finally:
            instance.free_fmu_state(state)

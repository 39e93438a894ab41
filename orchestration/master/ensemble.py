"""Many instances of one system, which step together."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack
from typing import Any

import numpy as np

from fmus.errors import nearest
from fmus.platforms import INSTRUCTION_SETS, instruction_sets
from orchestration.errors import EnsembleError, OrchestrationError, SystemDefinitionError
from orchestration.fmi.description import describe, is_independent
from orchestration.fmi.instance import FmuInstance
from orchestration.master.ensemble_loop import EnsembleLoop, build_loop
from orchestration.master.ensemble_recording import EnsembleRecording
from orchestration.master.initialisation import connection_groups, initialise
from orchestration.master.lane_library import lane_library
from orchestration.system.experiment import Experiment
from orchestration.system.prepared_run import PreparedRun, Setting, has_start_value, prepare
from orchestration.system.system import System
from orchestration.system.values import Value, fmi_value

Vary = Mapping[str, Sequence[Value] | np.ndarray]


class Ensemble(AbstractContextManager["Ensemble"]):
    """Many instances of a system of native FMUs of this exporter, in groups that step at once; a context manager.

    Every instance has the bits of its own run by a `Simulator` (docs/how-to/ensembles.md says what that rests
    on). The equations are compiled from the sources in the FMUs, once for each FMU, and kept in the user's cache.

    instructions: "x86-64-v4", "x86-64-v3" or "portable", by default the best that this processor has

    Raises EnsembleError for an FMU that has no sources of this exporter, or without a compiler.
    """

    def __init__(self, system: System, instructions: str | None = None) -> None:
        self.system = system
        available = instruction_sets()
        self.instructions = instructions or available[0]
        if self.instructions not in INSTRUCTION_SETS:
            raise EnsembleError(f"instructions {instructions!r}: {nearest(self.instructions, INSTRUCTION_SETS)}")
        if self.instructions not in available:
            raise EnsembleError(f"instructions {instructions!r}: this processor has {', '.join(available)}")
        self._loaded = ExitStack()
        self._instances: dict[str, FmuInstance] = {}
        for name, path in system.components.items():
            if not is_independent(describe(path)):
                raise EnsembleError(f"{name}: {path}: expected a native FMU of l1-depth; Simulator runs any FMU")
        self._libraries = {
            name: lane_library(name, path, self.instructions) for name, path in system.components.items()
        }

    def run(
        self,
        experiment: Experiment,
        vary: Vary,
        *,
        threads: int = 1,
        progress: Callable[[int, int], object] | None = None,
    ) -> EnsembleRecording:
        """Run as many instances of an experiment as there are values to vary, and return what they recorded.

        vary: name of a parameter or of a constant input -> its values, shape (instances,)
        threads: that run groups of instances at once
        progress: called with the instances that are done, and all of them

        An instance that cannot begin, or cannot go on, is in `failures` of the result and disturbs no other.
        Raises SystemDefinitionError for what does not fit, EnsembleError for what only a `Simulator` can run.
        """
        prepared = prepare(self.system, experiment)
        check_supported(prepared)
        settings = _settings(prepared, vary)
        initial, failures = self._initial_values(prepared, settings)
        loop = build_loop(prepared, self._libraries, initial)
        count, lanes = len(settings), loop.data.lanes
        with ThreadPoolExecutor(threads) as pool:
            for group, _ in enumerate(pool.map(loop.run_group, range(loop.data.n_groups))):
                if progress:
                    progress(min(count, (group + 1) * lanes), count)
        return _recording(loop, count, failures)

    def _initial_values(
        self, prepared: PreparedRun, settings: Sequence[Sequence[Setting]]
    ) -> tuple[dict[str, np.ndarray], dict[int, str]]:
        """What the instances begin with, by component; instance -> why it cannot begin.

        The FMUs themselves are initialised, one instance after another.
        """
        groups, lanes = connection_groups(prepared.system), next(iter(self._libraries.values())).lanes
        rows: dict[str, list[np.ndarray | None]] = {name: [] for name in self._libraries}
        failures = {}
        for instance, own in enumerate(settings):
            try:
                self._load_or_reset()
                initialise(prepared, groups, self._instances, own)
                states = {name: self._words(name) for name in self._libraries}
            except OrchestrationError as error:
                failures[instance] = str(error)
                states = dict.fromkeys(self._libraries)
            for name, state in states.items():
                rows[name].append(state)
        if len(failures) == len(settings):
            raise EnsembleError(f"no instance can begin; the first: {failures[0]}")
        return {name: self._padded(name, values, lanes) for name, values in rows.items()}, failures

    def _load_or_reset(self) -> None:
        if self._instances and all(instance.is_fresh or instance.reset() for instance in self._instances.values()):
            return
        self.close()
        for name, path in self.system.components.items():
            instance = FmuInstance(name, path, describe(path))
            self._instances[name] = self._loaded.enter_context(instance)

    def _words(self, name: str) -> np.ndarray:
        instance = self._instances[name]
        state = instance.get_fmu_state()
        try:
            return self._libraries[name].initial_words(instance.serialize_fmu_state(state))
        finally:
            instance.free_fmu_state(state)

    def _padded(self, name: str, rows: Sequence[np.ndarray | None], lanes: int) -> np.ndarray:
        """One row for each lane of whole groups: another instance's for one that cannot begin, and at the end."""
        some = next(row for row in rows if row is not None)
        table = np.array([some if row is None else row for row in rows] + [some] * (-len(rows) % lanes))
        internal_steps = table[:, self._libraries[name].internal_step]
        if (internal_steps != internal_steps[0]).any():
            raise EnsembleError(f"{name}.internal_step: expected one value for all instances; Simulator takes several")
        return table

    def close(self) -> None:
        """Free the FMUs; the next run loads them again."""
        self._instances = {}
        self._loaded.close()

    def __exit__(self, *error: object) -> None:
        self.close()


def check_supported(prepared: PreparedRun) -> None:
    """EnsembleError for an experiment with something that steps of whole groups do not have."""
    experiment = prepared.experiment
    reasons = {
        "extrapolation": experiment.extrapolation,
        "step_sizes": any(period > 1 for period in prepared.periods.values()),
        "tolerance": experiment.tolerance,
        "faults": experiment.faults,
        "error_estimate": experiment.error_estimate,
    }
    for name, is_used in reasons.items():
        if is_used:
            raise EnsembleError(f"{name}: an ensemble has none; Simulator.run does")
    for _, target in prepared.system.connections:
        if target.variable.type == "Enumeration":
            raise EnsembleError(f"{target.name}: an ensemble has no connections of Enumerations; Simulator does")


def _settings(prepared: PreparedRun, vary: Vary) -> list[list[Setting]]:
    """The settings of each instance, in the order of those of the prepared run; new ones last."""
    lengths = {name: len(values) for name, values in vary.items()}
    if not lengths or len({*lengths.values()}) > 1 or 0 in lengths.values():
        raise SystemDefinitionError(f"vary: expected lists of one length, at least 1, got {lengths}")
    ports = {name: prepared.system.port(name, "vary") for name in vary}
    given = {port.name for port, _ in prepared.settings}
    for name, port in ports.items():
        is_constant_input = port.variable.causality == "input" and name in given
        if not (is_constant_input or has_start_value(port.variable)):
            kind = f"{port.variable.causality} that a connection or a signal drives, or that is calculated"
            raise SystemDefinitionError(f"vary: {name}: expected a parameter or a constant input, got one of {kind}")
    values = {name: [fmi_value(ports[name], value) for value in vary[name]] for name in vary}
    common = [(port, value) for port, value in prepared.settings if port.name not in vary]
    count = next(iter(lengths.values()))
    return [[*common, *((ports[name], values[name][i]) for name in vary)] for i in range(count)]


def _recording(loop: EnsembleLoop, count: int, failures: Mapping[int, str]) -> EnsembleRecording:
    counts, reasons = loop.data.recorded[:count].copy(), dict(failures)
    for instance in failures:
        counts[instance] = 0
    for instance in np.flatnonzero(loop.data.failure[:count]):
        if int(instance) not in reasons:
            reasons[int(instance)] = _reason(loop, int(instance), loop.data)
    return EnsembleRecording(loop.prepared, loop.data.rows, counts, dict(sorted(reasons.items())))


def _reason(loop: EnsembleLoop, instance: int, data: Any) -> str:
    """Why an instance ended early."""
    number, time = int(data.failure[instance]), float(data.points[data.recorded[instance] - 1])
    if number < 0:
        return f"{loop.connections[-1 - number]} at t = {time:.9g} s: a value that the input cannot have"
    name = list(loop.libraries)[number - 1]
    return f"{name} at t = {time:.9g} s: the step is refused; Simulator.run of this instance says why"

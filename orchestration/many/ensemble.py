"""Many instances of one system, which step together: what can be run so, and the instances of a run."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fmus.fmi.description import describe, is_independent
from fmus.fmi.variable_types import FmiValue
from fmus.platforms import instruction_sets
from orchestration.errors import EnsembleError, OrchestrationError, SystemDefinitionError
from orchestration.many.ensemble_loop import Device, EnsembleLoop, loop_library
from orchestration.many.job import ENTRIES
from orchestration.many.lane_library import LANES, aligned, is_compiled, lane_library
from orchestration.many.stepped_ensemble import EnsembleRecording, SteppedEnsemble
from orchestration.run.initialisation import initialise
from orchestration.run.simulator import LoadedSystem
from orchestration.system.experiment import Experiment
from orchestration.system.experiment_checks import check_fits
from orchestration.system.prepared_run import PreparedRun, check_for, prepare_checked
from orchestration.system.signals import Signal
from orchestration.system.system import System
from orchestration.system.values import fmi_values

Values = dict[str, list[FmiValue]]
"""Variable -> its value at the start, of each instance."""
Signals = Mapping[str, np.ndarray]
"""As `varied` of `EnsembleLoop`."""
_MOST_BYTES = 2**28  # of recorded values of the groups of all threads
# each costs 0.25 us more an FMU in a Simulator; to compile an FMU takes 2 to 3 s
_STEPS_WORTH_COMPILING = 1e7


def shape(experiment: Experiment) -> tuple[object, ...]:
    """Returns what the experiments of instances that step together have in common: all but values."""
    return tuple(v.keys() if name in ENTRIES else v for name, v in vars(experiment).items())


class Ensemble(LoadedSystem):
    """Many instances of a system of native FMUs that this user built, in groups that step at once.

    Every instance has the bits of a single run by a `Simulator`: the exporter writes the same operations for
    both, compiled without fused ones. Elementary functions come from the C library. Steps are as long, and
    values that an event sets act from the next step. The sign of a NaN alone is left open.
    Both libraries must use one C library. docs/how-to/ensembles.md has what is refused.

    The equations are compiled from the sources in the FMUs, once for each FMU, and kept in the user's cache.
    A context manager, which frees the FMUs that the initial values are taken from.

    Parameters
    ----------
    system : System
        Native FMUs that `l1-depth build` wrote for this user.
    instructions : str, optional
        "x86-64-v4", "x86-64-v3" or "portable"; by default the best of this processor.
    device : Device, optional
        Runs the instances in place of this processor, as `device_of("gpu")` of `orchestration.many.places`.
        Elementary functions then come from the device.

    Raises
    ------
    EnsembleError
        For any other FMU, or without a compiler.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from orchestration import load_scenario
    >>> nominal = load_scenario("nominal-extended")
    >>> short = replace(nominal.experiment, stop_time=2.0)
    >>> given = [{**short.parameters, "plant.inertia": inertia} for inertia in (5.0, 6.0, 7.0)]  # kg
    >>> with Ensemble(nominal.system) as ensemble:
    ...     result = ensemble.run([replace(short, parameters=parameters) for parameters in given])
    >>> result["plant.depth"].shape, result.failures
    ((3, 101), {})
    """

    def __init__(self, system: System, instructions: str | None = None, device: Device | None = None) -> None:
        available = instruction_sets()
        self.instructions = instructions or available[0]
        if self.instructions not in available:
            raise EnsembleError(f"instructions {instructions!r}: this processor has {', '.join(available)}")
        super().__init__(system)
        for name, description in self._descriptions.items():
            if not is_independent(description):
                raise EnsembleError(
                    f"{name}: {system.components[name]}: expected a native FMU that "
                    "l1-depth build wrote for this user; Simulator runs any FMU"
                )
        self._device, self._libraries = device, dict[str, Any]()
        self._loop_class = device.loop if device else EnsembleLoop
        if device:
            self._functions: Any = device.program(system.components)
            self._libraries |= self._functions.components
        else:
            self._functions = loop_library(self.instructions)
            for name, path in system.components.items():
                self._libraries[name] = lane_library(name, path, self.instructions)
        for name, library in self._libraries.items():
            if library.wholes:
                raise EnsembleError(
                    f"{name}: an Ensemble has no whole numbers of an FMU of Reals alone; a Simulator has"
                )

    def run(self, experiments: Sequence[Experiment]) -> EnsembleRecording:
        """Runs an instance for each experiment and returns their recordings.

        Parameters
        ----------
        experiments : sequence of Experiment
            At least one. They differ only in values of the same parameters, inputs and signals.

        Returns
        -------
        EnsembleRecording
            Values of shape (instances, points). An instance that cannot begin or continue is in its
            `failures`; the others are not affected.

        Raises
        ------
        SystemDefinitionError
            For experiments that do not fit the system or each other.
        EnsembleError
            For an experiment that only a `Simulator` can run.
        OrchestrationError
            If no instance can begin.
        """
        with self._begin_run():
            run = self._start(experiments)
            run.run_to_end()
            return run.recording()

    def start(self, experiments: Sequence[Experiment], external: Sequence[str]) -> SteppedEnsemble:
        """Starts one instance per experiment; the caller steps them.

        Parameters
        ----------
        experiments : sequence of Experiment
            As for `run`.
        external : sequence of str
            Inputs that the caller sets between the steps, as in `Simulator.start`.

        Returns
        -------
        SteppedEnsemble
            The instances, at the start time.

        Raises
        ------
        OrchestrationError
            If an instance cannot begin; also the errors of `run`.
        """
        with self._begin_run():
            run = self._start(experiments, tuple(external))
        for instance, reason in run.failures.items():
            raise OrchestrationError(f"instance {instance} cannot begin: {reason}")
        return run

    def _start(self, experiments: Sequence[Experiment], external: tuple[str, ...] = ()) -> SteppedEnsemble:
        if not experiments or any(shape(other) != shape(experiments[0]) for other in experiments):
            raise SystemDefinitionError(
                f"ensemble: got {len(experiments)} experiments: expected at least one, "
                "which differ in values of the same parameters, inputs and signals alone"
            )
        system = self._check(experiments[0], external)
        prepared = self._prepared_runs.prepare(system, experiments[0], external)
        check_supported(prepared)
        count, varied = len(experiments), _varied(experiments)
        of_signals = [name for name in varied if name in prepared.experiment.signals]
        self._check_memory(prepared, count, len(of_signals))
        lanes = count if self._device else LANES
        signals = {name: _signal_lanes(prepared, name, varied.pop(name), lanes) for name in of_signals}
        values: Values = {name: [value] * count for name, value in prepared.external.items()}
        values |= {name: fmi_values(system.ports[name], column) for name, column in varied.items()}
        for name, of_all in signals.items():
            values[name] = prepared.typed(name, of_all[:, 0].ravel()[:count])
        run = SteppedEnsemble(self._initialised(prepared, values, signals, count), count)
        run.failures = {i: self._reason(prepared, values, i) for i in run.failures}
        return run

    def _check_memory(self, prepared: PreparedRun, count: int, varied: int) -> None:
        """Raises SystemDefinitionError for more than there is; varied: signals of each instance."""
        points, columns = prepared.shape
        signals = f" and {varied} signals" if varied else ""
        check_fits(
            8 * self._loop_class.words(prepared, self._libraries, count, varied),
            f"{count} instances of {points} communication points of {columns} variables{signals}",
            "record fewer variables, or run fewer instances at once",
            self._device.free_bytes() if self._device else None,
        )

    def _initialised(
        self, prepared: PreparedRun, values: Values, signals: Signals, count: int
    ) -> EnsembleLoop:
        """Returns the instances with their initial values; `failure` of those that cannot begin is not 0.

        What they have in common is taken from the FMUs, initialised as the first instance that can begin.
        """
        reason = ""
        for instance in range(count):
            reason = self._reason(prepared, values, instance)
            if not reason:
                break
        else:
            raise OrchestrationError(f"none of {count} instances can begin; the last: {reason}")
        common = {name: self._values(name) for name in self._libraries}
        loop = self._loop_class(self._functions, prepared, self._libraries, common, signals, count)
        for name, of_all in values.items():
            loop.put(prepared.system.ports[name], np.array(of_all, float))
        for name, library in self._libraries.items():
            steps = loop.of_reference(name, library.internal_step)
            if (steps != steps[0, 0]).any():
                raise EnsembleError(
                    f"{name}.internal_step: expected one for all instances; Simulator has many"
                )
        for group in (*prepared.system.connection_groups, None):
            loop.initialise(group)
        return loop

    def _reason(self, prepared: PreparedRun, values: Values, instance: int) -> str:
        """Returns why an instance cannot begin, empty if it can: the FMUs are initialised as it."""
        own = {name: of_all[instance] for name, of_all in values.items()}
        settings = [(port, own.pop(port.name, value)) for port, value in prepared.initial_settings]
        settings += [(prepared.system.ports[name], value) for name, value in own.items()]
        self._load_or_reset()
        try:
            initialise(prepared, self._instances, settings)
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


def check_ensemble(
    system: System,
    experiment: Experiment,
    instances: int,
    is_asked_for: bool = False,
    external: Sequence[str] = (),
    threads: int = 1,
) -> int:
    """Returns the bytes of the values that a group of an ensemble records.

    instances: how many are run in all; is_asked_for: also where it does not pay
    external: inputs that the caller sets between the steps; FMUs are then compiled only if it is asked for
    threads: how many run a group at a time
    Raises EnsembleError, which says why simulators run them: an ensemble cannot, or it does not pay.
    """
    descriptions = {name: describe(path) for name, path in system.components.items()}
    for name, description in descriptions.items():
        if not is_independent(description):
            raise EnsembleError(f"{name} is no native FMU that l1-depth build wrote for this user")
    checked = check_for(system, experiment, external, descriptions)
    prepared = prepare_checked(checked, experiment, external)
    check_supported(prepared)
    points, columns = prepared.shape
    group_bytes = 8 * LANES * points * columns
    if not is_asked_for:
        steps = 0 if external else instances * experiment.step_count  # as far as known
        _check_pays(system, instances, steps, group_bytes, threads)
    return group_bytes


def _check_pays(system: System, instances: int, steps: int, group_bytes: int, threads: int) -> None:
    """Raises EnsembleError where simulators run as fast, or in much less memory."""
    if instances < LANES:
        raise EnsembleError(f"{instances} runs are less than the {LANES} that step at once")
    if (n_bytes := threads * group_bytes) > _MOST_BYTES:
        raise EnsembleError(f"{threads * LANES} runs at once record {n_bytes / 1e6:.0f} MB")
    best = instruction_sets()[0]
    compiled = [is_compiled(name, path, best) for name, path in system.components.items()]
    if steps < _STEPS_WORTH_COMPILING and not all(compiled):
        raise EnsembleError(f"compiling the FMUs takes longer than it saves in {steps} steps")


def check_supported(prepared: PreparedRun) -> None:
    """Raises EnsembleError for an experiment with something that steps of whole groups do not have."""
    experiment = prepared.experiment
    reasons = {
        "extrapolation": experiment.extrapolation,
        "step_sizes": any(period > 1 for period in prepared.periods.values()),
        "tolerance": experiment.tolerance,
        "faults": experiment.faults,
        "error_estimate": experiment.error_estimate,
        "an algebraic loop of initial values": any(
            group.is_loop for group in prepared.system.connection_groups
        ),
        "a connection of an Enumeration": any(
            target.variable.type == "Enumeration" for _, target in prepared.system.connections
        ),
    }
    for name, is_used in reasons.items():
        if is_used:
            raise EnsembleError(f"{name}: an Ensemble does not run it; a Simulator does")


def _varied(experiments: Sequence[Experiment]) -> dict[str, list[Any]]:
    """Returns name -> value in each experiment of one shape, but where all have the same object."""
    columns = {
        name: [getattr(experiment, entries)[name] for experiment in experiments]
        for entries in ENTRIES
        for name in getattr(experiments[0], entries)
    }
    return {name: column for name, column in columns.items() if any(v is not column[0] for v in column)}


def _signal_lanes(prepared: PreparedRun, name: str, signals: Sequence[Signal], of_group: int) -> np.ndarray:
    """Returns the signal of each instance at each point, shape (groups, points, lanes).

    Raises SystemDefinitionError for one that fails or has a value that the input cannot have.
    """
    lanes = aligned(-(-len(signals) // of_group), len(prepared.points), of_group)
    for instance, signal in enumerate(signals):
        try:
            values = prepared.values_of_signal(name, signal)
        except SystemDefinitionError as error:
            raise SystemDefinitionError(f"instance {instance}: {error}") from error
        group, lane = divmod(instance, of_group)
        lanes[group, :, lane : None if instance + 1 == len(signals) else lane + 1] = values[:, None]
    return lanes

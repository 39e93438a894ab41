"""Checks of an ensemble: what it can run, where that pays, and which values can be varied."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from fmus.fmi.description import describe, is_independent
from fmus.fmi.variable_types import FmiValue
from fmus.platforms import instruction_sets
from orchestration.errors import EnsembleError, SystemDefinitionError
from orchestration.many.lane_library import LANES, aligned, is_compiled
from orchestration.run.initialisation import ConnectionGroup, connection_groups
from orchestration.system.experiment import Experiment
from orchestration.system.prepared_run import PreparedRun, check_for, has_start_value, prepare_checked
from orchestration.system.signals import Signal
from orchestration.system.system import Port, System
from orchestration.system.values import Value, fmi_values, items

Vary = Mapping[str, Sequence[Value | Signal] | np.ndarray]
_MOST_BYTES = 2**28  # of recorded values of the groups of all threads
_STEPS_WORTH_COMPILING = (
    1e7  # each costs 0.25 us more an FMU in a Simulator; to compile an FMU takes 2 to 3 s
)


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
    check_supported(prepared, connection_groups(checked))
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
        raise EnsembleError(f"to compile the FMUs takes longer than {steps} steps save")


def check_supported(prepared: PreparedRun, groups: Sequence[ConnectionGroup]) -> None:
    """Raises EnsembleError for an experiment with something that steps of whole groups do not have."""
    experiment = prepared.experiment
    reasons = {
        "extrapolation": experiment.extrapolation,
        "step_sizes": any(period > 1 for period in prepared.periods.values()),
        "tolerance": experiment.tolerance,
        "faults": experiment.faults,
        "error_estimate": experiment.error_estimate,
        "an algebraic loop of initial values": any(group.is_loop for group in groups),
        "a connection of an Enumeration": any(
            target.variable.type == "Enumeration" for _, target in prepared.system.connections
        ),
        "an event with a number that is no item": any(
            _not_items(port, [value]) for changes in prepared.changes.values() for port, value in changes
        ),
    }
    for name, is_used in reasons.items():
        _refuse_if(is_used, name)
    for name, values in zip(experiment.signals, prepared.signal_values, strict=True):
        _check_items(prepared.system.ports[name], values)


def instance_count(vary: Vary) -> int:
    """Returns the number of values, at least 1; SystemDefinitionError unless variables have equally many."""
    lengths = {name: len(values) for name, values in vary.items()}
    if len({*lengths.values()}) != 1 or 0 in lengths.values():
        raise SystemDefinitionError(f"vary: expected lists of one length, at least 1, got {lengths}")
    return lengths.popitem()[1]


def checked_values(prepared: PreparedRun, vary: Vary) -> dict[str, list[FmiValue]]:
    """Returns the values to vary, but signals, as the FMUs take them.

    Raises SystemDefinitionError for what cannot be varied so.
    """
    values: dict[str, Any] = {n: v for n, v in vary.items() if n not in prepared.experiment.signals}
    given = {port.name for port, _ in prepared.settings}
    for name, of_instances in values.items():
        variable = prepared.system.port(name, "vary").variable
        if not (has_start_value(variable) or (variable.causality == "input" and name in given)):
            driven = "one that is driven" if variable.causality == "input" else variable.causality
            raise SystemDefinitionError(
                f"vary: {name}: expected a parameter or a constant input, got {driven}"
            )
        if any(map(callable, of_instances)):
            raise SystemDefinitionError(f"vary: {name}: it has no signal in the experiment: expected values")
    ports = prepared.system.ports
    checked = {name: fmi_values(ports[name], of_instances) for name, of_instances in values.items()}
    for name, of_instances in checked.items():
        for value in _not_items(ports[name], of_instances):
            numbers = ", ".join(f"{item} ({number})" for item, number in items(ports[name]).items())
            raise SystemDefinitionError(f"vary: {name} = {value}: expected one of {numbers}")
    return checked


def varied_signals(prepared: PreparedRun, vary: Vary) -> dict[str, np.ndarray]:
    """Returns input -> the signal to vary, of each instance at each point, shape (groups, points, lanes).

    Raises SystemDefinitionError for what is no signal or has a value that the input cannot have,
    EnsembleError for a number that is no item.
    """
    signals: dict[str, Any] = {n: s for n, s in vary.items() if n in prepared.experiment.signals}
    return {name: _lanes(prepared, name, of_instances) for name, of_instances in signals.items()}


def _lanes(prepared: PreparedRun, name: str, signals: Sequence[Signal]) -> np.ndarray:
    lanes = aligned(-(-len(signals) // LANES), len(prepared.points), LANES)
    for instance, signal in enumerate(signals):
        if not callable(signal):
            raise SystemDefinitionError(f"vary: {name} = {signal!r}: expected a signal, as in the experiment")
        try:
            values = prepared.values_of_signal(name, signal)
        except SystemDefinitionError as error:
            raise SystemDefinitionError(f"vary: instance {instance}: {error}") from error
        _check_items(prepared.system.ports[name], values)
        group, lane = divmod(instance, LANES)
        lanes[group, :, lane : None if instance + 1 == len(signals) else lane + 1] = values[:, None]
    return lanes


def _check_items(port: Port, values: np.ndarray) -> None:
    """Raises EnsembleError for a signal with a number that the Enumeration does not have."""
    _refuse_if(bool(_not_items(port, values)), "a signal with a number that is no item")


def _refuse_if(is_used: bool, name: str) -> None:
    if is_used:
        raise EnsembleError(f"{name}: an Ensemble does not run it; a Simulator does")


def _not_items(port: Port, values: Iterable[FmiValue] | np.ndarray) -> set[FmiValue]:
    """Returns the numbers that an Enumeration does not have: none for another type."""
    return {*values} - {*items(port).values()} if port.variable.type == "Enumeration" else set()

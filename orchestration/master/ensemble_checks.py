"""What an ensemble can run, and which values can be varied."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from fmus.fmi_types import FmiValue
from orchestration.errors import EnsembleError, SystemDefinitionError
from orchestration.master.initialisation import ConnectionGroup
from orchestration.system.prepared_run import PreparedRun, has_start_value
from orchestration.system.system import Port
from orchestration.system.values import Value, fmi_values, items

Vary = Mapping[str, Sequence[Value] | np.ndarray]


def check_supported(prepared: PreparedRun, groups: Sequence[ConnectionGroup]) -> None:
    """EnsembleError for an experiment with something that steps of whole groups do not have."""
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
        "a signal with a number that is no item": any(
            _not_items(prepared.system.ports[name], values)
            for name, values in zip(experiment.signals, prepared.signal_values, strict=True)
        ),
    }
    for name, is_used in reasons.items():
        if is_used:
            raise EnsembleError(f"{name}: an Ensemble does not run it; a Simulator does")


def checked_values(prepared: PreparedRun, vary: Vary) -> dict[str, list[FmiValue]]:
    """The values to vary as the FMUs take them; SystemDefinitionError for what cannot be varied so."""
    lengths = {name: len(values) for name, values in vary.items()}
    if not lengths or len({*lengths.values()}) > 1 or 0 in lengths.values():
        raise SystemDefinitionError(f"vary: expected lists of one length, at least 1, got {lengths}")
    given = {port.name for port, _ in prepared.settings}
    for name in vary:
        variable = prepared.system.port(name, "vary").variable
        if not (has_start_value(variable) or (variable.causality == "input" and name in given)):
            driven = "one that is driven" if variable.causality == "input" else variable.causality
            raise SystemDefinitionError(
                f"vary: {name}: expected a parameter or a constant input, got {driven}"
            )
    ports = prepared.system.ports
    checked = {name: fmi_values(ports[name], values) for name, values in vary.items()}
    for name, values in checked.items():
        for value in _not_items(ports[name], values):
            numbers = ", ".join(f"{item} ({number})" for item, number in items(ports[name]).items())
            raise SystemDefinitionError(f"vary: {name} = {value}: expected one of {numbers}")
    return checked


def _not_items(port: Port, values: Iterable[FmiValue] | np.ndarray) -> set[FmiValue]:
    """The numbers that an Enumeration does not have: none for another type."""
    return {*values} - {*items(port).values()} if port.variable.type == "Enumeration" else set()

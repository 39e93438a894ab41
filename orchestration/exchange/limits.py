"""What another tool cannot express is refused here, before anything is written.

Every exporter carries a system whose components exchange values at communication points, in the order of
Jacobi, and whose signals are ramps; this is what an SSP package, a block diagram and a Modelica model have
in common.
"""

from collections.abc import Iterable

from orchestration.errors import ScenarioError
from orchestration.system.experiment import Algorithm, Experiment
from orchestration.system.signals import Ramps, Signal
from orchestration.system.system import CheckedSystem, Port


def check_plain_exchange(experiment: Experiment, target: str) -> None:
    """Raise ScenarioError for all that is more than an exchange at every communication point.

    target: subject of the message, such as "a Modelica package"
    """
    features = {
        f"algorithm {experiment.algorithm}": experiment.algorithm is not Algorithm.JACOBI,
        "extrapolation": experiment.extrapolation,
        "step sizes of components": experiment.step_sizes,
        "a tolerance": experiment.tolerance,
        "events": experiment.events,
        "faults": experiment.faults,
    }
    present = ", ".join(name for name, is_present in features.items() if is_present)
    if present:
        raise ScenarioError(f"{target} with {present}: expected none, it cannot carry them")


def check_plain_connections(system: CheckedSystem, target: str) -> None:
    """Raise ScenarioError for a connection with a factor or an offset."""
    for name, transformation in system.transformations.items():
        raise ScenarioError(
            f"{target} with {transformation} of the connection into {name}: expected plain connections"
        )


def check_types(ports: Iterable[Port], types: tuple[str, ...], target: str) -> None:
    """Raise ScenarioError for a variable whose FMI type is not among these."""
    for port in ports:
        if port.variable.type not in types:
            raise ScenarioError(
                f"{target} with {port.name}: expected type {' or '.join(types)}, got {port.variable.type}"
            )


def as_ramps(input_name: str, signal: Signal) -> Ramps:
    """The signal, if it is ramps, straight or smooth; ScenarioError otherwise."""
    if not isinstance(signal, Ramps):
        kind = type(signal).__name__
        raise ScenarioError(f"signal {input_name}: expected ramps, which a component can give; got {kind}")
    return signal


def straight_points(input_name: str, signal: Signal) -> list[tuple[float, float]]:
    """(time [s], value) of straight ramps, as a table that is interpolated has them; else ScenarioError."""
    if not isinstance(signal, Ramps) or signal.smooth:
        raise ScenarioError(f"signal {input_name}: expected straight ramps, the only ones a table gives")
    return [(float(time), float(value)) for time, value in signal.points]

"""Parts of all exporters: refusals, before anything is written, and the texts that are filled in.

Every exporter carries a system whose components exchange values at communication points, in the order of
Jacobi, and whose signals are lines through points; this is what an SSP package and a block
diagram have in common.
"""

from collections.abc import Iterable
from importlib import resources
from string import Template

import numpy as np

from fmus.fmi.description import describe
from orchestration.errors import ScenarioError
from orchestration.scenarios.scenario import Scenario
from orchestration.system.experiment import Algorithm, Experiment
from orchestration.system.prepared_run import PreparedRun, prepare
from orchestration.system.signals import Constant, Cosine, Ramps, Signal, Sines, Table
from orchestration.system.system import Port, System
from orchestration.system.time_grid import GRID_TOLERANCE

_OTHERS = "a constant or a table"  # signals that ramps can give


def check_plain_exchange(experiment: Experiment, target: str) -> None:
    """Raises ScenarioError for all that is more than an exchange at every communication point.

    target: subject of the message, such as "a Simulink model"
    """
    features = {
        f"algorithm {experiment.algorithm}": experiment.algorithm is not Algorithm.JACOBI,
        "extrapolation": experiment.extrapolation,
        "step sizes of components": experiment.step_sizes,
        "a tolerance": experiment.tolerance or experiment.fmu_tolerance,
        "events": experiment.events,
        "faults": experiment.faults,
    }
    present = ", ".join(name for name, is_present in features.items() if is_present)
    if present:
        raise ScenarioError(f"{target} with {present}: expected none, it cannot carry them")


def check_standard(system: System, target: str) -> None:
    """Raises ScenarioError for an FMU of FMI 3.0, whose arrays are no scalars elsewhere."""
    for name, path in system.components.items():
        if (version := describe(path).fmiVersion) != "2.0":
            raise ScenarioError(
                f"{target} with {name}, {path.name}, of FMI {version}: expected FMI 2.0, as of l1-depth build"
            )


def prepare_plain(scenario: Scenario, target: str) -> PreparedRun:
    """Returns the run of a scenario that exchanges plainly, by connections without factor and offset.

    Raises ScenarioError for another one.
    """
    check_plain_exchange(scenario.experiment, target)
    check_standard(scenario.system, target)
    prepared = prepare(scenario.system, scenario.experiment)
    for name, transformation in prepared.system.transformations.items():
        raise ScenarioError(
            f"{target} with {transformation} of the connection into {name}: expected plain connections"
        )
    return prepared


def check_types(ports: Iterable[Port], types: tuple[str, ...], target: str) -> None:
    """Raises ScenarioError for a variable whose FMI type is not among these."""
    for port in ports:
        if port.variable.type not in types:
            raise ScenarioError(
                f"{target} with {port.name}: expected type {' or '.join(types)}, got {port.variable.type}"
            )


def as_ramps(input_name: str, signal: Signal, experiment: Experiment) -> Ramps:
    """Returns ramps, constants and tables as ramps; ScenarioError for any other signal.

    A table that holds its values becomes ramps of one communication step, which have its values at every
    communication point of the experiment.
    """
    if isinstance(signal, Ramps):
        return signal
    if isinstance(signal, Constant):
        return Ramps([(0.0, signal.value)])
    if isinstance(signal, Table):
        times = _around_changes(signal, experiment) if signal.hold else np.asarray(signal.times)
        return Ramps(np.column_stack([times, signal.at(times)]).tolist())
    kind = _kind(signal)
    raise ScenarioError(
        f"signal {input_name}: expected ramps, {_OTHERS}, which a component can give; got {kind}"
    )


def _around_changes(table: Table, experiment: Experiment) -> np.ndarray:
    """Returns the communication points at which the values of a table arrive, and those before them [s]."""
    start, step = experiment.start_time, experiment.step_size
    arrivals = np.ceil((np.asarray(table.times) - start) / step - GRID_TOLERANCE)
    return start + step * np.unique([*(arrivals - 1.0), *arrivals])


def straight_points(input_name: str, signal: Signal, experiment: Experiment) -> list[tuple[float, float]]:
    """Returns (time [s], value) of straight lines, as an interpolated table has them.

    Raises ScenarioError for another signal.
    """
    can_be_ramps = isinstance(signal, (Ramps, Constant, Table))
    if not can_be_ramps or (isinstance(signal, Ramps) and signal.smooth):
        expected = f"expected straight ramps, {_OTHERS}, which an interpolated table gives"
        raise ScenarioError(f"signal {input_name}: {expected}; got {_kind(signal)}")
    return [(float(time), float(value)) for time, value in as_ramps(input_name, signal, experiment).points]


def _kind(signal: Signal) -> str:
    kinds = {Ramps: "smooth ramps", Cosine: "a cosine", Sines: "sines"}
    return kinds.get(type(signal), "another function of time")


_FOLDER = resources.files("orchestration.exchange") / "files"


def filled(file: str, /, **values: object) -> str:
    """Returns the text of a file of `files/` with its placeholders, `${name}`, replaced."""
    return Template((_FOLDER / file).read_text(encoding="utf-8")).substitute(values)

"""Parts of the exporters: refusals, before anything is written; signals as components.

An SSP package carries a system whose components exchange values at communication points, in the order of
Jacobi, and whose signals are lines through points. A system that is handed on without its scenario drives
itself: each signal of ramps becomes an FMU without inputs, with the unit of the input that it drives. Such an
FMU is built when it is needed; whoever calls this room hands it the function that builds.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from fmpy import read_model_description

from fmus.fmi.description import describe
from orchestration.errors import ScenarioError
from orchestration.scenarios.scenario import Scenario
from orchestration.system.experiment import Algorithm, Experiment
from orchestration.system.prepared_run import check_for
from orchestration.system.signals import Constant, Cosine, Ramps, Signal, Sines, Table
from orchestration.system.system import CheckedSystem, Port, System


def check_plain_exchange(experiment: Experiment, target: str) -> None:
    """Raises ScenarioError for all that is more than an exchange at every communication point.

    target: subject of the message, such as "an SSP package"
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


def check_scalars(variables: Iterable[Port], system: CheckedSystem, target: str) -> None:
    """Raises ScenarioError for an element of an array of FMI 3.0: importers do not find it by its name."""
    ports = list(variables)
    for name, path in system.components.items():
        if describe(path).fmiVersion == "2.0":
            continue
        declared = {v.name for v in read_model_description(str(path), validate=False).modelVariables}
        for port in (p for p in ports if p.component == name and p.variable.name not in declared):
            raise ScenarioError(
                f"{target} with {port.name}, an element of an array of FMI 3.0: expected scalars, as "
                "l1-depth build --fmi 3 --scalars writes them"
            )


def as_ramps(input_name: str, signal: Signal, experiment: Experiment) -> Ramps:
    """Returns ramps, constants and tables as ramps; ScenarioError for any other signal.

    A jump of a table becomes a ramp of one communication step, which keeps the table's
    value at every communication point of the experiment.
    """
    if isinstance(signal, Ramps):
        return signal
    if isinstance(signal, Constant):
        return Ramps([(0.0, signal.value)])
    if isinstance(signal, Table):
        vertices = [] if signal.hold else np.asarray(signal.times)
        times = np.unique([*_around(signal.jumps, experiment), *vertices])
        return Ramps(np.column_stack([times, signal.at(times)]).tolist())
    kind = {Cosine: "a cosine", Sines: "sines"}.get(type(signal), "another function of time")
    raise ScenarioError(
        f"signal {input_name}: expected ramps, a constant or a table, which a component can give; got {kind}"
    )


def _around(jumps: np.ndarray, experiment: Experiment) -> np.ndarray:
    """Returns the communication points where jumps arrive, and the points before them [s]."""
    start, step = experiment.start_time, experiment.step_size
    arrivals = np.ceil((jumps - start - experiment.time_resolution()) / step)
    return start + step * np.unique([*(arrivals - 1.0), *arrivals])


# Between the points that a signal does not use: the parameters need ascending times.
_SPARE_S = 10.0
_FEWEST_POINTS = 2


@dataclass(frozen=True)
class RampSource:
    """The source of ramps: the FMU that takes the place of a signal.

    name: of the component, and of its only output
    unit: of the output as FMI names it, "" if the driven input has none
    points: how many; parameters point_time[i] [s], point_value[i] [unit] and smooth
    driven: FMU that it drives; the source is to run on the same platforms
    starts: parameter -> start value, from the first scenario
    """

    name: str
    unit: str
    points: int
    driven: Path
    starts: Mapping[str, float | bool] = field(default_factory=dict, compare=False)

    @property
    def output(self) -> str:
        """The output, as "component.variable": the signal is recorded there."""
        return f"{self.name}.{self.name}"


BuildSource = Callable[[RampSource, Path], Path]
"""(source, folder) -> its FMU, written to that folder."""


def ramp_sources(scenarios: Sequence[Scenario]) -> dict[str, RampSource]:
    """Returns driven input -> its source, with as many points as the longest of its signals has.

    The scenarios have the same system and driven inputs. Raises ScenarioError for a signal that is no ramps.
    """
    first = scenarios[0]
    checked = check_for(first.system, first.experiment)
    sources: dict[str, RampSource] = {}
    names = set(checked.components)
    for target in first.experiment.signals:
        experiments = [scenario.experiment for scenario in scenarios]
        signals = [as_ramps(target, experiment.signals[target], experiment) for experiment in experiments]
        name = _unused_name(target, names)
        names.add(name)
        points = max(_FEWEST_POINTS, *(len(signal.points) for signal in signals))
        driven = checked.ports[target]
        fmu = checked.components[driven.component]
        source = RampSource(name, driven.variable.unit or "", points, fmu)
        starts = {n.partition(".")[2]: value for n, value in _parameters(source, signals[0]).items()}
        sources[target] = replace(source, starts=starts)
    return sources


def _unused_name(target: str, used: set[str]) -> str:
    """Returns the name of the input as an identifier, after its component's name if it is used already."""
    for name in (target.partition(".")[2], target):
        identifier = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")
        if identifier not in used:
            return identifier
    raise ScenarioError(f"signal {target}: expected no component of the name {identifier!r}")


def with_sources(
    scenario: Scenario, sources: Mapping[str, RampSource], fmus: Mapping[str, Path]
) -> tuple[System, Experiment]:
    """Returns the system and the experiment with a component for every signal, its points as parameters.

    sources, fmus: of every driven input
    """
    system, parameters = scenario.system, dict(scenario.experiment.parameters)
    for target, source in sources.items():
        parameters |= _parameters(
            source, as_ramps(target, scenario.experiment.signals[target], scenario.experiment)
        )
    components = {**system.components, **{source.name: fmus[target] for target, source in sources.items()}}
    connections = [*system.connections, *((source.output, target) for target, source in sources.items())]
    record = tuple(sources[n].output if n in sources else n for n in scenario.experiment.record)
    experiment = replace(scenario.experiment, parameters=parameters, signals={}, record=record)
    return System(components, connections), experiment


def _parameters(source: RampSource, ramps: Ramps) -> dict[str, float | bool]:
    """Returns the points as parameters; unused points come after the last one and have its value."""
    points = [(float(time), float(value)) for time, value in ramps.points]
    while len(points) < source.points:
        points.append((points[-1][0] + _SPARE_S, points[-1][1]))
    parameters: dict[str, float | bool] = {f"{source.name}.smooth": ramps.smooth}
    for i, (time, value) in enumerate(points, start=1):
        parameters |= {f"{source.name}.point_time[{i}]": time, f"{source.name}.point_value[{i}]": value}
    return parameters

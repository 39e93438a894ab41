"""The closed loop of one controller and the vehicle in the cases of a protocol: its runs and metrics.

with ClosedLoop(Controller("mine", "my.fmu"), read_protocol()) as loop:
    loop.metrics(protocol.cases["nominal"])["rmse"]
"""

import threading
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

from fmus.errors import nearest
from fmus.fmi.description import describe, of_causality
from fmus.fmi.variable_types import FmiValue
from orchestration.errors import ScenarioError, ScenarioWarning, SimulationError
from orchestration.many.job import Failure, Job, Run
from orchestration.many.local_runs import LocalRuns
from orchestration.many.run_many import Make, in_order
from orchestration.results.recording import Recording
from orchestration.scenarios import scenario
from orchestration.scenarios.changes import given_layers, values_of_settings, with_values
from orchestration.scenarios.layers import Layer, components_of, file_layers, shipped_bases, stated_values
from orchestration.scenarios.scenario import Scenario
from orchestration.scenarios.toml_file import read_toml
from orchestration.studies.score.protocol import REFERENCE, Case, Protocol, check_vehicle
from orchestration.studies.score.run_metrics import all_signals, declared, judged, metrics_of
from orchestration.studies.vehicle import DEPTH, PREFIX, built
from orchestration.system.experiment import Experiment
from orchestration.system.signal_derivatives import derivative
from orchestration.system.signals import Later, Ramps, Signal

OWN = "controller."
GAINS = Path(__file__).with_name("gains")
"""Folder of the gains that `l1-depth tune` gave the controllers of the protocol: NAME.toml."""
RATE, MEASURED_RATE = f"{OWN}measured_depth_rate", f"{PREFIX}measured_depth_rate"
_RATES = {"depth_reference_rate": 1, "depth_reference_acceleration": 2}  # input -> order of the derivative
TOLD = ("depth_reference", *_RATES, "measured_depth_rate")
"""Inputs of the depth control interface that tell of the reference and of the depth rate."""
_LOADING = threading.Lock()  # all threads share the filters of warnings


@dataclass(frozen=True)
class Controller:
    """A controller to be run.

    Parameters
    ----------
    name
        Name of its row in a score.
    fmu
        An .fmu, a block or its .py file.
    reference_rates
        Whether the derivatives of the reference are connected, where it has inputs for them.
    title
        Name in tables and figures; by default `name`.
    parameters
        Variable -> value that differs from its start value.
    mapping
        Name of the depth control interface -> variable that stands for it.
    open_inputs
        Treatment of inputs without a source: "error", or another option of a run.
    step
        Communication step [s] of its runs; 0 for the step of the protocol's base.

    Examples
    --------
    >>> Controller("mine", "L1DepthController", parameters={"augmentation": "pi"}).variable("depth_reference")
    'controller.depth_reference'
    """

    name: str
    fmu: str
    reference_rates: bool = True
    title: str = ""
    parameters: Mapping[str, FmiValue] = field(default_factory=dict)
    mapping: Mapping[str, str] = field(default_factory=dict)
    open_inputs: str = "error"
    step: float = 0.0

    def variable(self, name: str) -> str:
        """Returns "controller.variable" for a name of the depth control interface.

        Parameters
        ----------
        name : str
            Name of the interface, such as "depth_reference".

        Returns
        -------
        str
        """
        return OWN + self.mapping.get(name, name)


def built_in(protocol: Protocol, name: str) -> Controller:
    """Returns the controller that the protocol has under that name."""
    if name not in protocol.controllers:
        raise ScenarioError(f"no controller {name!r}; {nearest(name, protocol.controllers)}")
    table = protocol.controllers[name]
    parameters = {**_designed_for(protocol, table.fmu), **table.parameters}
    return Controller(name, table.fmu, table.reference_rates, table.title, parameters)


def _designed_for(protocol: Protocol, fmu: str) -> dict[str, FmiValue]:
    """Returns inertia and damping of a vehicle other than the base's, for a law that assumes them."""
    if protocol.vehicle.is_of_base:
        return {}
    known = {variable.name for variable in describe(built(fmu)).modelVariables}
    inertia, damping, _ = protocol.vehicle.values().heave
    assumed = {"model_inertia": inertia, "model_damping": damping}
    return {name: value for name, value in assumed.items() if name in known and value > 0.0}


def tuned_gains(name: str, fmu: str) -> dict[str, FmiValue]:
    """Returns variable of the controller, an FMU -> value in its unit; empty if it was not tuned."""
    if not (path := GAINS / f"{name}.toml").is_file():
        return {}
    variables = {variable.name: variable for variable in describe(built(fmu)).modelVariables}
    layers = [Layer({"components": {"controller": fmu}})]
    tables = values_of_settings(stated_values(read_toml(path)), layers, lambda _: variables)
    return {variable.removeprefix(OWN): value for variable, value in tables["parameters"].items()}


def tuned(protocol: Protocol, name: str) -> Controller:
    """Returns the controller that the protocol has under that name, with its tuned gains and their step.

    To another vehicle gains are carried by its inertia: forces are in proportion to it, for like motion.
    """
    controller, path = built_in(protocol, name), GAINS / f"{name}.toml"
    written = read_toml(path).data if path.is_file() else {}
    gains: dict[str, Any] = tuned_gains(name, controller.fmu)
    for gain in gains.keys() & protocol.controllers[name].gains.keys():
        gains[gain] *= protocol.inertia_ratio ** protocol.controllers[name].gains[gain].inertia
    step = written.get("tuning", {}).get("step", 0.0)
    return replace(controller, parameters={**controller.parameters, **gains}, step=step)


class ClosedLoopRun(NamedTuple):
    """A run of a closed loop.

    compute: computes a result of the judged signals of one run; a function of a module, or picklable
    gains: variable of the controller -> value, over those that it has
    """

    case: Case
    compute: Callable[[Recording], Any]
    gains: Mapping[str, FmiValue] = {}


class ClosedLoop(AbstractContextManager["ClosedLoop"]):
    """The closed loop of a controller and the vehicle, in any case of a protocol.

    make: makes its runs, by default in this process; timeout: of a run [s]
    """

    def __init__(
        self,
        controller: Controller,
        protocol: Protocol,
        make: Make | None = None,
        timeout: float | None = None,
    ) -> None:
        self.controller, self.protocol = controller, protocol
        self._local = LocalRuns(1)
        self.make, self.timeout = make or partial(in_order, self._local), timeout
        self._scenarios: dict[str, Scenario] = {}

    def metrics(
        self, case: Case, gains: Mapping[str, FmiValue] = {}, names: Collection[str] = ()
    ) -> dict[str, float]:
        """Returns name -> metric of one run, of all metrics or of those named.

        gains: variable of the controller -> value, over those that it has
        Raises SimulationError for a run that ends early.
        """
        compute = partial(metrics_of, metrics=declared(case, self.protocol, names))
        return self._one(ClosedLoopRun(case, compute, gains))

    def run(self, case: Case, gains: Mapping[str, FmiValue] = {}) -> Recording:
        """Returns the signals that metrics are computed of, in one run; raises what `metrics` raises."""
        return self._one(ClosedLoopRun(case, all_signals, gains))

    def _one(self, run: "ClosedLoopRun") -> Any:
        (result,) = self.results([run])
        if isinstance(result, Failure):
            raise SimulationError(result.reason, None)
        return result

    def results(self, runs: Sequence["ClosedLoopRun"]) -> Iterator[Any]:
        """Yields the computed result of each run, or a `Failure` with the reason, in the order given."""
        for system, group in groupby(runs, key=lambda run: self.scenario(run.case).system):
            made = list(self._runs(group))
            job = Job(system, made[0].experiment, self.timeout)
            yield from (done.result for done in self.make(job, made))

    def _runs(self, runs: Iterable["ClosedLoopRun"]) -> Iterator[Run]:
        """Yields the runs of many; successive runs of one case share its signals."""
        for _, group in groupby(runs, key=lambda run: (id(run.case), id(run.compute))):
            first, *others = group
            experiment = self.experiment(first.case)
            vehicle = self.protocol.vehicle
            # limits change with the run; the force is of the unchanged vehicle, as controllers receive it
            ranges = vehicle.values(experiment.parameters).actuators.ranges
            actuators = replace(vehicle.actuators, ranges=ranges)
            # metrics of runs with unlike steps compare only at the same points
            stride = max(1, round(_judged_period(self.protocol.tables.base) / experiment.step_size))
            of_signals = {"columns": tuple(experiment.record), "actuators": actuators, "stride": stride}
            reduce = partial(judged, compute=first.compute, **of_signals)
            for run in (first, *others):
                gains = {f"{OWN}{name}": value for name, value in run.gains.items()}
                yield Run(None, with_values(experiment, gains), reduce)

    def scenario(self, case: Case) -> Scenario:
        """Returns the case as a scenario with this controller, without the values and gains of a run."""
        # cases with equal layers share a scenario; a mapping cannot be a key itself
        key = repr(case.layer)
        if key not in self._scenarios:
            self._scenarios[key] = self._loaded(case)
        return self._scenarios[key]

    def _loaded(self, case: Case) -> Scenario:
        controller, vehicle = self.controller, self.protocol.vehicle
        layers = [
            *_base(shipped_bases()[self.protocol.tables.base], vehicle.inputs),
            Layer(dict(case.layer)),
        ]
        names = {"controller": controller.mapping, "plant": vehicle.mapping}
        overrides: dict[str, Any] = {
            "experiment": {"open_inputs": controller.open_inputs},
            "components": {name: {"names": dict(own)} for name, own in names.items() if own},
        }
        if controller.step:
            overrides["experiment"]["step_size"] = controller.step
        settings = {f"{OWN}{name}": value for name, value in controller.parameters.items()}
        # the case changes the vehicle that the settings give
        changed = {
            table: {vehicle.variable(name): value for name, value in case.layer.get(table, {}).items()}
            for table in ("parameters", "inputs", "signals")
        }
        driven = changed["inputs"] | changed["signals"]
        fmus = {"controller": controller.fmu, "plant": vehicle.fmu}
        named = components_of(given_layers(layers, overrides, fmus)).values()
        with _LOADING, warnings.catch_warnings():
            warnings.simplefilter("ignore", ScenarioWarning)  # of inherited parameters, left out below
            loaded = scenario.load(
                shipped_bases()[self.protocol.tables.base],
                overrides,
                layers=layers,
                settings={
                    **fmus,
                    **settings,
                    **{name: value for name, value in vehicle.settings.items() if name not in driven},
                },
                made={fmu: built(fmu) for fmu in named},
            )
        for fmu in loaded.system.components.values():
            built(str(fmu))
        check_vehicle(self.protocol)
        # the parameters that a base gives its own controller do not apply to another one
        inherited = {
            name: value
            for name, value in loaded.experiment.parameters.items()
            if not name.startswith(OWN) or name in settings or name in loaded.from_actuators
        }
        experiment = replace(loaded.experiment, parameters=inherited | changed["parameters"])
        return replace(loaded, experiment=experiment)

    def experiment(self, case: Case) -> Experiment:
        """Returns the experiment of a case with its own values."""
        loaded = self.scenario(case)
        values = {self.protocol.vehicle.variable(name): value for name, value in case.values.items()}
        experiment = with_values(loaded.experiment, values)
        inputs: dict[str, Any] = dict(experiment.inputs)
        signals = dict(experiment.signals)
        if case.trajectory:
            signals[self.controller.variable("depth_reference")] = Ramps(case.trajectory)
        changed = map(self.protocol.vehicle.variable, case.layer["signals"])
        moved = {name: Later(signals[name], case.later) for name in changed if name in signals}
        # only disturbances and faults come later: the reference is where metrics expect it
        moved.pop(self.controller.variable("depth_reference"), None)
        self._drive_rates(loaded, inputs, signals)
        faults = [replace(f, start=f.start + case.later, end=f.end + case.later) for f in experiment.faults]
        return replace(experiment, inputs=inputs, signals=signals | moved, faults=faults)

    def _drive_rates(self, loaded: Scenario, inputs: dict[str, FmiValue], signals: dict[str, Signal]) -> None:
        """Drives the rates of the reference by its derivatives, or holds them at 0."""
        reference = signals[self.controller.variable("depth_reference")]
        known = _inputs(loaded.system.components["controller"])
        for name, order in _RATES.items():
            variable = self.controller.variable(name)
            if variable.removeprefix(OWN) not in known:
                continue
            inputs.pop(variable, None)
            signals.pop(variable, None)
            if self.controller.reference_rates:
                signals[variable] = derivative(reference, order, variable)
            else:
                inputs[variable] = 0.0

    def connected(self) -> list[str]:
        """Returns the inputs for reference and rate that are connected, by names of the interface."""
        experiment = self.experiment(self.protocol.nominal)
        connections = self.scenario(self.protocol.nominal).system.connections
        driven = {*experiment.signals, *(target for _, target, *_ in connections)}
        return [name for name in TOLD if self.controller.variable(name) in driven]

    def parameters(self) -> dict[str, FmiValue]:
        """Returns the controller's own values, each of the type that its variable has."""
        given = self.scenario(self.protocol.nominal).experiment
        values: dict[str, Any] = {**given.inputs, **given.parameters}
        return {name: values[f"{OWN}{name}"] for name in self.controller.parameters}

    def __exit__(self, *error: object) -> None:
        self._local.__exit__()


@cache
def _inputs(fmu: Path) -> set[str]:
    return {v.name for v in of_causality(describe(fmu), "input")}


@cache
def _judged_period(base: str) -> float:
    """Returns the communication step [s] of a base: all runs are judged at its points, also finer ones."""
    tables = [layer.data.get("experiment", {}) for layer in file_layers(shipped_bases()[base])]
    return next((table["step_size"] for table in reversed(tables) if "step_size" in table), 0.0)


@cache
def _base(path: Path, inputs: tuple[str, ...]) -> tuple[Layer, ...]:
    """Returns the layers of a base, and one with the signals of the metrics in place of its metrics.

    No controller receives the depth rate of a vehicle that does not measure it.
    inputs: of the actuators
    """
    layers = file_layers(path)
    metrics = {name: False for layer in layers for name in layer.data.get("metrics", {})}
    interface = {"inputs": {RATE: [MEASURED_RATE, 0.0]}}
    return (
        *layers,
        Layer({"record": [REFERENCE, DEPTH, *inputs], "metrics": metrics, "interface": interface}),
    )

"""The protocol of the score: its cases, metrics and controllers, from protocol.toml."""

import math
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

from pydantic import TypeAdapter

from fmus.errors import nearest
from fmus.fmi.variable_types import FmiValue
from fmus.registry import block_names
from orchestration.errors import ScenarioError
from orchestration.results import metrics
from orchestration.scenarios.file_format import METRIC
from orchestration.scenarios.file_tables import Table, checked
from orchestration.scenarios.layers import Data, merge, shipped_bases
from orchestration.scenarios.toml_file import KeyPath, TomlFile, read_toml
from orchestration.scenarios.vehicle import SHIPPED, ChangesTable
from orchestration.studies.score.protocol_format import (
    COMPARED,
    DELAY_MARGIN,
    SIGNALS,
    ControllerTable,
    MetricTable,
    ProtocolFile,
)
from orchestration.studies.vehicle import PREFIX, Vehicle
from orchestration.sweep.distributions import Distribution

FILE = Path(__file__).with_name("protocol.toml")
REFERENCE = "controller.depth_reference"
_BAND = 0.05  # of the target: the paper's settling band
_NAMING = ("parameters", "inputs", "signals", "connections")  # tables whose keys are variables
_OF_A_SCENARIO = {*ChangesTable.model_fields, "components", "connections"}
_FILE = TypeAdapter(ProtocolFile)
_METRIC: TypeAdapter[Any] = TypeAdapter(Annotated[Table, METRIC])


@dataclass(frozen=True)
class Target:
    """A depth [m] that the reference comes to, and the window [s] from the start until it leaves.

    moves: whether it comes there from another depth
    """

    depth: float
    window: tuple[float, float]
    moves: bool = True

    @property
    def band(self) -> float:
        """Half the width [m] of the band in which the depth has settled: 5 % of the target."""
        return _BAND * self.depth


@dataclass(frozen=True)
class Case:
    """A run of the vehicle: what differs from the base scenario, and what of it is judged.

    layer: as a scenario file gives it; values: parameters and constant inputs laid over it
    trajectory: [time, depth] of the reference, over the trajectory of the layer; judged: [start, end] in s
    seed_variable: "plant.variable" of the seed of the sensor's noise, "" if the vehicle has none
    later: how much later [s] its signals and faults come than the layer gives them, of at most latest
    """

    name: str
    title: str
    layer: Mapping[str, Any]
    target: Target
    judged: tuple[float, float]
    tuned_on: bool = False
    repeats_nominal: bool = False
    values: Mapping[str, FmiValue] = field(default_factory=dict)
    trajectory: Sequence[Sequence[float]] = ()
    seed_variable: str = ""
    latest: float = 0.0
    later: float = 0.0

    def with_seed(self, seed: int) -> "Case":
        """Returns the case with another seed of the sensor's noise."""
        seeds = {self.seed_variable: seed} if self.seed_variable else {}
        return replace(self, values={**self.values, **seeds})


@dataclass(frozen=True)
class Protocol:
    """A protocol file, read and checked, and the vehicle that its cases are run on."""

    file: TomlFile
    tables: ProtocolFile
    vehicle: Vehicle

    @property
    def version(self) -> str:
        return self.tables.version

    @property
    def statement(self) -> str:
        vehicle, ours = self.vehicle, Vehicle.of_base(self.tables.base).name
        if vehicle.is_of_base:
            return self.tables.statement.strip()
        force = vehicle.actuators.largest_force
        told = f" Controllers know that its actuators give {force:g} N." if math.isfinite(force) else ""
        inertia = vehicle.values().heave[0]
        beside = (
            f"the gains beside are tuned for {ours} and scaled to the inertia of this vehicle, "
            f"{inertia:.3g} kg"
            if inertia
            else f"the tuned controllers of {ours} are left out: inertia under [variables] in "
            f"{vehicle.file.path.name} would scale their gains"
        )
        return f"The vehicle is {vehicle.name}, simulated; {beside}.{told}"

    @cached_property
    def scales_gains(self) -> bool:
        """Whether the tuned gains mean something for the vehicle: its inertia is known."""
        return self.vehicle.is_of_base or self.vehicle.values().heave[0] > 0.0

    @cached_property
    def inertia_ratio(self) -> float:
        """The inertia relative to the vehicle of the base; 1 if the description names no inertia."""
        inertia, ours = (v.values().heave[0] for v in (self.vehicle, Vehicle.of_base(self.tables.base)))
        return inertia / ours if inertia and ours else 1.0

    @property
    def metrics(self) -> Mapping[str, MetricTable]:
        return self.tables.metrics

    @property
    def controllers(self) -> Mapping[str, ControllerTable]:
        return self.tables.controllers

    @cached_property
    def cases(self) -> dict[str, Case]:
        """The cases of the table that can run on the vehicle, by name, at the first practice seed."""
        return {name: self._case(name) for name in self.tables.cases if name not in self.left_out}

    @cached_property
    def left_out(self) -> dict[str, str]:
        """The cases that cannot run on the vehicle, by name -> why."""
        return {name: reason for name in self.tables.cases if (reason := self._lacking(name))}

    def _lacking(self, name: str) -> str:
        """Returns what a case asks for that the vehicle lacks, "" if it lacks nothing."""
        table, vehicle = self.tables.cases[name], self.vehicle
        if table.disturbance and table.disturbance not in vehicle.described.disturbances:
            file = vehicle.file.path
            expected = "" if file.parent == SHIPPED else f": expected each in {file.name} beside it"
            asked = [case.disturbance for case in self.tables.cases.values() if case.disturbance]
            missing = [name for name in asked if name not in vehicle.described.disturbances]
            return f"{vehicle.name} has no disturbance {', '.join(dict.fromkeys(missing))}{expected}"
        # a name that the base's vehicle lacks is a mistake, which `check_vehicle` refuses
        if vehicle.is_of_base:
            return ""
        layer = self._layer(name)
        named = [n for part in _NAMING for n in layer.get(part, {})]
        lacking = [n for n in named if n.startswith(PREFIX) and not vehicle.has(n)]
        return f"{vehicle.name} lacks {', '.join(lacking)}" if lacking else ""

    @property
    def nominal(self) -> Case:
        """The case of the paper: the first."""
        return next(iter(self.cases.values()))

    def _layer(self, name: str) -> Data:
        """Returns what a case changes, its disturbance below it."""
        table, disturbances = self.tables.cases[name], self.vehicle.file.data.get("disturbances", {})
        changes = merge(disturbances.get(table.disturbance, {}), self.file.data["cases"][name])
        layer = {key: value for key, value in changes.items() if key in _OF_A_SCENARIO}
        if table.hold:
            layer["parameters"] = {self.vehicle.start_depth: table.hold, **layer.get("parameters", {})}
        return layer

    def _case(self, name: str) -> Case:
        table, described = self.tables.cases[name], self.vehicle.described
        points = self.tables.trajectory
        stop = table.stop_time or points[-1][0]
        layer = self._layer(name)
        reference = {"kind": "ramps", "smooth": False, "points": points}
        if table.hold:
            reference = {"kind": "constant", "value": table.hold}
        layer["signals"] = {REFERENCE: reference, **layer.get("signals", {})}
        layer["experiment"] = {"stop_time": stop}
        start, end = table.judged or (0.0, stop)
        target = Target(table.hold, (start, end), moves=False) if table.hold else first_target(points)
        disturbance = described.disturbances.get(table.disturbance)
        title = (disturbance.title if disturbance else "") or table.title
        seed = PREFIX + described.variables.noise_seed
        seed = seed if self.vehicle.is_of_base or self.vehicle.has(seed) else ""
        case = Case(
            name,
            title,
            layer,
            target,
            (start, end),
            table.tuned_on,
            table.repeats_nominal,
            seed_variable=seed,
            latest=table.latest,
        )
        return case.with_seed(self.tables.practice_seeds[0])

    @property
    def vary(self) -> Mapping[str, Any]:
        """The draws of a plant, name -> variables and distribution: the protocol's, or the vehicle's."""
        return self.tables.plants.vary or self.vehicle.vary

    def law(self, name: str) -> Distribution:
        """Returns the distribution of a draw, in the unit of its variables."""
        if self.vary[name].unit:
            check_vehicle(self)
        return self.vehicle.law(name, self.vary[name], self.at_draw(name, "unit"))

    def at_draw(self, name: str, key: str) -> str:
        """Returns the file and the line of a key of a draw."""
        keys = "vary", name, key
        return self.file.at(("plants", *keys)) if self.tables.plants.vary else self.vehicle.file.at(keys)


def metric_of(table: MetricTable, case: Case) -> dict[str, Any]:
    """Returns a metric of a case as a scenario declares it."""
    call: dict[str, Any] = {"function": table.function, **table.arguments}
    if table.at_target:
        call |= {"target": case.target.depth, "window": list(case.target.window)}
        if table.function == "settling_time":
            call["band"] = case.target.band
    elif not table.whole_run:
        call["window"] = list(case.judged)
    return call


def first_target(points: Iterable[Sequence[float]]) -> Target:
    """Returns the first depth that a trajectory holds; ScenarioError if it holds none."""
    listed = list(points)
    for (_, before), (until, after) in pairwise(listed):
        if before == after:
            return Target(after, (listed[0][0], until))
    raise ScenarioError(f"trajectory {listed}: expected two points in a row of one depth")


def read_protocol(path: Path = FILE, vehicle: Vehicle | None = None) -> Protocol:
    """Returns the protocol of a file, by default the one that ships; ScenarioError names file and line.

    vehicle: in place of the vehicle of its base
    """
    return _protocol_of(read_toml(path), vehicle)


def with_cost(protocol: Protocol, cost: Mapping[str, Any]) -> Protocol:
    """Returns the protocol with entries of its cost, bounds beside its own; ScenarioError for a mistake."""
    data = protocol.file.data
    bounds = {**data["cost"].get("bounds", {}), **cost.get("bounds", {})}
    changed = {**data, "cost": {**data["cost"], **cost, "bounds": bounds}}
    return _protocol_of(replace(protocol.file, data=changed), protocol.vehicle)


def on_vehicle(protocol: Protocol) -> Protocol:
    """Returns the protocol with the bound on the total variation carried to its vehicle, as gains are.

    Forces are in proportion to the inertia; where that is not known, nothing bounds them.
    """
    bounds = dict(protocol.tables.cost.bounds)
    if "total_variation" not in bounds or protocol.vehicle.is_of_base:
        return protocol
    ratio = protocol.inertia_ratio if protocol.scales_gains else math.inf
    largest = min(ratio * bounds["total_variation"], sys.float_info.max)
    return with_cost(protocol, {"bounds": {"total_variation": largest}})


def _protocol_of(file: TomlFile, vehicle: Vehicle | None) -> Protocol:
    tables = checked(_FILE, file.data, file.at)
    _check_name(file, ("base",), tables.base, shipped_bases())
    ours = Vehicle.of_base(tables.base)
    protocol = Protocol(file, tables, vehicle or ours)
    for keys, name, known in _names(protocol.tables, ours):
        _check_name(file, keys, name, known)
    for name in (name for name in COMPARED if name not in protocol.metrics):
        raise ScenarioError(f"{file.at(('metrics',))}: metrics.{name} is missing: tables show it")
    for name, table in protocol.metrics.items():
        keys = ("metrics", name, "arguments")
        checked(_METRIC, metric_of(table, protocol.nominal), lambda key, keys=keys: file.at((*keys, *key)))
    return protocol


def _check_name(file: TomlFile, keys: KeyPath, name: str, known: Collection[str]) -> None:
    if name not in known:
        shown = ".".join(map(str, keys))
        raise ScenarioError(f"{file.at(keys)}: {shown} = {name!r}; {nearest(name, known)}")


def check_vehicle(protocol: Protocol) -> None:
    """Refuses a case, a disturbance or a plant that names a variable which the vehicle does not have.

    Such a case is left out instead if the vehicle is not the vehicle of the base.
    """
    vehicle, tables = protocol.vehicle, protocol.tables
    changes: list[tuple[TomlFile, KeyPath, ChangesTable]] = [
        (vehicle.file, ("disturbances", name), table)
        for name, table in vehicle.described.disturbances.items()
    ]
    if vehicle.is_of_base:
        changes += [(protocol.file, ("cases", case), table) for case, table in tables.cases.items()]
    names = [
        (file.at((*keys, part, name)), name)
        for file, keys, table in changes
        for part in _NAMING
        for name in getattr(table, part, {})
    ]
    names += [
        (protocol.at_draw(n, "variables"), name) for n, x in protocol.vary.items() for name in x.variables
    ]
    vehicle.check_names(names)


def _names(tables: ProtocolFile, ours: Vehicle) -> Iterator[tuple[KeyPath, str, Collection[str]]]:
    """Yields keys, the name that stands there, and the names that may."""
    for name, case in tables.cases.items():
        if case.disturbance:
            yield ("cases", name, "disturbance"), case.disturbance, ours.described.disturbances
    for name, table in tables.metrics.items():
        yield ("metrics", name, "function"), table.function, metrics.FUNCTIONS
        for argument in sorted(table.arguments.keys() & metrics.SIGNALS):
            yield ("metrics", name, "arguments", argument), table.arguments[argument], SIGNALS
    for name in tables.failure:
        yield ("failure", name), name, tables.metrics
    for name in tables.cost.cases:
        yield ("cost", "cases"), name, tables.cases
    yield ("cost", "metric"), tables.cost.metric, tables.metrics
    for name in tables.cost.bounds:
        yield ("cost", "bounds", name), name, [*tables.metrics, DELAY_MARGIN]
    blocks = block_names()
    for name, controller in tables.controllers.items():
        yield ("controllers", name, "fmu"), controller.fmu, blocks

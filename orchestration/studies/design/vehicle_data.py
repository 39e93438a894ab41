"""The data of a vehicle that a design starts from: start values of its FMU, and the ranges that it states.

A range is an entry of [vary.*] in the description of the vehicle: `score --full` draws from it. A parameter
without a range is known: its start value, or the value of `--set plant.NAME`.
"""

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fmus.fmi.variable_types import FmiValue
from orchestration.errors import ScenarioError
from orchestration.scenarios.actuators import Actuators
from orchestration.studies.vehicle import PREFIX, Vehicle
from orchestration.sweep.distributions import Distribution

Range = tuple[float, float]
"""Lowest and highest value."""
Draws = Mapping[tuple[str, ...], Distribution]
"""Variables, "plant.NAME" -> the distribution of their common value."""
_REQUIRED = ("inertia", "net_weight", "sensor_period")  # of [variables]; what others lack is 0
# for a vehicle with a force as input: the volts are then a scale inside the controller
_VOLTS = 12.0
# of the thrust, at most: the rest moves the vehicle
_SHARE_FOR_TRIM = 0.9


@dataclass(frozen=True)
class VehicleData:
    """The data of a vehicle.

    inertia [kg], damping [N.s/m], drag [N.s2/m2], net_weight [N]: ranges
    gain: range of the thrust, relative to the start values; actuators: the data that a controller receives
    lag, delay, period [s]: of thrusters, sensor, and its sampling: the longest; noise [m]: with rounding
    """

    name: str
    inertia: Range
    damping: Range
    drag: Range
    net_weight: Range
    gain: Range
    actuators: Actuators
    lag: float
    delay: float
    period: float
    noise: float

    @property
    def force_limit(self) -> float:
        """The largest force [N] of the thrusters in their weaker direction."""
        return self.actuators.largest_force

    @property
    def voltage_limit(self) -> float:
        """The largest voltage [V] that a controller assumes."""
        return self.actuators.limit if self.actuators.in_volts else _VOLTS

    @property
    def largest_weight(self) -> float:
        """The largest size [N] of the net weight."""
        return max(map(abs, self.net_weight))

    @property
    def assumed(self) -> Range:
        """The inertia [kg] and the linear damping [N.s/m] that a design assumes.

        The inertia puts the box of the input gain, M gain / inertia, about 1.
        """
        low, high = self.gain[0] / self.inertia[1], self.gain[1] / self.inertia[0]
        return 2.0 / (low + high), 0.5 * sum(self.damping)

    def check(self) -> None:
        """Refuses a vehicle whose thrusters cannot hold it, or that has data without a meaning."""
        for name, low in (("inertia", self.inertia[0]), ("thrust", self.gain[0]), ("period", self.period)):
            if not low > 0.0:
                raise ScenarioError(f"{self.name}: the {name} comes down to {low:g}: expected more than 0")
        holds = _SHARE_FOR_TRIM * self.force_limit * self.gain[0]
        if self.largest_weight > holds:
            raise ScenarioError(
                f"{self.name}: the net weight comes to {self.largest_weight:.4g} N, and the thrusters give "
                f"{self.force_limit * self.gain[0]:.4g} N where their gain is lowest: expected at most "
                f"{100 * _SHARE_FOR_TRIM:g} % of that; narrow [vary.*], trim the vehicle or take others"
            )


def draws_of(vehicle: Vehicle) -> Draws:
    """Returns the draws in the description of a vehicle; ScenarioError for a draw without an end."""
    at = vehicle.file.at
    vehicle.check_names(
        (at(("vary", name, "variables")), v) for name, entry in vehicle.vary.items() for v in entry.variables
    )
    draws = dict[tuple[str, ...], Distribution]()
    for name, entry in vehicle.vary.items():
        distribution = vehicle.law(name, entry, at(("vary", name, "unit")))
        if not all(map(math.isfinite, distribution.reach)):
            raise ScenarioError(
                f"{vehicle.file.at(('vary', name))}: vary.{name} has no end: expected low and high"
            )
        draws[tuple(entry.variables)] = distribution
    return draws


def corners(vehicle: Vehicle, draws: Draws) -> list[dict[str, FmiValue]]:
    """Returns the values of every corner of the ranges; a seed of noise has none."""
    seed = PREFIX + vehicle.described.variables.noise_seed
    ranged = {names: distribution.reach for names, distribution in draws.items() if seed not in names}
    return [_values(ranged, ends) for ends in itertools.product(*ranged.values())]


def drawn(draws: Draws, seed: int, count: int) -> Iterator[dict[str, FmiValue]]:
    """Yields the values of so many draws within the ranges; number i depends on seed and i alone."""
    for i in range(count):
        random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,)))
        yield _values(draws, [one.quantile([random.random()])[0] for one in draws.values()])


def _values(names: Iterable[tuple[str, ...]], values: Sequence[FmiValue]) -> dict[str, FmiValue]:
    return {name: value for group, value in zip(names, values, strict=True) for name in group}


def overruled(vehicle: Vehicle, draws: Draws) -> Iterator[str]:
    """Yields a message about each value that is set and has a range, which the design takes in its place."""
    for names, distribution in draws.items():
        low, high = distribution.reach
        for name in (name for name in names if name in vehicle.settings):
            yield (
                f"{name} = {vehicle.settings[name]} acts in the first run alone: the design takes the range "
                f"{low:g} to {high:g} in [vary.*] of {vehicle.file.path}"
            )


def data_of(vehicle: Vehicle, draws: Draws) -> VehicleData:
    """Returns the data of a vehicle; ScenarioError names missing data, and where to write them."""
    _check_described(vehicle)
    reach = {name: one.reach for names, one in draws.items() for name in names}
    low, high = (vehicle.values({name: ends[end] for name, ends in reach.items()}) for end in (0, 1))

    def ends_of(key: str) -> Range:
        return sum(low.values(key)), sum(high.values(key))

    weight, buoyancy = ends_of("net_weight"), [x.interface("buoyancy_change", 0.0) for x in (low, high)]
    inertia, damping, drag = zip(low.heave, high.heave, strict=True)
    nominal, lowest, highest = (sum(x.gains) for x in (vehicle.values(), low, high))
    data = VehicleData(
        name=vehicle.name,
        inertia=inertia,
        damping=damping,
        drag=drag,
        net_weight=(weight[0] - buoyancy[1], weight[1] - buoyancy[0]),
        gain=(lowest / nominal, highest / nominal),
        actuators=vehicle.actuators,
        lag=max(high.lags, default=0.0),
        delay=ends_of("sensor_delay")[1],
        period=ends_of("sensor_period")[1],
        # rounding to a multiple of the resolution: uniform within half of it, Widrow
        noise=math.hypot(ends_of("sensor_noise")[1], ends_of("sensor_resolution")[1] / math.sqrt(12.0)),
    )
    data.check()
    return data


def _check_described(vehicle: Vehicle) -> None:
    """Refuses a vehicle whose description lacks a name without which nothing is designed."""
    missing = [name for name in _REQUIRED if not getattr(vehicle.described.variables, name)]
    missing += [] if all(map(math.isfinite, vehicle.actuators.gains)) else ["gain"]
    if missing:
        names = ", ".join(['"NAME"'] * len(vehicle.inputs))
        gain = f'gain = [{names}] (or table = ["VOLTAGES", "FORCES"] where the force is no line)'
        entries = ", ".join(gain if n == "gain" else f'{n} = "NAME"' for n in missing)
        parameters = [name for name, v in vehicle.variables.items() if v.causality == "parameter"]
        raise ScenarioError(
            f"{vehicle.name}: its {' and '.join(missing)} {'is' if len(missing) == 1 else 'are'} not known: "
            f"expected {entries} in [variables] of {vehicle.file.path}; its parameters are "
            f"{', '.join(parameters) or '(none)'}"
        )
    if not math.isfinite(vehicle.actuators.limit):
        raise ScenarioError(
            f"{vehicle.name}: the range of {' and '.join(vehicle.inputs)} is not known: expected min and max "
            f"of the input in the FMU, or limit = [...] in [variables] of {vehicle.file.path}"
        )

"""The data of a vehicle that a design starts from: start values of its FMU, and the ranges that it states.

A range is an entry of [vary.*] in the description of the vehicle: what `score --full` draws. What has none
is known: its start value, or that of `--set plant.NAME`.
"""

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from fmus.errors import nearest
from fmus.fmi.description import start_value
from fmus.fmi.variable_types import FmiValue
from orchestration.errors import ScenarioError
from orchestration.score.protocol import check_vehicle, distribution_of, read_protocol
from orchestration.score.vehicle import PLANT, Vehicle
from orchestration.sweep.distributions import Distribution

Range = tuple[float, float]
"""Lowest and highest value."""
Draws = Mapping[tuple[str, ...], Distribution]
"""Variables, "plant.NAME" -> the distribution of their common value."""
_REQUIRED = ("inertia", "net_weight", "sensor_period")  # of [variables]; what others lack is 0
_VOLTS = 12.0  # for a vehicle that takes a force: the controller's volts are then a matter of its own
_SHARE_FOR_TRIM = 0.9  # of the thrust, at most: what is left moves the vehicle


@dataclass(frozen=True)
class ForceTable:
    """A table of the force, which controllers invert: voltages [V], forces [N], factor of each thruster."""

    voltages: tuple[float, ...]
    forces: tuple[float, ...]
    scale: Range

    def least_gain(self, limit: float) -> float:
        """Returns the force [N] at the largest voltage, in the weaker direction, over that voltage."""
        ends = np.interp([-limit, limit], self.voltages, self.forces)
        return float(np.abs(ends).min()) / limit


@dataclass(frozen=True)
class VehicleData:
    """The data of a vehicle.

    inertia [kg], damping [N.s/m], drag [N.s2/m2], net_weight [N]: ranges
    gain: range of the thrust over that of the start values; force_limit [N]: the least of the thrusters
    thruster_gain [N/V], voltage_limit [V], table: what a controller with voltages assumes
    lag, delay, period [s]: of thrusters, sensor, and its sampling: the longest; noise [m]: with rounding
    """

    name: str
    inertia: Range
    damping: Range
    drag: Range
    net_weight: Range
    gain: Range
    force_limit: float
    thruster_gain: Range
    voltage_limit: float
    lag: float
    delay: float
    period: float
    noise: float
    table: ForceTable | None = None

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
    """Returns what the description of a vehicle varies; ScenarioError for a draw without an end."""
    protocol = read_protocol(vehicle=vehicle)
    check_vehicle(protocol)
    draws = dict[tuple[str, ...], Distribution]()
    for name, entry in protocol.vary.items():
        distribution = distribution_of(entry)
        if not all(map(math.isfinite, distribution.reach)):
            raise ScenarioError(
                f"{vehicle.file.at(('vary', name))}: vary.{name} has no end: expected low and high"
            )
        draws[tuple(entry.variables)] = distribution
    return draws


def corners(vehicle: Vehicle, draws: Draws) -> list[dict[str, FmiValue]]:
    """Returns the values of every corner of the ranges; a seed of noise has none."""
    seed = PLANT + vehicle.described.variables.noise_seed
    ranged = {names: distribution.reach for names, distribution in draws.items() if seed not in names}
    return [_values(ranged, ends) for ends in itertools.product(*ranged.values())]


def drawn(draws: Draws, seed: int, count: int) -> Iterator[dict[str, FmiValue]]:
    """Yields the values of so many draws within the ranges; number i depends on seed and i alone."""
    for i in range(count):
        random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,)))
        yield _values(draws, [one.quantile([random.random()])[0] for one in draws.values()])


def _values(names: Iterable[tuple[str, ...]], values: Sequence[FmiValue]) -> dict[str, FmiValue]:
    return {name: value for group, value in zip(names, values, strict=True) for name in group}


def data_of(vehicle: Vehicle, draws: Draws) -> VehicleData:
    """Returns the data of a vehicle; ScenarioError names what is missing, and where to write it."""
    read = _Reader(vehicle, draws)
    read.check_described()
    names = vehicle.described.variables
    buoyancy = read.drawn("buoyancy_change", 0.0)
    weight = read.named(names.net_weight)
    resolution = read.named(names.sensor_resolution)[1]
    gains, limits = read.thrusters()
    data = VehicleData(
        name=vehicle.name,
        inertia=read.named(names.inertia),
        damping=read.named(names.damping),
        drag=read.named(names.drag),
        net_weight=(weight[0] - buoyancy[1], weight[1] - buoyancy[0]),
        gain=read.relative_gain(),
        force_limit=sum(gain * limit for gain, limit in zip(gains, limits, strict=True)),
        thruster_gain=(gains[0], gains[-1]),
        voltage_limit=min(limits),
        lag=read.lag(),
        delay=read.named(names.sensor_delay)[1],
        period=read.named(names.sensor_period)[1],
        # rounding to a multiple of the resolution: uniform within half of it, Widrow
        noise=math.hypot(read.named(names.sensor_noise)[1], resolution / math.sqrt(12.0)),
        table=read.table,
    )
    data.check()
    return data


class _Reader:
    """The values and ranges of a vehicle, by its own names or by those of its description."""

    def __init__(self, vehicle: Vehicle, draws: Draws) -> None:
        self._vehicle = vehicle
        self._ranges = {name: one.reach for names, one in draws.items() for name in names}

    def value(self, name: str) -> float:
        """Returns the value [its unit] of a variable of the vehicle."""
        variables = self._vehicle.variables
        if name not in variables:
            at = self._vehicle.file.at(("variables",))
            raise ScenarioError(f"{at}: no variable {name!r}; {nearest(name, variables)}")
        given: Any = self._vehicle.settings.get(PLANT + name, start_value(variables[name]))
        try:
            return float(given.value("Real") if hasattr(given, "value") else given)
        except (TypeError, ValueError):
            raise ScenarioError(f"{PLANT}{name} = {given!r}: expected a number") from None

    def drawn(self, name: str, otherwise: float) -> Range:
        """Returns the range of an input by its name in the interface."""
        return self._ranges.get(PLANT + name, (otherwise, otherwise))

    def named(self, name: str) -> Range:
        """Returns the range of a variable, its value at both ends without one; 0 where there is no name."""
        if not name:
            return 0.0, 0.0
        if PLANT + name in self._ranges:
            return self._ranges[PLANT + name]
        return self.value(name), self.value(name)

    def check_described(self) -> None:
        """Refuses a vehicle whose description lacks a name without which nothing is designed."""
        vehicle = self._vehicle
        missing = [name for name in _REQUIRED if not getattr(vehicle.described.variables, name)]
        if not vehicle.takes_force and not self.table and not vehicle.described.variables.gain:
            missing.append("gain")
        if not missing:
            return
        entries = ", ".join('gain = ["NAME", "NAME"]' if n == "gain" else f'{n} = "NAME"' for n in missing)
        parameters = [name for name, v in vehicle.variables.items() if v.causality == "parameter"]
        raise ScenarioError(
            f"{vehicle.name}: its {' and '.join(missing)} {'is' if len(missing) == 1 else 'are'} not known: "
            f"expected {entries} in [variables] of {vehicle.file.path}; its parameters are "
            f"{', '.join(parameters) or '(none)'}"
        )

    def thrusters(self) -> tuple[Sequence[float], Sequence[float]]:
        """Returns the gain [N/V] and the limit [V] of each thruster as a controller with volts assumes it."""
        vehicle = self._vehicle
        limits = vehicle.limits(vehicle.settings)
        if not all(map(math.isfinite, limits)):
            names = " and ".join(vehicle.actuators)
            raise ScenarioError(
                f"{vehicle.name}: the range of {names} is not known: expected min and max of the input in "
                f"the FMU, or limit = [...] in [variables] of {vehicle.file.path}"
            )
        if vehicle.takes_force:
            share = 0.5 * limits[0] / _VOLTS
            return (share, share), (_VOLTS, _VOLTS)
        if self.table:
            pairs = zip(self.table.scale, limits, strict=True)
            return [scale * self.table.least_gain(limit) for scale, limit in pairs], limits
        return [self.value(name) for name in vehicle.described.variables.gain], limits

    @cached_property
    def table(self) -> ForceTable | None:
        """The table of the thrusters' force; None where the vehicle has a gain or takes a force."""
        names = self._vehicle.described.variables
        if not names.table or (names.tabulated and not self.value(names.tabulated)):
            return None
        voltages, forces = (self._array(name) for name in names.table)
        first, *others = [self.value(name) for name in names.table_scale] or [1.0]
        return ForceTable(voltages, forces, (first, others[-1] if others else first))

    def _array(self, name: str) -> tuple[float, ...]:
        indexed = [n for n in self._vehicle.variables if n.partition("[")[0] == name]
        return tuple(self.value(n) for n in indexed) or (self.value(name),)

    def lag(self) -> float:
        """Returns the longest lag [s] of the thrusters; a transfer function counts by its first moment."""
        names = self._vehicle.described.variables
        if names.no_lag and self.value(names.no_lag):
            return 0.0
        lag = max((self.named(name)[1] for name in names.lag), default=0.0)
        return lag + names.transfer_lag(self.value)

    def relative_gain(self) -> Range:
        """Returns the range of the sum of the thrusters' gains over its start value."""
        described = self._vehicle.described.variables
        names = described.table_scale if self.table else described.gain
        if self._vehicle.takes_force or not names:
            return 1.0, 1.0
        nominal = sum(self.value(name) for name in names)
        low, high = (sum(self.named(name)[end] for name in names) / nominal for end in (0, 1))
        return low, high

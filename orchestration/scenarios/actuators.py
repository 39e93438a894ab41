"""The actuators of a vehicle: their inputs, ranges and force.

All other code uses this one description: a scenario gives it to controllers as parameters, the score computes
the force by it, margins and design start from it.
"""

import math
from dataclasses import dataclass

import numpy as np

VOLTAGES, FORCE = ("voltage[1]", "voltage[2]"), "control_force"
"""Inputs by which a vehicle is moved: two voltages, or one force."""

# Of a limit: an allocation that inverts a force may round to slightly below it.
_AT_LIMIT = 1.0 - 1e-12


@dataclass(frozen=True)
class ForceTable:
    """Table of a thruster's force, linear between its points and held outside.

    voltages [V]: ascending; forces [N]: at them
    """

    voltages: tuple[float, ...]
    forces: tuple[float, ...]

    def force(self, voltage: np.ndarray) -> np.ndarray:
        """Returns the force [N] at voltages [V] of any shape."""
        return np.interp(voltage, self.voltages, self.forces)

    def with_points(self, count: int) -> "ForceTable":
        """Returns the same table with so many points, at least its own: further ones lie on its lines."""
        voltages = list(self.voltages)
        while len(voltages) < count:
            widest = int(np.argmax(np.diff(voltages)))
            voltages.insert(widest + 1, 0.5 * (voltages[widest] + voltages[widest + 1]))
        return ForceTable(tuple(voltages), tuple(self.force(np.array(voltages)).tolist()))


@dataclass(frozen=True)
class Actuators:
    """The actuators of a vehicle: thrusters that take voltages, or one force.

    inputs: their names in the vehicle's interface
    gains: force [N] of each for a unit, or factor of the table's force; not a number if none is stated
    ranges: lowest and highest value that each takes; infinite if none is stated
    """

    inputs: tuple[str, ...]
    gains: tuple[float, ...]
    ranges: tuple[tuple[float, float], ...]
    table: ForceTable | None = None

    @property
    def in_volts(self) -> bool:
        """Whether they take voltages, not a force."""
        return self.inputs != (FORCE,)

    @property
    def limit(self) -> float:
        """The largest size that all of them take in both directions."""
        return min((abs(end) for ends in self.ranges for end in ends if end), default=math.inf)

    @property
    def lines(self) -> tuple[float, ...]:
        """Force [N] of each for a unit; of a table that at the limit, in its weaker direction, over it."""
        if self.table is None:
            return self.gains
        weakest = float(np.abs(self.table.force(np.array([-self.limit, self.limit]))).min())
        return tuple(gain * weakest / self.limit for gain in self.gains)

    @property
    def largest_force(self) -> float:
        """The largest force [N] that all of them together give in both directions."""
        return sum(self.lines) * self.limit

    def delivered(self, given: np.ndarray) -> np.ndarray:
        """Returns what they take of given values, shape (n, actuators)."""
        lowest, highest = np.transpose(self.ranges)
        return np.clip(given, lowest, highest)

    def is_saturated(self, given: np.ndarray) -> np.ndarray:
        """Returns whether one of them is given a limit or more; shape (n,). An end of 0 is rest, no limit."""
        lowest, highest = np.transpose(self.ranges) * _AT_LIMIT
        return (((given >= highest) & (highest > 0.0)) | ((given <= lowest) & (lowest < 0.0))).any(axis=1)

    def force(self, delivered: np.ndarray) -> np.ndarray:
        """Returns the force [N] of all at values that they take, without lag; shape (n,)."""
        return (self.table.force(delivered) if self.table else delivered) @ np.array(self.gains)

    def parameters(self, voltage_limit: float, points: int = 0) -> dict[str, float]:
        """Returns the parameters of a controller that follow, by the names of the depth control interface.

        voltage_limit: its own [V]; there two thrusters give the largest force of a vehicle without voltages
        points: of its table; 0 for a controller without a table, which takes a line for each thruster
        One thruster becomes two of half its gain.
        """
        values: dict[str, float] = {"voltage_limit": self.limit} if self.in_volts else {}
        if self.table and points:
            table = self.table.with_points(points)
            arrays = {"scale": self.gains, "table_voltage": table.voltages, "table_force": table.forces}
            values |= {"thruster_tabulated": True}
        else:
            arrays = {"gain": self.lines if self.in_volts else (self.largest_force / voltage_limit,)}
        # the controllers have two thrusters, and give each half of the force
        if len(self.inputs) == 1:
            arrays |= {name: (0.5 * arrays[name][0],) * 2 for name in ("gain", "scale") if name in arrays}
        values |= {f"thruster_{n}[{i}]": x for n, xs in arrays.items() for i, x in enumerate(xs, 1)}
        values |= {"force_limit": self.largest_force}
        return {name: value for name, value in values.items() if math.isfinite(value)}

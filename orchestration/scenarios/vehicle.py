"""The description of a vehicle: what is asked of it by names that its FMU does not have.

It stands beside an FMU or a Python file as NAME.vehicle.toml. Those of blocks that ship are in `vehicles/`.

[variables]                      # name of the vehicle's interface -> variable of this vehicle
start_depth = "z0"

[disturbances.heavy]             # named by cases of the score: entries as in a scenario
parameters = { "plant.mass" = 14.0 }

[vary.mass]                      # drawn by score --full: variables and their distribution, as in a protocol
variables = ["plant.mass"]
distribution = "uniform"
low = 12.0
high = 15.0
"""
# ruff: noqa: RUF012  (Pydantic copies defaults)

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import TypeAdapter

from fmus.errors import nearest
from fmus.fmi.description import start_value
from fmus.fmi.model_description import ScalarVariable
from orchestration.errors import ScenarioError
from orchestration.scenarios.file_format import FAULT, SIGNAL
from orchestration.scenarios.file_tables import Table, Value, checked
from orchestration.scenarios.toml_file import TomlFile, read_toml
from orchestration.system.system import Port
from orchestration.system.values import value_range

PLANT = "plant"
"""The component that a vehicle is."""
SHIPPED = Path(__file__).with_name("vehicles")


class VariablesTable(Table):
    """Variables of a vehicle, by what they are; "" or none: the vehicle has no such variable."""

    start_depth: str = "initial_depth"
    """Parameter: depth at the start [m]."""
    noise_seed: str = "sensor_seed"
    """Parameter: seed of the sensor's noise."""
    gain: list[str] = []
    """Parameters: force [N] for a volt of each thruster."""
    limit: list[str] = []
    """Parameters: largest voltage [V] of each thruster; by default the range of the input."""
    inertia: str = ""
    """Parameter: mass with added mass [kg]."""
    damping: str = ""
    """Parameter: linear damping [N.s/m]."""
    drag: str = ""
    """Parameter: quadratic damping [N.s2/m2]."""
    lag: list[str] = []
    """Parameters: time constant [s] of each thruster."""
    no_lag: str = ""
    """Parameter: whether the thrusters have no lag."""
    tabulated: str = ""
    """Parameter: whether a table gives the force of the thrusters, in place of the gain."""
    table: list[str] = []
    """Parameters without an index: voltages [V] of the table, ascending, and the forces [N] at them."""
    table_scale: list[str] = []
    """Parameters: factor of the table's force for each thruster."""
    transfer: list[str] = []
    """Parameters: b_1, a_2, a_1 and a_0 of (b_1 s + a_0) / (s^3 + a_2 s^2 + a_1 s + a_0) behind the force."""
    net_weight: str = ""
    """Parameter: weight minus buoyancy of the submerged vehicle [N]."""
    sensor_period: str = ""
    """Parameter: sampling period of the depth sensor [s]."""
    sensor_noise: str = ""
    """Parameter: standard deviation of the sensor's noise [m]."""
    sensor_resolution: str = ""
    """Parameter: resolution of the sensor [m]."""
    sensor_delay: str = ""
    """Parameter: time from a sample to its report [s]."""

    def transfer_lag(self, value: Callable[[str], float]) -> float:
        """Returns the lag [s] of the first moment of the transfer function, 0 without one.

        value: gives the value of a parameter
        """
        if not self.transfer:
            return 0.0
        b_1, _, a_1, a_0 = map(value, self.transfer)
        return (a_1 - b_1) / a_0 if a_0 > 0.0 else 0.0


class ChangesTable(Table):
    """Changes of a scenario: entries as a file has them."""

    parameters: dict[str, Value] = {}
    inputs: dict[str, Value] = {}
    signals: dict[str, Annotated[Table, SIGNAL]] = {}
    faults: list[Annotated[Table, FAULT]] = []


class DisturbanceTable(ChangesTable):
    """A disturbance of a vehicle."""

    title: str = ""
    """For readers; by default that of the case which names the disturbance."""


class VehicleFile(Table):
    """The description of a vehicle."""

    variables: VariablesTable = VariablesTable()
    disturbances: dict[str, DisturbanceTable] = {}
    """Name that a case of the score has -> what it changes."""
    vary: dict[str, dict[str, Any]] = {}
    """What score --full draws -> variables and distribution."""


_FILE = TypeAdapter(VehicleFile)


def description_file(vehicle: str) -> TomlFile:
    """Returns the description of a block, an FMU or a Python file; without entries if it has none."""
    beside, ships = Path(vehicle).with_suffix(".vehicle.toml"), SHIPPED / f"{Path(vehicle).stem}.toml"
    found = next((path for path in (beside, ships) if path.is_file()), None)
    return read_toml(found) if found else TomlFile(beside, "", {})


def description_of(file: TomlFile) -> VehicleFile:
    """Returns the description as types; ScenarioError names file and line of a mistake."""
    return checked(_FILE, file.data, file.at)


@dataclass(frozen=True)
class Actuators:
    """The actuators of a vehicle: force [N] for a unit of each, and the largest size that all of them take.

    gains: not a number, limit: infinite where the vehicle states none
    """

    gains: tuple[float, ...]
    limit: float
    in_volts: bool

    @property
    def force(self) -> float:
        """The largest force [N]."""
        return sum(self.gains) * self.limit

    def parameters(self, voltage_limit: float) -> dict[str, float]:
        """Returns the parameters of a controller that follow, by the names of the depth control interface.

        voltage_limit: its own [V]; there two thrusters give the largest force of a vehicle without voltages
        """
        gains = self.gains if self.in_volts else (0.5 * self.force / voltage_limit,) * 2
        values = {f"thruster_gain[{i}]": gain for i, gain in enumerate(gains, 1)}
        values |= {"voltage_limit": self.limit} if self.in_volts else {}
        return {n: v for n, v in (values | {"force_limit": self.force}).items() if math.isfinite(v)}


def actuators_of(
    vehicle: str,
    variables: Mapping[str, ScalarVariable],
    mapping: Mapping[str, str],
    given: Mapping[str, Any],
) -> Actuators:
    """Returns the actuators that a vehicle states by its description and by the range of its inputs.

    variables: of its FMU; mapping: name of the vehicle's interface -> variable; given: parameter -> value
    """
    file = description_file(vehicle)
    names = description_of(file).variables
    voltages = [mapping.get(name, name) for name in ("voltage[1]", "voltage[2]")]
    inputs = [name for name in voltages if name in variables]
    in_volts = bool(inputs)
    inputs = inputs or [mapping.get("control_force", "control_force")]

    def values(key: str) -> list[float]:
        parameters = getattr(names, key)
        if unknown := next((name for name in parameters if name not in variables), ""):
            where = f"{file.at(('variables', key))}: variables.{key}"
            raise ScenarioError(f"{where}: no variable {unknown!r}; {nearest(unknown, variables)}")
        return [float(given.get(name, start_value(variables[name]))) for name in parameters]

    ends = [e for name in inputs if name in variables for e in value_range(Port(vehicle, variables[name]))]
    limits = values("limit") or [abs(end) for end in ends if end]
    gains = values("gain") or [math.nan] * len(inputs)
    return Actuators(tuple(gains) if in_volts else (1.0,), min(limits, default=math.inf), in_volts)

"""The description of a vehicle: its properties by names that its FMU does not have.

It stands beside an FMU or a Python file as NAME.vehicle.toml; for shipped blocks it is in `vehicles/`.

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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

from pydantic import TypeAdapter

from fmus.errors import nearest
from fmus.fmi.description import start_value
from fmus.fmi.model_description import ScalarVariable
from fmus.units import UnitDefinition, si_unit
from orchestration.errors import ScenarioError
from orchestration.scenarios.actuators import FORCE, VOLTAGES, Actuators, ForceTable
from orchestration.scenarios.file_format import FAULT, SIGNAL
from orchestration.scenarios.file_tables import Table, Value, checked
from orchestration.scenarios.toml_file import TomlFile, read_toml
from orchestration.system.system import Port
from orchestration.system.values import fmi_value, value_range

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


class ChangesTable(Table):
    """Changes of a scenario: entries as a file has them."""

    parameters: dict[str, Value] = {}
    inputs: dict[str, Value] = {}
    signals: dict[str, Annotated[Table, SIGNAL]] = {}
    faults: list[Annotated[Table, FAULT]] = []


class DisturbanceTable(ChangesTable):
    """A disturbance of a vehicle."""

    title: str = ""
    """For readers; by default the title of the case which names the disturbance."""


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
    file = next((path for path in (beside, ships) if path.is_file()), None)
    return read_toml(file) if file else TomlFile(beside, "", {})


def description_of(file: TomlFile) -> VehicleFile:
    """Returns the description as types; ScenarioError names file and line of a mistake."""
    return checked(_FILE, file.data, file.at)


def unit_of(variable: ScalarVariable) -> UnitDefinition | None:
    """Returns the unit of a variable as its FMU defines it, or by its symbols; None for a name without."""
    return variable.units.get(variable.unit or "") or si_unit(variable.unit or "")


def transfer_lag(b_1: float, a_2: float, a_1: float, a_0: float) -> float:
    """Returns the first moment [s] of (b_1 s + a_0) / (s^3 + a_2 s^2 + a_1 s + a_0), 0 for an a_0 of 0."""
    return (a_1 - b_1) / a_0 if a_0 > 0.0 else 0.0


@dataclass(frozen=True)
class VehicleValues:
    """Values of a vehicle's parameters, by the names of its description.

    file: of the description; variables: of its FMU
    mapping: name of the vehicle's interface -> variable; given: parameter -> value, else its start value
    """

    file: TomlFile
    variables: Mapping[str, ScalarVariable]
    mapping: Mapping[str, str]
    given: Mapping[str, Any]

    @cached_property
    def names(self) -> VariablesTable:
        """The names of the variables by the description."""
        return description_of(self.file).variables

    def value(self, name: str, key: str = "") -> float:
        """Returns the value [SI unit] of a variable; key: of the description, which names it."""
        if name not in self.variables:
            where = f"{self.file.at(('variables', key))}: variables.{key}"
            raise ScenarioError(f"{where}: no variable {name!r}; {nearest(name, self.variables)}")
        variable = self.variables[name]
        given = self.given.get(name, start_value(variable))
        try:
            number = float(fmi_value(Port(PLANT, variable), given) if isinstance(given, str) else given)
        except (TypeError, ValueError):
            raise ScenarioError(f"{PLANT}.{name} = {given!r}: expected a number") from None
        unit = unit_of(variable)
        return number * unit.factor + unit.offset if unit else number

    def values(self, key: str) -> list[float]:
        """Returns the values of a key of the description that lists variables, or names one."""
        names = getattr(self.names, key)
        return [self.value(name, key) for name in ([names] if isinstance(names, str) else names) if name]

    def interface(self, name: str, otherwise: float) -> float:
        """Returns the value of an input by its name in the interface, or `otherwise` without that input."""
        own = self.mapping.get(name, name)
        return self.value(own) if own in self.variables else otherwise

    @property
    def heave(self) -> tuple[float, float, float]:
        """Inertia [kg], linear [N.s/m] and quadratic damping [N.s2/m2]; 0 of what has no name."""
        inertia, damping, drag = (sum(self.values(key)) for key in ("inertia", "damping", "drag"))
        return inertia, damping, drag

    @property
    def gains(self) -> tuple[float, ...]:
        """The gains of the actuators times the efficiencies that the vehicle has as inputs."""
        gains = enumerate(self.actuators.gains, 1)
        return tuple(gain * self.interface(f"thruster_efficiency[{i}]", 1.0) for i, gain in gains)

    @property
    def lags(self) -> tuple[float, ...]:
        """The lag [s] of each thruster; a transfer function counts by its first moment."""
        if any(self.values("no_lag")):
            return ()
        behind = transfer_lag(*self.values("transfer")) if self.names.transfer else 0.0
        return tuple(lag + behind for lag in self.values("lag") or [0.0])

    @property
    def actuators(self) -> Actuators:
        """The actuators that the vehicle states by its description and by the range of its inputs."""
        inputs = tuple(n for n in VOLTAGES if self.mapping.get(n, n) in self.variables) or (FORCE,)
        ports = [self.variables.get(self.mapping.get(name, name)) for name in inputs]
        ranges = [value_range(Port(PLANT, port)) if port else (-math.inf, math.inf) for port in ports]
        ranges = [(-limit, limit) for limit in self.values("limit")] or ranges
        if inputs == (FORCE,):
            return Actuators(inputs, (1.0,), tuple(ranges))
        if not self.names.table or not all(self.values("tabulated")):
            return Actuators(inputs, self._of_inputs("gain", inputs, math.nan), tuple(ranges))
        voltages, forces = (self._array(name) for name in self.names.table)
        # the force is held beyond the table
        ends = [(max(low, voltages[0]), min(high, voltages[-1])) for low, high in ranges]
        ranges = [own if all(map(math.isfinite, own)) else end for own, end in zip(ranges, ends, strict=True)]
        scale = self._of_inputs("table_scale", inputs, 1.0)
        return Actuators(inputs, scale, tuple(ranges), ForceTable(voltages, forces))

    def _of_inputs(self, key: str, inputs: Sequence[str], otherwise: float) -> tuple[float, ...]:
        """Returns the value of a key for each input, or another one if the description names none."""
        values = self.values(key) or [otherwise] * len(inputs)
        if len(values) != len(inputs):
            raise ScenarioError(
                f"{self.file.at(('variables', key))}: variables.{key} has {len(values)} entries: expected "
                f"{len(inputs)}, one for each of {', '.join(inputs)}"
            )
        return tuple(values)

    def _array(self, name: str) -> tuple[float, ...]:
        indexed = [n for n in self.variables if n.partition("[")[0] == name]
        return tuple(self.value(n, "table") for n in indexed or [name])

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

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from pydantic import TypeAdapter

from orchestration.scenarios.file_format import FAULT, SIGNAL
from orchestration.scenarios.file_tables import Table, Value, checked
from orchestration.scenarios.toml_file import TomlFile, read_toml

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

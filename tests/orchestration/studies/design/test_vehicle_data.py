"""What a design asks of a vehicle, and how it says what is missing."""

import cmath
import math
from pathlib import Path

import pytest

from orchestration.errors import ScenarioError
from orchestration.scenarios.actuators import ForceTable
from orchestration.scenarios.vehicle import transfer_lag
from orchestration.studies.design.vehicle_data import (
    VehicleData,
    corners,
    data_of,
    drawn,
    draws_of,
    overruled,
)
from orchestration.studies.vehicle import Vehicle
from tests.described_fmus import described

NAMES = '[variables]\ninertia = "mass"\nnet_weight = "trim"\nsensor_period = "pace"\n'
PARAMETERS = ("mass", "trim", "pace", "volts")
TABLE = """limit = ["volts", "volts"]
tabulated = "tab"
table = ["v", "f"]
table_scale = ["n[1]", "n[2]"]

[vary.n]
variables = ["plant.n[1]", "plant.n[2]"]
distribution = "uniform"
low = 1.5
high = 3.0
"""
DRAWN = '[vary.mass]\nvariables = ["plant.mass"]\ndistribution = "{}"\n'


def boat(folder: Path, description: str, inputs: tuple[str, ...] = ("voltage[1]", "voltage[2]")) -> Vehicle:
    (folder / "boat.vehicle.toml").write_text(description)
    settings = {"plant.mass": 10.0, "plant.pace": 0.05, "plant.volts": 10.0, "plant.trim": 1.0}
    fmu = described(folder / "boat.fmu", inputs, ("depth",), PARAMETERS)
    return Vehicle.of(str(fmu), settings=settings)


def read(vehicle: Vehicle) -> VehicleData:
    return data_of(vehicle, draws_of(vehicle))


def test_the_data_of_our_vehicle_are_its_start_values_and_ranges(data: VehicleData) -> None:
    assert (data.inertia, data.damping, data.drag) == ((5.0, 7.0), (1.0, 10.0), (0.0, 20.0))
    assert data.net_weight == pytest.approx((-1.5, -0.9))  # -1.2 N, buoyancy +-0.3 N
    assert data.largest_weight == pytest.approx(1.5)
    assert data.gain == pytest.approx((0.8, 1.2))
    assert (data.force_limit, data.lag, data.delay, data.period) == (6.0, 0.05, 0.06, 0.04)
    assert data.noise == pytest.approx((0.002**2 + 0.002**2 / 12.0) ** 0.5)


@pytest.mark.parametrize(
    ("inputs", "names"),
    [(("voltage[1]",), r'\["NAME"\]'), (("voltage[1]", "voltage[2]"), r'\["NAME", "NAME"\]')],
)
def test_all_that_is_missing_is_named_at_once_with_where_to_write_it(
    tmp_path: Path, inputs: tuple[str, ...], names: str
) -> None:
    """A gain for each thruster, or the table of a force that is no line."""
    expected = (
        r"boat: its inertia and net_weight and sensor_period and gain are not known: expected inertia = "
        rf'"NAME", .*gain = {names} \(or table = \["VOLTAGES", "FORCES"\] .*\) in \[variables\] of '
        r".*boat.vehicle.toml; its parameters are mass, trim, pace, volts"
    )
    with pytest.raises(ScenarioError, match=expected):
        read(boat(tmp_path, "", inputs))


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ('gain = ["k", "k"]\nlimit = ["volts", "volts"]\n', "no variable 'k'; known: 'depth', 'mass'"),
        ('gain = ["mass", "mass"]\n', r"the range of plant.voltage\[1\] and .* min and max of the input"),
        ('gain = ["mass", "mass"]\nlimit = ["volts", "volts"]\n' + DRAWN.format("normal")
         + "mean = 10.0\nstd = 1.0\n", "toml:7: vary.mass has no end: expected low and high"),
        ('gain = ["mass", "mass"]\nlimit = ["volts", "volts"]\n' + DRAWN.format("uniform")
         + "low = 0.0\nhigh = 1.0\n", "the inertia comes down to 0: expected more than 0"),
    ],
)  # fmt: skip
def test_data_without_a_meaning_are_refused(tmp_path: Path, more: str, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        read(boat(tmp_path, NAMES + more))


def test_a_vehicle_that_its_thrusters_cannot_hold_is_refused(tmp_path: Path) -> None:
    vehicle = boat(tmp_path, NAMES + 'gain = ["trim", "trim"]\nlimit = ["volts", "volts"]\n')
    heavy = Vehicle.of(vehicle.fmu, settings={**vehicle.settings, "plant.trim": 0.04})
    assert read(vehicle).force_limit == 20.0
    weight = NAMES.replace('net_weight = "trim"', 'net_weight = "mass"')
    (tmp_path / "boat.vehicle.toml").write_text(
        weight + 'gain = ["trim", "trim"]\nlimit = ["volts", "volts"]\n'
    )
    with pytest.raises(ScenarioError, match=r"the net weight comes to 10 N, .* give 0\.8 N"):
        read(Vehicle.of(heavy.fmu, settings=heavy.settings))


def test_a_table_of_forces_is_handed_on_and_its_weaker_direction_limits(tmp_path: Path) -> None:
    points = ("v[1]", "v[2]", "v[3]", "f[1]", "f[2]", "f[3]", "n[1]", "n[2]", "tab:Boolean")
    fmu = described(tmp_path / "boat.fmu", ("voltage[1]", "voltage[2]"), ("depth",), (*PARAMETERS, *points))
    (tmp_path / "boat.vehicle.toml").write_text(NAMES + TABLE)
    values = {"v[1]": -10.0, "v[3]": 10.0, "f[1]": -40.0, "f[3]": 30.0, "n[1]": 2.0, "n[2]": 2.0}
    values |= {"mass": 10.0, "pace": 0.05, "volts": 5.0, "trim": 1.0, "tab": True}
    read_data = read(Vehicle.of(str(fmu), settings={f"plant.{name}": x for name, x in values.items()}))
    assert read_data.actuators.table == ForceTable((-10.0, 0.0, 10.0), (-40.0, 0.0, 30.0))
    assert read_data.force_limit == 60.0  # two times two thrusters with 15 N at 5 V
    assert read_data.gain == (0.75, 1.5)


def test_a_range_of_the_efficiency_is_one_of_the_thrust() -> None:
    """Both thrusters at 0.2 N/V to 0.3 N/V, one of them at 80 % or more, over 0.5 N/V."""
    assert read(Vehicle.of("RovHeavePitchPlant")).gain == pytest.approx(((0.2 + 0.8 * 0.2) / 0.5, 1.2))


def test_a_value_that_yields_to_a_range_is_named_with_it() -> None:
    settings = {"plant.inertia": 6.0, "plant.weight": 30.0}
    vehicle = Vehicle.of("RovDepthPlant", settings=settings)
    (message,) = overruled(vehicle, draws_of(vehicle))
    assert message.startswith("plant.inertia = 6.0 acts in the first run alone: ")
    assert "takes the range 5 to 7 in [vary.*] of" in message
    assert read(vehicle).inertia == (5.0, 7.0)


def test_a_transfer_function_has_the_phase_of_the_lag_that_stands_for_it() -> None:
    """It lags by no more, and by less than 2 degrees less, up to the crossover of a fast design."""
    b_1, a_2, a_1, a_0 = 6136.0, 89.0, 9258.0, 108700.0  # of BlueRov2Plant
    lag = transfer_lag(b_1, a_2, a_1, a_0)
    for w in (1.0, 4.0, 8.0):
        s = 1j * w
        response = (b_1 * s + a_0) / (s**3 + a_2 * s**2 + a_1 * s + a_0)
        assert 0.0 <= math.degrees(cmath.phase(response * (1.0 + lag * s))) < 2.0


def test_corners_are_every_combination_of_ends_and_draws_lie_between() -> None:
    vehicle = Vehicle.of_base("vehicle")
    draws = draws_of(vehicle)
    ends = corners(vehicle, draws)
    assert len(ends) == 2**7  # seven ranges, and a seed
    assert {(c["plant.thruster_gain[1]"], c["plant.thruster_gain[2]"]) for c in ends} == {
        (0.2, 0.2),
        (0.3, 0.3),
    }
    first, again = (list(drawn(draws, 1, 5)) for _ in range(2))
    assert first == again
    assert all(5.0 < float(values["plant.inertia"]) < 7.0 for values in first)
    assert len({values["plant.sensor_seed"] for values in first}) == 5


def test_what_a_description_leaves_out_is_0(tmp_path: Path) -> None:
    """Damping, lag and what the sensor does; inertia, net weight, period and thrust are asked for."""
    found = read(boat(tmp_path, NAMES + 'gain = ["mass", "mass"]\nlimit = ["volts", "volts"]\n'))
    assert (found.damping, found.drag) == ((0.0, 0.0), (0.0, 0.0))
    assert (found.lag, found.delay, found.noise) == (0.0, 0.0, 0.0)
    assert found.net_weight == (1.0, 1.0)

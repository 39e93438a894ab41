"""What a vehicle states of its actuators becomes parameters of what commands them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestration.errors import ScenarioError
from orchestration.scenarios import scenario
from orchestration.scenarios.actuators import Actuators, ForceTable
from orchestration.studies.score.closed_loop import ClosedLoop, built_in
from orchestration.studies.score.protocol import read_protocol
from orchestration.studies.vehicle import Vehicle
from tests.described_fmus import described, redescribed

VOLTAGES = ("voltage[1]", "voltage[2]")
GAINS = ("controller.thruster_gain[1]", "controller.thruster_gain[2]")


def boat(folder: Path, description: str = "", inputs: tuple[str, ...] = VOLTAGES, limit: float = 0.0) -> Path:
    """A vehicle with these inputs within -limit..limit, if that is not 0."""
    given = ("fore", "aft", "largest")
    plain = described(folder / "plain.fmu", inputs, ("depth", "depth_rate", "measured_depth"), given)
    ranged = f'<Real start="0.0" min="{-limit}" max="{1.5 * limit}"/>' if limit else '<Real start="0.0"/>'
    fmu = redescribed(plain, folder / "boat.fmu", lambda text: text.replace('<Real start="0.0"/>', ranged))
    (folder / "boat.vehicle.toml").write_text(description)
    return fmu


def parameters(plant: Path, scenario_file: Path | None = None, **settings: Any) -> dict[str, Any]:
    """The parameters of the controller and the allocation that follow from the vehicle."""
    given = {name.replace("__", "."): value for name, value in settings.items()}
    path = scenario_file or scenario.find("nominal-extended")
    return dict(scenario.load(path, settings={"plant": str(plant), **given}).from_actuators)


def test_gains_and_the_smaller_end_of_the_range_of_the_voltages_are_handed_on(tmp_path: Path) -> None:
    plant = boat(tmp_path, '[variables]\ngain = ["fore", "aft"]\n', limit=16.0)
    expected = dict(zip(GAINS, (4.0, 2.0), strict=True)) | {"controller.voltage_limit": 16.0}
    assert parameters(plant, plant__fore=4.0, plant__aft=2.0) == expected


def test_a_parameter_that_limits_goes_before_the_range(tmp_path: Path) -> None:
    plant = boat(tmp_path, '[variables]\nlimit = ["largest"]\n', limit=16.0)
    assert parameters(plant, plant__largest=9.0) == {"controller.voltage_limit": 9.0}


def test_the_range_of_a_force_is_what_two_thrusters_give_at_the_limit_of_the_controller(
    tmp_path: Path,
) -> None:
    plant = boat(tmp_path, inputs=("control_force",), limit=160.0)
    assert parameters(plant) == dict.fromkeys(GAINS, 160.0 / 24.0)
    assert parameters(plant, controller__voltage_limit=16.0) == dict.fromkeys(GAINS, 160.0 / 32.0)


def test_one_thruster_is_told_as_two_of_half_its_gain(tmp_path: Path) -> None:
    """So it gives the whole of a demand, of which the controller gives it half, and up to its own limit."""
    line = boat(tmp_path, '[variables]\ngain = ["fore"]\n', VOLTAGES[:1], limit=16.0)
    assert parameters(line, plant__fore=4.0) == dict.fromkeys(GAINS, 2.0) | {"controller.voltage_limit": 16.0}
    table = ForceTable((-10.0, 10.0), (-40.0, 30.0))
    told = Actuators(VOLTAGES[:1], (2.0,), ((-10.0, 10.0),), table).parameters(12.0, 2)
    assert (told["thruster_scale[1]"], told["thruster_scale[2]"]) == (1.0, 1.0)
    assert (told["thruster_table_force[1]"], told["thruster_table_force[2]"]) == (-40.0, 30.0)
    assert told["force_limit"] == 60.0


def test_a_controller_with_a_force_and_the_allocation_behind_it_are_told_both(tmp_path: Path) -> None:
    plant = boat(tmp_path, '[variables]\ngain = ["fore", "aft"]\n', limit=16.0)
    inputs, outputs = ("depth_reference", "measured_depth"), ("control_force",)
    controller = described(tmp_path / "p.fmu", inputs, outputs, ("force_limit",))
    told = parameters(plant, controller=str(controller), plant__fore=4.0, plant__aft=2.0)
    assert told == {
        "controller.force_limit": 6.0 * 16.0,
        "allocation.thruster_gain[1]": 4.0,
        "allocation.thruster_gain[2]": 2.0,
        "allocation.voltage_limit": 16.0,
    }


def test_a_controller_is_told_in_its_own_units(tmp_path: Path) -> None:
    plant = boat(tmp_path, '[variables]\ngain = ["fore", "aft"]\n', limit=16.0)
    names = ("force_limit", "voltage_limit", "thruster_gain[1]")
    inputs, outputs = ("depth_reference", "measured_depth"), VOLTAGES
    units = {"force_limit": "mN", "voltage_limit": "kV", "thruster_gain[1]": "N/mV"}
    controller = described(tmp_path / "p.fmu", inputs, outputs, names, units)
    told = parameters(plant, controller=str(controller), plant__fore=4.0, plant__aft=2.0)
    assert told["controller.force_limit"] == pytest.approx(96e3)
    assert told["controller.voltage_limit"] == pytest.approx(16e-3)
    assert told["controller.thruster_gain[1]"] == pytest.approx(4e-3)


def test_settings_and_the_file_that_names_the_vehicle_give_others(tmp_path: Path) -> None:
    plant = boat(tmp_path, limit=16.0)
    assert parameters(plant, controller__voltage_limit=5.0) == {}
    child = tmp_path / "child.toml"
    child.write_text(
        f"base = 'nominal-extended'\ncomponents = {{ plant = '{plant}' }}\n"
        '[parameters]\n"controller.voltage_limit" = 5.0\n'
    )
    loaded = scenario.load(child)
    assert loaded.experiment.parameters["controller.voltage_limit"] == 5.0


def test_nothing_is_handed_on_from_the_vehicle_of_the_scenario_or_one_that_states_nothing(
    tmp_path: Path,
) -> None:
    assert not scenario.load(scenario.find("nominal-extended")).from_actuators
    assert not parameters(boat(tmp_path))


def test_a_vehicle_with_parameters_of_these_names_keeps_its_own(scenario_fmus: None) -> None:
    settings = {"plant": "RovDepthPlant", "controller": "L1DepthController"}
    told = scenario.load(scenario.find("heave-pitch"), settings=settings).from_actuators
    assert told == dict.fromkeys(GAINS, 0.25) | {"controller.voltage_limit": 12.0}


TABLE = '[variables]\ntable = ["v", "f"]\ntable_scale = ["n[1]", "n[2]"]\n'
POINTS = {"v": (-10.0, 0.0, 10.0), "f": (-40.0, 0.0, 30.0), "n": (2.0, 1.0)}
VALUES = {f"plant__{name}[{i}]": x for name, xs in POINTS.items() for i, x in enumerate(xs, 1)}


def thrusters(folder: Path, points: int) -> tuple[Path, Path]:
    """A vehicle whose thrusters have a table of three points, and a controller with one of so many."""
    names = ("v[1]", "v[2]", "v[3]", "f[1]", "f[2]", "f[3]", "n[1]", "n[2]")
    outputs = ("depth", "depth_rate", "measured_depth")
    plant = described(folder / "boat.fmu", VOLTAGES, outputs, names)
    (folder / "boat.vehicle.toml").write_text(TABLE)
    table = [f"thruster_table_{n}[{i}]" for n in ("voltage", "force") for i in range(1, points + 1)]
    own = ["thruster_tabulated:Boolean", "voltage_limit", "thruster_scale[1]", "thruster_scale[2]", *table]
    own += ["thruster_gain[1]", "thruster_gain[2]"]
    inputs = ("depth_reference", "measured_depth")
    return plant, described(folder / "c.fmu", inputs, VOLTAGES, own)


@pytest.mark.parametrize("points", [3, 4, 7])
def test_a_table_is_handed_on_with_the_points_that_the_controller_has(tmp_path: Path, points: int) -> None:
    """Further points lie on its lines, so that the force is the same everywhere."""
    plant, controller = thrusters(tmp_path, points)
    told = parameters(plant, controller=str(controller), **VALUES)
    assert told["controller.thruster_tabulated"] is True
    assert [told[f"controller.thruster_scale[{i}]"] for i in (1, 2)] == [2.0, 1.0]
    assert told["controller.voltage_limit"] == 10.0
    voltages, forces = (
        [told[f"controller.thruster_table_{n}[{i}]"] for i in range(1, points + 1)]
        for n in ("voltage", "force")
    )
    assert (np.diff(voltages) > 0.0).all()
    everywhere = np.linspace(-12.0, 12.0, 49)
    expected = np.interp(everywhere, POINTS["v"], POINTS["f"])
    np.testing.assert_allclose(np.interp(everywhere, voltages, forces), expected, atol=1e-12)  # rounding


def test_a_longer_table_than_the_controller_has_is_refused_and_a_line_takes_its_place(tmp_path: Path) -> None:
    """The line meets the table at its weaker end: 30 N at 10 V, times the thrusters."""
    plant, controller = thrusters(tmp_path, 2)
    given = {"controller": str(controller), **VALUES}
    with pytest.raises(ScenarioError, match=r"controller: expected .* at most 2 points, got 3 .*=false"):
        parameters(plant, **given)
    assert parameters(plant, controller__thruster_tabulated=False, **given) == {
        "controller.thruster_gain[1]": 6.0,
        "controller.thruster_gain[2]": 3.0,
        "controller.voltage_limit": 10.0,
    }


def test_gains_of_another_number_than_the_inputs_are_refused(tmp_path: Path) -> None:
    plant = boat(tmp_path, '[variables]\ngain = ["fore"]\n')
    with pytest.raises(ScenarioError, match=r"toml:2: variables.gain has 1 entries: expected 2, one "):
        parameters(plant)


def test_a_parameter_that_a_description_misspells_is_named(tmp_path: Path) -> None:
    plant = boat(tmp_path, '[variables]\ngain = ["for", "aft"]\n')
    with pytest.raises(
        ScenarioError, match=r"boat.vehicle.toml:2: variables.gain: no variable 'for'; .*'fore'"
    ):
        parameters(plant)


def test_a_score_tells_its_controllers_the_same_and_a_case_does_not_change_it(tmp_path: Path) -> None:
    """A disturbance of the thrusters is what the controllers do not know."""
    description = (
        '[variables]\ngain = ["fore", "aft"]\nlimit = ["largest"]\n'
        '[disturbances.voltage-limit]\nparameters = { "plant.largest" = 3.0 }\n'
    )
    settings = {"plant.fore": 4.0, "plant.aft": 2.0, "plant.largest": 9.0}
    vehicle = Vehicle.of(str(boat(tmp_path, description, (*VOLTAGES, "external_force"))), settings=settings)
    protocol = read_protocol(vehicle=vehicle)
    with ClosedLoop(built_in(protocol, "pid"), protocol) as loop:
        for case in (protocol.nominal, protocol.cases["voltage-limit"]):
            given = loop.experiment(case).parameters
            assert given["plant.largest"] == (9.0 if case is protocol.nominal else 3.0)
            assert [given[name] for name in (*GAINS, "controller.voltage_limit")] == [4.0, 2.0, 9.0]


def test_a_limit_counts_as_reached_with_the_rounding_of_an_inverse_and_rest_does_not() -> None:
    """One actuator pushes both ways, the other one way."""
    actuators = Actuators(("voltage[1]", "voltage[2]"), (6.65, 6.65), ((-12.0, 12.0), (0.0, 12.0)))
    rounded = 12.0 - 2e-15
    given = np.array([[0.0, 0.0], [rounded, 0.0], [-rounded, 0.0], [11.9, 11.9], [0.0, 13.0]])
    assert actuators.is_saturated(given).tolist() == [False, True, True, False, True]

"""Another vehicle in a score, by the vehicle's interface: which cases it plays, and what metrics it has."""

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fmus.fmi.description import describe, of_causality
from fmus.registry import fmu_path
from orchestration.errors import ScenarioError
from orchestration.results.recording import Recording
from orchestration.scenarios.actuators import FORCE, Actuators
from orchestration.scenarios.vehicle import SHIPPED
from orchestration.studies.score import score
from orchestration.studies.score.closed_loop import ClosedLoop, Controller, built_in
from orchestration.studies.score.draws import plants
from orchestration.studies.score.protocol import Protocol, read_protocol
from orchestration.studies.score.run_metrics import judged_signals
from orchestration.studies.score.score_document import protocol_info
from orchestration.studies.score.tune_problem import practice_cases
from orchestration.studies.vehicle import Vehicle
from tests.described_fmus import described

ROOT = Path(__file__).parents[3]
MASS = {"plant.mass": 12.0}  # kg
DESCRIPTION = """
[variables]
start_depth = "z0"

[disturbances.inertia-low]
title = "Mass 4 kg"
parameters = { "plant.mass" = 4.0 }

[vary.mass]
variables = ["plant.mass"]
distribution = "uniform"
low = 4.0
high = 8.0
"""


def boat(folder: Path, inputs: tuple[str, ...] = (), parameters: tuple[str, ...] = ()) -> Path:
    return described(folder / "boat.fmu", ("control_force", *inputs), ("depth",), parameters)


def test_no_parameter_of_our_vehicle_stands_in_score_tune_or_margins() -> None:
    """Names that controllers have too count where they are the plant's, also as `{PLANT}.NAME`."""
    ours, shared = (
        {v.name.partition("[")[0] for v in of_causality(describe(fmu_path(block)), "parameter")}
        for block in ("RovDepthPlant", "L1DepthController")
    )
    found = re.compile(
        rf"\bplant\W?\.({'|'.join(ours)})\b|[\"']({'|'.join(ours - shared)})(\[\d\])?[\"']", re.IGNORECASE
    )
    rooms = [ROOT / "orchestration" / name for name in ("studies/score", "studies/margins", "cli")]
    files = [path for room in rooms for path in room.glob("*.*") if path.suffix in {".py", ".toml"}]
    assert len(files) > 30
    assert not {
        path.name: found.findall(text) for path in files if found.search(text := path.read_text("utf-8"))
    }


def test_a_case_that_a_vehicle_cannot_play_is_left_out_and_named(tmp_path: Path) -> None:
    vehicle = Vehicle.of(str(boat(tmp_path, ("external_force",))))
    protocol = read_protocol(vehicle=vehicle)
    assert list(protocol.cases) == ["nominal", "frozen", "drop-outs"]
    assert protocol.left_out["current"] == "boat lacks plant.current_velocity"
    assert protocol.left_out["inertia-low"] == (
        "boat has no disturbance inertia-low, inertia-high, damping-low, damping-high, dead-zone,"
        " thruster-lag, voltage-limit, noise, delay: expected each in boat.vehicle.toml beside it"
    )
    lines = protocol_info(protocol).left_out
    assert sorted(lines.values()) == sorted({*protocol.left_out.values()})
    ((titles, _),) = ((titles, why) for titles, why in lines.items() if "no disturbance" in why)
    assert titles.startswith(f"{protocol.tables.cases['inertia-low'].title}; ")
    assert len(titles.split("; ")) == 9
    assert protocol.left_out["hold-step"] == "boat lacks plant.initial_depth"
    assert protocol.cases.keys() | protocol.left_out.keys() == protocol.tables.cases.keys()


@pytest.mark.parametrize("described_by", ["", "[variables]\ninertia = 'mass'\n"])
def test_the_tuned_controllers_are_left_out_where_no_inertia_scales_their_gains(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, described_by: str
) -> None:
    """Their gains are for another vehicle: ranks beside them would mean nothing."""
    beside: list[object] = []
    monkeypatch.setattr(score, "_rows", lambda scoring, chosen, others, *_: beside.extend(others) or [])
    (tmp_path / "boat.vehicle.toml").write_text(described_by)
    protocol = read_protocol(vehicle=Vehicle.of(str(boat(tmp_path, parameters=("mass",))), settings=MASS))
    document = score.score_controllers([Controller("mine", "my.fmu")], protocol, seed=1).document
    names = {c.name.removeprefix("tuned/") for c in beside if isinstance(c, Controller)}
    assert names == ({*protocol.controllers} if described_by else set())
    assert score.run_count(1, protocol, full=False) == (1 + len(names)) * len(protocol.cases)
    left_out = "left out: inertia under [variables] in boat.vehicle.toml would scale their gains."
    assert (left_out in document.protocol.statement) == (not described_by)
    assert ("scaled to the inertia of this vehicle, 12 kg" in document.protocol.statement) == bool(
        described_by
    )
    if not described_by:
        with pytest.raises(
            ScenarioError, match=r"boat: its inertia is not known: expected inertia in \[varia"
        ):
            score.compare(protocol)


def test_a_vehicle_has_disturbances_and_draws_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "boat.vehicle.toml").write_text(DESCRIPTION)
    vehicle = Vehicle.of(str(boat(tmp_path, ("external_force",), ("z0", "mass"))))
    protocol = read_protocol(vehicle=vehicle)
    case = protocol.cases["inertia-low"]
    assert (case.title, case.layer["parameters"]) == ("Mass 4 kg", {"plant.mass": 4.0})
    assert protocol.cases["hold-step"].layer["parameters"] == {"plant.z0": 1.0}
    drawn = plants(protocol, 1, 20)
    assert {name for plant in drawn for name in plant.values} == {"plant.mass"}
    assert all(4.0 <= float(plant.values["plant.mass"]) <= 8.0 for plant in drawn)


def test_a_mapped_vehicle_plays_what_its_own_names_stand_for(tmp_path: Path) -> None:
    mapping = {"initial_depth": "z0", "external_force": "push"}
    protocol = read_protocol(vehicle=Vehicle.of(str(boat(tmp_path, ("push",), ("z0",))), mapping))
    with ClosedLoop(built_in(protocol, "pid"), protocol) as loop:
        held = loop.experiment(protocol.cases["hold-step"])
        loop.experiment(protocol.nominal)
    assert held.parameters["plant.z0"] == 1.0
    assert "plant.push" in held.signals
    assert list(held.record) == ["controller.depth_reference", "plant.depth", "plant.control_force"]


def test_tuning_goes_on_without_the_cases_that_a_vehicle_lacks(tmp_path: Path) -> None:
    protocol = read_protocol(vehicle=Vehicle.of(str(boat(tmp_path))))
    assert [case.name for case in practice_cases(protocol)] == ["nominal"]


@pytest.mark.parametrize("name", [path.stem for path in SHIPPED.glob("*.toml")])
def test_a_shipped_description_names_variables_of_its_vehicle_that_take_its_values(name: str) -> None:
    vehicle = Vehicle.of(name)
    described = vehicle.described
    own = [described.variables.start_depth, described.variables.noise_seed, described.variables.inertia]
    drawn = [v.removeprefix("plant.") for table in described.vary.values() for v in table["variables"]]
    assert {*own, *described.variables.limit, *drawn} <= vehicle.variables.keys()
    protocol = read_protocol(vehicle=vehicle)
    with ClosedLoop(built_in(protocol, "pid"), protocol) as loop:
        for case in protocol.cases.values():
            loop.experiment(case)
    assert len(plants(protocol, 1, 3)) == 3


def test_our_vehicle_under_another_name_has_the_metrics_of_ours(protocol: Protocol, tmp_path: Path) -> None:
    """Its description ships: every case is played."""
    same = read_protocol(vehicle=Vehicle.of("RovDepthPlant"))
    assert not same.left_out
    case = "voltage-limit"
    ours, others = (
        ClosedLoop(built_in(read, "pid"), read).metrics(read.cases[case]) for read in (protocol, same)
    )
    np.testing.assert_equal(others, ours)


@pytest.mark.parametrize("lacks", ["depth", "control_force"])
def test_a_vehicle_without_depth_or_actuator_is_refused(tmp_path: Path, lacks: str) -> None:
    inputs, outputs = ((name,) if name != lacks else () for name in ("control_force", "depth"))
    fmu = described(tmp_path / "boat.fmu", inputs, outputs)
    with pytest.raises(ScenarioError, match=rf"which lacks plant.{lacks}.*--map plant.{lacks}=NAME"):
        Vehicle.of(str(fmu))


def test_metrics_of_a_force_have_newtons_and_no_volts() -> None:
    values = np.column_stack([[0.0, 0.0], [0.1, 0.1], [-8.0, 3.0]])
    recording = Recording(("r", "z", "f"), ("m", "m", "N"), np.array([0.0, 0.02]), values)
    signals = judged_signals(recording, ("r", "z", "f"), Actuators((FORCE,), (1.0,), ((-6.0, 6.0),)))
    assert signals["u"].tolist() == [-6.0, 3.0]
    assert signals["saturated"].tolist() == [100.0, 0.0]
    assert np.isnan(signals["voltage"]).all()
    assert np.isnan(signals["power"]).all()
    unlimited = judged_signals(
        recording, ("r", "z", "f"), Actuators((FORCE,), (1.0,), ((-math.inf, math.inf),))
    )
    assert unlimited["u"].tolist() == [-8.0, 3.0]
    assert np.isnan(unlimited["saturated"]).all()


@pytest.mark.parametrize(
    "arguments",
    [
        "run nominal-l1 --plant",
        "sweep monte-carlo --plant",
        "package nominal-l1 --plant",
        "margins nominal-l1 --plant",
        "score PidDepthController --plant",
        "tune pid --plant",
        "compare --plant",
        "design --plant",
        "fit --data dive.csv --free mass",
    ],
)
def test_every_command_takes_a_vehicle_by_the_same_names(refused: Callable[..., str], arguments: str) -> None:
    assert "no block 'RovDepthPlan', and a path must end in .fmu, .py" in refused(
        *arguments.split(), "RovDepthPlan"
    )

"""A controller in the loop of the protocol gives the metrics of the scenarios that it is made of."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from orchestration.errors import ScenarioError
from orchestration.results import metrics
from orchestration.run import simulate
from orchestration.scenarios import scenario
from orchestration.scenarios.toml_file import read_toml
from orchestration.scenarios.vehicle import description_of
from orchestration.studies.score.closed_loop import TOLD, ClosedLoop, built_in
from orchestration.studies.score.protocol import Protocol, read_protocol
from orchestration.studies.score.score_rows import alone
from orchestration.studies.vehicle import Vehicle


@pytest.mark.parametrize(
    ("case", "shipped"), [("nominal", "nominal-extended"), ("buoyancy", "buoyancy-extended")]
)
def test_metrics_are_those_of_the_shipped_scenario(protocol: Protocol, case: str, shipped: str) -> None:
    loaded = scenario.load(scenario.find(shipped))
    measured = metrics.evaluate(simulate(loaded.system, loaded.experiment), loaded.metrics)
    with ClosedLoop(built_in(protocol, "l1-pi"), protocol) as loop:
        given = loop.metrics(protocol.cases[case])
    for name in ("rmse", "settling_time", "overshoot", "lag"):
        assert given[name] == measured[name]


def test_gains_are_of_one_run_alone(protocol: Protocol) -> None:
    nominal = protocol.cases["nominal"]
    with ClosedLoop(built_in(protocol, "l1-pi"), protocol) as loop:
        first = loop.metrics(nominal, names=["rmse"])
        assert loop.metrics(nominal, {"proportional_gain": 10.0}, ["rmse"])["rmse"] < first["rmse"]
        assert loop.metrics(nominal, names=["rmse"]) == first


def test_a_hold_has_neither_lag_nor_overshoot_and_begins_at_its_depth(protocol: Protocol) -> None:
    with ClosedLoop(built_in(protocol, "l1-pi"), protocol) as loop:
        run = loop.run(protocol.cases["hold-step"])
        metrics = loop.metrics(protocol.cases["hold-step"])
    assert run["depth"][0] == 1.0
    assert set(run["reference"]) == {1.0}
    assert math.isnan(metrics["lag"])
    assert math.isnan(metrics["overshoot"])
    assert metrics["peak_error"] > 1.0


def test_unknown_names_offer_the_nearest(protocol: Protocol) -> None:
    with pytest.raises(ScenarioError, match=r"no controller 'l2'; .*'l1'"):
        built_in(protocol, "l2")


def test_laws_assume_the_inertia_and_damping_of_another_vehicle(protocol: Protocol) -> None:
    """Those of BlueROV2 as von Benzon et al. (2022) have them; pid assumes a damping alone."""
    other = read_protocol(vehicle=Vehicle.of("BlueRov2Plant"))
    assumed = {name: built_in(other, name).parameters for name in ("l1", "adrc", "pid")}
    assert assumed["l1"] == {"model_inertia": 32.18, "model_damping": 33.0, "augmentation": "none"}
    assert assumed["adrc"] == {"model_inertia": 32.18}
    assert assumed["pid"]["model_damping"] == 33.0
    assert "model_inertia" not in built_in(protocol, "adrc").parameters


@pytest.mark.parametrize(
    ("of_vehicle", "old", "new", "nearest"),
    [
        (True, '"plant.inertia" = 7.0', '"plant.intertia" = 7.0', "plant.inertia"),
        (False, '"plant.buoyancy_change" = 0.2', '"plant.bouyancy_change" = 0.2', "plant.buoyancy_change"),
        (
            True,
            'variables = ["plant.sensor_delay"]',
            'variables = ["plant.sensor_dely"]',
            "plant.sensor_delay",
        ),
    ],
)
def test_a_variable_that_the_vehicle_lacks_is_refused_before_any_run(
    tmp_path: Path, of_vehicle: bool, old: str, new: str, nearest: str
) -> None:
    """Also of a case that is not run yet, and of the vehicle's own disturbances and draws."""
    read = read_protocol()
    file = read.vehicle.file if of_vehicle else read.file
    assert old in file.text
    path = tmp_path / "wrong.toml"
    path.write_text(file.text.replace(old, new), encoding="utf-8")
    if of_vehicle:
        wrong = read_toml(path)
        vehicle = replace(read.vehicle, file=wrong, described=description_of(wrong))
        protocol = replace(read, vehicle=vehicle)
    else:
        protocol = read_protocol(path)
    complaint = rf"wrong.toml:\d+: no variable plant\.\w+; nearest is '{nearest}'"
    with (
        ClosedLoop(built_in(protocol, "pid"), protocol) as loop,
        pytest.raises(ScenarioError, match=complaint),
    ):
        loop.scenario(protocol.nominal)


def test_a_controller_alone_puts_out_what_it_did_in_the_loop_also_behind_a_transformation(
    protocol: Protocol,
) -> None:
    """To the last bit at every communication point; a reading of 0.9 z + 0.1 m is another loop."""
    way = {"source": "plant.measured_depth", "factor": 0.9, "offset": 0.1}
    nominal = protocol.nominal
    changed = replace(nominal, layer={**nominal.layer, "connections": {"controller.measured_depth": way}})
    with ClosedLoop(built_in(protocol, "pid"), protocol) as loop:
        system, experiment = alone(loop, changed)
        (output,) = experiment.record
        in_loop = replace(loop.experiment(changed), record=(output,))
        expected = simulate(loop.scenario(changed).system, in_loop)[output]
    assert np.abs(expected).max() > 1.0
    np.testing.assert_array_equal(simulate(system, experiment)[output], expected)


def test_rates_that_are_not_connected_are_0(protocol: Protocol) -> None:
    with ClosedLoop(replace(built_in(protocol, "pid-rates"), reference_rates=False), protocol) as loop:
        assert loop.connected() == ["depth_reference"]
        inputs = loop.experiment(protocol.nominal).inputs
        for name in TOLD[1:]:
            assert inputs[f"controller.{name}"] == 0.0

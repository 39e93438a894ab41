"""The protocol: what a file may say, its cases and plants, and what a score draws."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestration.errors import ScenarioError
from orchestration.scenarios import scenario
from orchestration.studies.score.draws import drawn_cases, plants, repeated_cases
from orchestration.studies.score.protocol import FILE, Protocol, first_target, read_protocol
from orchestration.studies.score.score_rows import repeated


def seeds_in(value: Any) -> list[int]:
    if isinstance(value, dict):
        return [seed for key, item in value.items() for seed in ([item] if key == "seed" else seeds_in(item))]
    return [seed for item in value for seed in seeds_in(item)] if isinstance(value, list) else []


def test_a_score_draws_every_seed_of_its_cases_and_repeats_them(protocol: Protocol) -> None:
    """No two are alike: of 60 of 2^31 numbers that would be a chance of one in a million."""
    drawn = [case for seed in (1, 2) for case in drawn_cases(protocol, seed)]
    seeds = [case.values["plant.sensor_seed"] for case in drawn]
    seeds += [seed for case in drawn for seed in seeds_in(case.layer)]
    assert len(seeds) > 2 * len(protocol.cases)
    assert len({*seeds, *protocol.tables.practice_seeds}) == len(seeds) + len(protocol.tables.practice_seeds)
    assert drawn_cases(protocol, 1) == drawn[: len(protocol.cases)]


def test_a_score_draws_when_the_changes_of_a_case_come(protocol: Protocol) -> None:
    times = {
        case.later for seed in range(20) for case in drawn_cases(protocol, seed) if case.name == "hold-step"
    }
    assert len(times) == 20
    assert 0.0 <= min(times) < 2.0  # of 20 uniform numbers below 10, all but one of 87 times
    assert 8.0 < max(times) <= 10.0
    assert protocol.cases["hold-step"].later == 0.0  # for whoever tunes


def test_the_first_case_is_the_papers(protocol: Protocol) -> None:
    loaded = scenario.load(scenario.find("nominal-l1"))
    assert protocol.nominal.target.depth == 0.8
    assert protocol.nominal.target.band == pytest.approx(0.04)
    assert protocol.nominal.target.window == (0.0, 140.0)
    assert protocol.nominal.judged == (loaded.experiment.start_time, loaded.experiment.stop_time)


def test_the_cases_of_the_cost_are_marked_as_tuned_on(protocol: Protocol) -> None:
    assert {name for name, case in protocol.cases.items() if case.tuned_on} == set(protocol.tables.cost.cases)


def test_a_target_is_the_first_depth_that_is_held() -> None:
    target = first_target([[0.0, 0.0], [10.0, 0.5], [20.0, 0.7], [50.0, 0.7], [60.0, 0.2]])
    assert (target.depth, target.window) == (0.7, (0.0, 50.0))
    with pytest.raises(ScenarioError, match="expected two points in a row of one depth"):
        first_target([[0.0, 0.0], [10.0, 0.5]])


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('function = "iae"', 'function = "iaee"', r":\d+: metrics.iae.function = 'iaee'; nearest is 'iae'"),
        ('cases = ["nominal", ', 'cases = ["nominl", ', r":\d+: cost.cases = 'nominl'; nearest is 'nominal'"),
        ("count = 300", "count = 1", r":\d+: plants.count = 1: expected 2 or more"),
        ("overshoot = 5.0\nbreach", "oversoot = 5.0\nbreach", r":\d+: failure.oversoot = 'oversoot'"),
        ('kind = "freeze"', 'kind = "freze"', r":\d+: cases.frozen.faults\[0\]: unknown kind 'freze'"),
        ("hold = 1.0", "holds = 1.0", r":\d+: cases.hold-step: unknown key 'holds'; nearest is 'hold'"),
        ('base = "vehicle"', 'base = "vehicel"', r":\d+: base = 'vehicel'; nearest is 'vehicle'"),
        ("[metrics.peak_error]", "[metrics.peak]", r"wrong.toml: metrics.peak_error is missing"),
        (
            "total_variation = 1000.0",
            "total_variatoin = 1e3",
            r":\d+: cost.bounds.total_variatoin = .*nearest",
        ),
        ('fmu = "PidDepthController"', 'fmu = "PidControler"', r":\d+: controllers.pid.fmu = .*; nearest is"),
        ("largest = 30.0", "lagest = 30.0", r":\d+: unknown key 'lagest'; nearest is 'largest'"),
        ('signal = "power"', 'signal = "pover"', r":\d+: metrics.energy.arguments.signal = 'pover'; nearest"),
        (
            'function = "effort"\narguments = { signal = "power" }',
            'function = "energy_residual"\narguments = { signal = "u", flow = "dept" }',
            r":\d+: metrics.energy.arguments.flow = 'dept'; nearest is 'depth'",
        ),
        (
            'disturbance = "noise"',
            'disturbance = "nose"',
            r":\d+: cases.noise.disturbance = 'nose'; nearest is 'noise'",
        ),
    ],
)
def test_a_mistake_is_told_with_its_line(tmp_path: Path, old: str, new: str, complaint: str) -> None:
    text = FILE.read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "wrong.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ScenarioError, match=complaint):
        read_protocol(path)


def test_plants_follow_from_their_seed_and_number_alone(protocol: Protocol) -> None:
    few, many = plants(protocol, 7, 3), plants(protocol, 7, 5)
    assert many[:3] == few
    assert plants(protocol, 8, 3) != few


def test_plants_are_within_their_distributions_and_vary_the_trajectory(protocol: Protocol) -> None:
    drawn = plants(protocol, protocol.tables.plants.practice_seed, 60)
    limits: dict[str, Any] = {
        "plant.inertia": (5.0, 7.0),
        "plant.linear_damping": (1.0, 10.0),
        "plant.buoyancy_change": (-0.3, 0.3),
        "plant.thruster_gain[1]": (0.2, 0.3),
        "plant.sensor_delay": (0.0, 0.06),
    }
    for name, (low, high) in limits.items():
        values = [float(plant.values[name]) for plant in drawn]
        assert low <= min(values) < max(values) <= high
        assert len(set(values)) == len(values)
    for plant in drawn:
        assert plant.values["plant.thruster_gain[1]"] == plant.values["plant.thruster_gain[2]"]
        times = np.array(plant.trajectory)[:, 0]
        assert times[0] == 0.0
        assert times[-1] == plant.judged[1]
        assert (np.diff(times) > 0.0).all()
        assert plant.target == first_target(plant.trajectory)
        assert not plant.tuned_on
    assert len({plant.target.depth for plant in drawn}) == len(drawn)


def test_the_draws_of_a_case_begin_with_the_one_of_the_score_and_go_on(protocol: Protocol) -> None:
    """Another number of them changes none, and each has a seed of its own."""
    drawn, more = repeated_cases(protocol, 7, 3), repeated_cases(protocol, 7, 4)
    assert [draws[0] for draws in drawn] == drawn_cases(protocol, 7)
    assert [draws[:3] for draws in more] == drawn
    noise, waves, sea = (
        next(draws for draws in drawn if draws[0].name == name)
        for name in ("nominal", "hold-waves", "hold-sea")
    )
    assert len({draw.values[draw.seed_variable] for draw in noise}) == 3
    assert len({draw.layer["signals"]["plant.external_force"]["seed"] for draw in waves}) == 3
    assert len({draw.layer["parameters"]["waves.seed"] for draw in sea}) == 3
    assert {draw.layer["parameters"]["waves.gamma"] for draw in sea} == {3.3}


def test_a_case_that_repeats_the_nominal_one_is_drawn_once(protocol: Protocol) -> None:
    names = {name for name, case in protocol.cases.items() if case.repeats_nominal}
    assert {"noise", "drop-outs"} <= names
    draws = repeated(protocol, 7)
    assert draws.keys() == protocol.cases.keys() - names
    assert {len(cases) for cases in draws.values()} == {protocol.tables.repetitions}
    assert protocol.tables.repetitions >= 20


def test_a_version_of_another_protocol_is_kept(small_protocol: Callable[..., Path]) -> None:
    assert read_protocol(small_protocol(version="mine")).version == "mine"

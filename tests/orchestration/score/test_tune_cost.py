"""The cost of gains: what it is made of, that it is finite, and which seeds of noise it uses."""

import math
from collections.abc import Iterator
from dataclasses import replace

import pytest

from orchestration.scenarios.free_parameter import FreeParameter
from orchestration.score.closed_loop import ClosedLoop, built_in
from orchestration.score.protocol import Protocol
from orchestration.score.tune_problem import LARGEST, costs, delayed, practice_cases, problem_of, run_cost

BOUNDS = {"overshoot": 5.0, "total_variation": 1000.0}


@pytest.mark.parametrize(
    ("metrics", "cost"),
    [
        ({"rmse": 2.0, "overshoot": 5.0, "total_variation": 1000.0}, 2.0),  # at its bounds
        ({"rmse": 2.0, "overshoot": 6.0, "total_variation": 900.0}, 4.0),  # a fifth above one: 10 times 0.2
        ({"rmse": 2.0, "overshoot": 6.0, "total_variation": 1500.0}, 9.0),
        ({"rmse": 2.0, "overshoot": math.nan, "total_variation": 1500.0}, 7.0),  # no overshoot: no bound
        ({"rmse": math.nan, "overshoot": 0.0, "total_variation": 0.0}, LARGEST),
        ({"rmse": 1e9, "overshoot": 0.0, "total_variation": 0.0}, LARGEST),
        ({"rmse": 2.0, "overshoot": 0.0, "total_variation": 1e9}, LARGEST),
    ],
)
def test_a_run_costs_its_error_and_what_is_beyond_the_bounds(metrics: dict[str, float], cost: float) -> None:
    assert run_cost(metrics, "rmse", BOUNDS) == pytest.approx(cost)


def test_tuning_uses_practice_seeds_alone_and_another_one_in_each_case(protocol: Protocol) -> None:
    seeds = [case.values["plant.sensor_seed"] for case in practice_cases(protocol)]
    assert len(set(seeds)) == len(protocol.tables.cost.cases) > 1
    every = practice_cases(protocol, every_seed=True)
    assert {case.values["plant.sensor_seed"] for case in every} == set(protocol.tables.practice_seeds)
    assert len(every) == len(seeds) * len(protocol.tables.practice_seeds)


@pytest.fixture(scope="module")
def loop(protocol: Protocol) -> Iterator[ClosedLoop]:
    with ClosedLoop(built_in(protocol, "l1-pi"), protocol) as loop:
        yield loop


def test_the_cost_is_the_mean_error_of_the_cases_where_no_bound_is_reached(loop: ClosedLoop) -> None:
    """At the gains of the block, which are slow: all bounds hold."""
    evaluated = next(costs(loop, [{}]))
    errors = [loop.metrics(case)["rmse"] for case in practice_cases(loop.protocol)]
    assert evaluated["cost"] == pytest.approx(sum(errors) / 3)
    assert next(costs(loop, [{}])) == evaluated
    assert next(costs(loop, [{"filter_bandwidth": 0.5}]))["cost"] < evaluated["cost"]


def test_a_loop_that_a_late_measurement_makes_swing_costs_more_than_its_error(loop: ClosedLoop) -> None:
    """K_P and K_I of about 20 times those of the block: quiet as it is, not with 0.1 s of delay."""
    evaluated = next(costs(loop, [{"proportional_gain": 200.0, "rate_feedback_gain": 60.0}]))
    error = sum(metrics["rmse"] for metrics in evaluated["metrics"].values()) / 3
    assert evaluated["unrest"] > 0.003
    assert evaluated["cost"] > error + 1.0


def test_a_case_can_be_delayed_besides_its_own_faults(protocol: Protocol) -> None:
    nominal = protocol.cases["nominal"]
    frozen = {"input": "controller.measured_depth", "kind": "freeze", "start": 1.0, "end": 2.0}
    late = delayed(replace(nominal, layer={**nominal.layer, "faults": [frozen]}), 0.1, "controller.y")
    assert late.layer["faults"] == [frozen, {"input": "controller.y", "kind": "delay", "delay": 0.1}]
    assert late.layer["experiment"]["stop_time"] == 140.0  # when the reference leaves 0.8 m


def test_gains_that_the_fmu_refuses_have_a_finite_cost_and_the_reason(loop: ClosedLoop) -> None:
    evaluated = next(costs(loop, [{"observer_period": 0.001}]))
    assert evaluated["cost"] == LARGEST
    assert "internal_step at most observer_period" in evaluated["failure"]
    assert next(costs(loop, [{}]))["cost"] < LARGEST  # the FMUs run on


def test_the_gains_of_a_controller_of_the_protocol_are_those_that_it_has_for_it(
    loop: ClosedLoop,
) -> None:
    controller, protocol = loop.controller, loop.protocol
    gains = problem_of(controller, protocol).gains
    assert {gain.name: (gain.low, gain.high) for gain in gains} == {
        name: (table.low, table.high) for name, table in protocol.controllers["l1-pi"].gains.items()
    }
    assert [gain.unit for gain in gains if gain.name == "integral_gain"] == ["N/(m.s)"]
    other = problem_of(controller, protocol, [FreeParameter("observer_alpha", 0.1, 0.9)])
    assert [gain.name for gain in other.gains] == ["observer_alpha"]
    assert other.tuned == problem_of(controller, protocol).tuned
    assert other.tuned != problem_of(replace(controller, reference_rates=True), protocol).tuned

"""The cost of gains: what it is made of, that it is finite, and which seeds of noise it uses."""

import math
from collections.abc import Iterator
from dataclasses import replace

import pytest

from orchestration.errors import ScenarioError
from orchestration.scenarios.free_parameter import FreeParameter
from orchestration.studies.margins.fmu_margins import scan
from orchestration.studies.margins.hold import QUIET, HoldRuns, LoopSignal, last_part
from orchestration.studies.score.closed_loop import ClosedLoop, built_in, tuned
from orchestration.studies.score.draws import plants
from orchestration.studies.score.protocol import Protocol, with_cost
from orchestration.studies.score.score_rows import delay_margin_of
from orchestration.studies.score.tune_problem import (
    LARGEST,
    change_at_half_the_step,
    cost_of_options,
    costs,
    delayed,
    halved,
    mean_of_worst,
    practice_cases,
    problem_of,
    run_cost,
    step_of,
)


@pytest.mark.parametrize(("share", "mean"), [(1.0, 5.5), (0.2, 9.5), (0.25, 9.0), (0.01, 10.0)])
def test_the_mean_of_the_worst_is_cvar(share: float, mean: float) -> None:
    """Of 1 to 10 in any order: the largest 10, 2, 3 and 1."""
    assert mean_of_worst([3.0, 10.0, 1.0, 2.0, 9.0, 4.0, 8.0, 5.0, 7.0, 6.0], share) == mean


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


@pytest.mark.slow
def test_the_bound_on_the_delay_margin_is_the_margin_that_a_score_measures(protocol: Protocol) -> None:
    """Quiet with the delay at which the scan still is, not with that at which it no longer is."""
    nominal, unrest = protocol.nominal, list[float]()
    with ClosedLoop(tuned(protocol, "l1-pi"), protocol) as loop:
        scenario = replace(loop.scenario(nominal), experiment=loop.experiment(nominal))
        with HoldRuns(scenario, last_part("plant.depth", nominal.target.window[1])) as runs:
            measured = scan(runs, LoopSignal.MEASUREMENT, only_first_loss=True)
        assert delay_margin_of(loop, nominal) == measured.margin
    for bound in (measured.margin, measured.lost):
        bounded = with_cost(protocol, {"bounds": {"delay_margin": bound}})
        with ClosedLoop(tuned(protocol, "l1-pi"), bounded) as loop:
            unrest.append(next(costs(loop, [{}]))["unrest"])
    assert unrest[0] < QUIET <= unrest[1]


def test_the_cost_over_plants_is_that_of_the_worst(loop: ClosedLoop) -> None:
    over_plants = with_cost(loop.protocol, {"plants": 3})
    with ClosedLoop(loop.controller, over_plants) as other:
        evaluated = next(costs(other, [{}]))
        drawn = plants(over_plants, over_plants.tables.plants.practice_seed, 3)
        errors = [other.metrics(plant)["rmse"] for plant in drawn]
    assert evaluated["error"] == max(errors)  # the worst fifth of three
    assert list(evaluated["metrics"]) == ["plant-0", "plant-1", "plant-2"]
    assert problem_of(loop.controller, over_plants).tuned != problem_of(loop.controller, loop.protocol).tuned


def test_any_metric_bounds_the_cost(loop: ClosedLoop) -> None:
    """What is beyond costs ten times the excess, and the other bounds stay."""
    free = next(costs(loop, [{}]))
    peak = loop.metrics(loop.protocol.nominal)["peak_voltage"]
    bounded = with_cost(loop.protocol, cost_of_options([f"peak_voltage={peak / 2.0}"], "nominal"))
    assert set(bounded.tables.cost.bounds) == {"overshoot", "total_variation", "delay_margin", "peak_voltage"}
    with ClosedLoop(loop.controller, bounded) as other:
        evaluated = next(costs(other, [{}]))
    assert evaluated["cost"] == pytest.approx(evaluated["error"] + 10.0)  # twice its bound
    assert evaluated["error"] == free["metrics"]["nominal"]["rmse"]


@pytest.mark.parametrize("name", ["rmse", "depth=0.8", "a=b=c"])
def test_the_name_of_a_metric_may_have_an_equals_sign(name: str) -> None:
    assert cost_of_options([f"{name} = -2.5"], "") == {"bounds": {name: -2.5}}


@pytest.mark.parametrize(
    ("bound", "cases", "count", "message"),
    [
        ("rms=1", "", 0, "cost.bounds.rms = 'rms'; nearest is 'rmse'"),
        ("overshoot=nan", "", 0, "overshoot"),
        ("overshoot=0", "", 0, "overshoot"),
        ("overshoot=4", "nominol", 0, "'nominol'; nearest is 'nominal'"),
        ("overshoot=4", "", -1, "plants"),
    ],
)
def test_a_cost_that_the_protocol_cannot_have_is_refused(
    protocol: Protocol, bound: str, cases: str, count: int, message: str
) -> None:
    with pytest.raises(ScenarioError, match=message):
        with_cost(protocol, cost_of_options([bound], cases, count))


def test_a_controller_runs_at_its_step_and_half_of_it_is_compared(protocol: Protocol) -> None:
    controller = built_in(protocol, "pid")
    half = halved(controller, protocol)
    assert (step_of(controller, protocol), half.step) == (0.02, 0.01)
    evaluated = []
    for one in (controller, half):
        with ClosedLoop(one, protocol) as loop:
            evaluated.append(next(costs(loop, [{}]))["error"])
            assert loop.experiment(protocol.nominal).step_size == step_of(one, protocol)
            assert loop.run(protocol.nominal).time[1] == pytest.approx(0.02)  # judged at the same points
    change = change_at_half_the_step({}, controller, protocol)
    assert change == pytest.approx(evaluated[1] / evaluated[0] - 1.0)
    assert change != 0.0


def test_a_case_can_be_delayed_besides_its_own_faults(protocol: Protocol) -> None:
    nominal = protocol.cases["nominal"]
    frozen = {"input": "controller.measured_depth", "kind": "freeze", "start": 1.0, "end": 2.0}
    late = delayed(replace(nominal, layer={**nominal.layer, "faults": [frozen]}), 0.1, "controller.y")
    assert late.layer["faults"] == [
        frozen,
        {"input": "controller.y", "kind": "interpolated-delay", "delay": 0.1},
    ]
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

"""Margins measured through FMUs: against the closed form of a sampled loop, and on the vehicle."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from orchestration.errors import ScenarioError
from orchestration.many.local_runs import LocalRuns
from orchestration.many.run_many import Make, in_order
from orchestration.scenarios import scenario
from orchestration.scenarios.scenario import Scenario
from orchestration.studies.margins.fmu_margins import DELAYS, GAINS, Scan, run_metrics, scan
from orchestration.studies.margins.hold import Hold, HoldRuns, LoopSignal, hold_of, loop_inputs
from orchestration.system.experiment import Experiment
from orchestration.system.faults import Offset
from orchestration.system.system import System

STEP, GAIN = 0.05, 1.0  # s, 1/s
HOLD = Hold("plant.y[1]", 300.0, 400.0)
WIDE = replace(DELAYS, largest=3.0, step=0.2)
# x(0) such that a mode that neither grows nor decays has a standard deviation of about 3 mm, so that a run is
# quiet below the margin and is not above, however slowly it grows there
INITIAL = math.sqrt(2.0) * 3e-3


@pytest.fixture
def integrator(linear: Callable[..., Path]) -> Scenario:
    """x' = u and u = -x, each an FMU."""
    plant = linear(a=0.0, b=(1.0,), initial_state=INITIAL)
    controller = linear(b=(0.0,), c=(0.0,), d=((-GAIN,),))
    system = System(
        {"plant": plant, "controller": controller},
        (("plant.y[1]", "controller.u[1]"), ("controller.y[1]", "plant.u[1]")),
    )
    return Scenario("integrator", "", system, Experiment(400.0, STEP), {})


@pytest.fixture(scope="module")
def make() -> Iterator[Make]:
    """Makes the runs of all tests in one process."""
    with LocalRuns(1) as place:
        yield partial(in_order, place)


Scanned = Callable[..., Scan]


@pytest.fixture
def scanned(make: Make) -> Scanned:
    """Scans a scenario."""

    def scan_it(chosen: Scenario, *arguments: Any, hold: Hold | None = HOLD, **options: Any) -> Scan:
        with HoldRuns(chosen, hold, make) as runs:
            return scan(runs, *arguments, **options)

    return scan_it


def sampled_gain_limit(steps: int) -> float:
    """The K at which x[n+1] = x[n] - K x[n - steps] is lost: Levin and May (1976)."""
    return 2.0 * math.sin(0.5 * math.pi / (2 * steps + 1))


def test_the_gain_margin_of_a_sampled_integrator_is_that_of_its_difference_equation(
    integrator: Scenario, scanned: Scanned
) -> None:
    """With Jacobi the control is a step old: x[n+1] = x[n] - g h x[n-1], lost at g h = 1."""
    grid = replace(GAINS, largest=30.0, step=1.5, resolution=1.001)
    measured = scanned(integrator, LoopSignal.CONTROL, grid)
    expected = sampled_gain_limit(1) / (GAIN * STEP)
    assert measured.margin == pytest.approx(expected, rel=0.003)  # the initial value excites other modes too
    assert measured.margin < measured.lost <= 1.001 * measured.margin


@pytest.mark.parametrize("loop_signal", list(LoopSignal))
def test_the_delay_margin_of_a_sampled_integrator_is_that_of_its_difference_equation(
    integrator: Scenario, scanned: Scanned, loop_signal: LoopSignal
) -> None:
    """Lost between m and m + 1 steps, where K = h lies between the limits of both, linear in between."""
    steps = next(m for m in range(1, 100) if sampled_gain_limit(m + 1) < GAIN * STEP)
    above, below = sampled_gain_limit(steps), sampled_gain_limit(steps + 1)
    part = (above - GAIN * STEP) / (above - below)
    measured = scanned(integrator, loop_signal, WIDE)
    assert measured.margin == pytest.approx((steps - 1 + part) * STEP, abs=2e-3)
    assert measured.margin < measured.lost <= measured.margin + 1e-3
    continuous = 0.5 * math.pi / GAIN
    assert measured.margin == pytest.approx(continuous - 1.5 * STEP, abs=2e-3)
    assert measured.quiet_again == ()


def test_a_scan_can_end_at_the_first_loss(integrator: Scenario, scanned: Scanned) -> None:
    grid = replace(WIDE, resolution=0.05)
    first, complete = (
        scanned(integrator, LoopSignal.MEASUREMENT, grid, only_first_loss=is_first)
        for is_first in (True, False)
    )
    assert (first.margin, first.lost) == (complete.margin, complete.lost)
    assert first.runs < complete.runs == 16 + 2


def test_a_scenario_that_is_not_quiet_has_no_margin(
    integrator: Scenario, scanned: Scanned, make: Make
) -> None:
    unstable = replace(integrator, experiment=replace(integrator.experiment, parameters={"plant.a": 1.1}))
    grid = replace(DELAYS, largest=1.0, step=0.5)
    measured = scanned(unstable, LoopSignal.MEASUREMENT, grid)
    assert math.isnan(measured.margin)
    assert measured.lost == 0.0
    with HoldRuns(unstable, HOLD, make) as runs:
        first = next(run_metrics(runs, lambda: None))
        expected = f"standard deviation {runs.deviation:.3g}, limit {HOLD.quiet:g}"
    assert first.shown == "none"
    assert first.remark.startswith(f"not quiet without a change; the scenario as it is: {expected}")


def test_a_hold_somewhere_else_is_not_quiet(integrator: Scenario, make: Make) -> None:
    """A biased measurement moves the mean by as much, without any unrest."""
    with HoldRuns(integrator, HOLD, make) as runs:
        for bias, is_quiet in ((0.03, True), (-0.03, True), (0.05, False), (-0.05, False)):
            assert runs.is_quiet(("controller.u[1]",), Offset(bias)) is is_quiet, bias


@pytest.mark.parametrize(("quiet", "lost"), [(2.0, 2.4), (0.5, 0.4), (1.0, 1.2), (1.0, 1.0 / 1.2)])
def test_a_first_loss_is_enclosed_on_either_side_of_1(quiet: float, lost: float) -> None:
    """By ratios, down to the resolution."""
    assert GAINS.is_apart(quiet, lost)
    assert not GAINS.is_apart(quiet, quiet * (1.005 if lost > quiet else 1.0 / 1.005))
    assert GAINS.middle(quiet, lost) == pytest.approx(math.sqrt(quiet * lost))


def test_factors_of_a_scan_are_at_most_a_step_apart() -> None:
    up, down = (replace(GAINS, largest=largest).values() for largest in (10.0, 0.1))
    assert max(b / a for a, b in pairwise(up)) <= GAINS.step
    assert down == pytest.approx([1.0 / factor for factor in up], rel=1e-12)
    assert replace(GAINS, largest=0.25, step=2.0).values() == pytest.approx([1.0, 0.5, 0.25], rel=1e-12)


def test_nothing_lost_is_infinite(integrator: Scenario, scanned: Scanned) -> None:
    grid = replace(DELAYS, largest=0.4, step=0.2)
    measured = scanned(integrator, LoopSignal.MEASUREMENT, grid)
    assert (measured.margin, measured.lost) == (0.4, math.inf)


def test_a_scenario_without_a_reference_needs_a_hold(integrator: Scenario) -> None:
    with pytest.raises(ScenarioError, match="no metric compares a signal with a reference"):
        hold_of(integrator)


def test_a_component_without_a_loop_is_refused(integrator: Scenario, scanned: Scanned) -> None:
    open_loop = replace(
        integrator,
        system=System(integrator.system.components, integrator.system.connections[:1]),
        experiment=replace(integrator.experiment, inputs={"plant.u[1]": 0.0}),
    )
    with pytest.raises(ScenarioError, match="no connection of a loop through plant"):
        scanned(open_loop, LoopSignal.MEASUREMENT)


def test_the_hold_at_a_constant_input_is_the_last_part_of_the_run(integrator: Scenario) -> None:
    later = replace(integrator.experiment, start_time=-100.0, inputs={"a.r": 1.0})
    compared = {"error": {"function": "rmse", "signal": "plant.y[1]", "reference": "a.r"}}
    chosen = replace(integrator, experiment=later, metrics=compared)
    assert hold_of(chosen) == Hold("plant.y[1]", 200.0, 400.0)


def test_the_hold_of_the_vehicle_is_the_last_part_of_its_longest_constant_reference() -> None:
    chosen = scenario.load(scenario.find("nominal-extended"))
    assert hold_of(chosen) == Hold("plant.depth", 100.0, 140.0)
    with pytest.raises(ScenarioError, match=r"controller\.reference is never constant"):
        hold_of(scenario.load(scenario.find("example-l1")))


def test_control_and_measurement_of_the_vehicle_are_what_enters_and_leaves_it(make: Make) -> None:
    with HoldRuns(scenario.load(scenario.find("nominal-extended")), make=make) as runs:
        of_control, of_measurement = (
            loop_inputs(runs.prepared, "plant.depth", signal)
            for signal in (LoopSignal.CONTROL, LoopSignal.MEASUREMENT)
        )
    assert of_control == ("plant.voltage[1]", "plant.voltage[2]")
    assert of_measurement == ("controller.measured_depth", "controller.measured_depth_rate")


@pytest.mark.slow
def test_the_vehicle_bears_what_its_linear_loop_does_less_its_sampling(scanned: Scanned) -> None:
    """With the true state: 0.4133 s in continuous time, less a step by Jacobi and half a one by the hold.

    The law's own step costs less than another half. docs/explanation/margins.md has the figures.
    """
    ideal = scenario.load(scenario.find("nominal-extended-ideal"))
    measured = scanned(ideal, LoopSignal.CONTROL, hold=None)
    assert 0.4133 - 2.0 * 0.02 < measured.margin < 0.4133 - 1.5 * 0.02

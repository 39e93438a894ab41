"""The loop of each controller of the score at its tuned gains against a second program.

Their estimates and filters are fast, and both programs take steps of first order there: what is apart at half
the step of the tuning by more than 0.5 % is less at a quarter of it (docs/explanation/disturbances.md).
"""

from dataclasses import replace

import numpy as np
import pytest

from orchestration.run import simulate
from orchestration.scenarios.scenario import Scenario
from orchestration.studies.score.closed_loop import ClosedLoop, Controller, tuned
from orchestration.studies.score.protocol import read_protocol
from tests.closed_loop.same_experiment import SMOOTH, figures
from tests.closed_loop.second_laws import LAWS
from tests.closed_loop.second_loop import run
from tests.closed_loop.second_program import LawStep, sampled
from tests.closed_loop.shipped_case import shipped_case

PROTOCOL = read_protocol()
STOP = 140.0  # s, when the reference leaves its first depth
NEAR, LARGEST = 0.005, 0.03  # of the RMSE
STABLE = 2.0  # rad of a filter in a step, which the second program takes by Runge and Kutta: up to 2.8


def nominal(controller: Controller, step: float) -> Scenario:
    """The dive of the nominal case of the protocol without noise, at a communication step [s]."""
    steps = {"plant.internal_step": step}
    given = {**controller.parameters, "internal_step": step}
    case = PROTOCOL.nominal
    stated = {**case.layer.get("parameters", {}), **SMOOTH, **steps}
    layer = {**case.layer, "experiment": {"stop_time": STOP, "step_size": step}, "parameters": stated}
    with ClosedLoop(replace(controller, parameters=given, step=step), PROTOCOL) as loop:
        case = replace(case, layer=layer)
        return replace(loop.scenario(case), experiment=loop.experiment(case))


def second(loaded: Scenario, controller: Controller, step: float) -> dict[str, np.ndarray]:
    """By the second program of the law."""
    case = shipped_case(loaded)
    if controller.fmu not in LAWS:
        return sampled(case, step, LawStep.BETWEEN_MEASUREMENTS)
    if not controller.reference_rates:
        case = replace(case, reference_rate=lambda t: 0.0)
    return run(case, step, LAWS[controller.fmu](case, step))


def apart(controller: Controller, step: float) -> float:
    """Relative difference of the RMSE of both programs, which settle at the same time."""
    loaded = nominal(controller, step)
    own, other = simulate(loaded.system, loaded.experiment), second(loaded, controller, step)
    ours = figures(own.time, own["plant.depth"], own["controller.depth_reference"])
    theirs = figures(other["time"], other["depth"], other["reference"])
    assert ours[1] == pytest.approx(theirs[1], abs=0.05)
    return abs(ours[0] / theirs[0] - 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", PROTOCOL.controllers)
def test_a_second_program_gives_the_figures_of_the_tuned_gains(scenario_fmus: None, name: str) -> None:
    controller = tuned(PROTOCOL, name)
    step = 0.5 * controller.step
    while step * float(controller.parameters.get("filter_bandwidth", 0.0)) > STABLE:
        step *= 0.5
    difference = apart(controller, step)
    assert difference < LARGEST
    assert difference < NEAR or apart(controller, 0.5 * step) < 0.7 * difference

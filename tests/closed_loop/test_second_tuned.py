"""The loop of each controller of the score at its tuned gains against a second program, at half the step.

Their estimates and filters are fast: at the step of the score, 20 ms, an explicit step of MRAC's estimates
leaves 0.9 %, and a filter that turns 1.5 rad in a step 1.3 % (docs/explanation/disturbances.md).
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from orchestration.run import simulate
from orchestration.scenarios.scenario import Scenario
from orchestration.score.closed_loop import ClosedLoop, Controller, tuned
from orchestration.score.protocol import read_protocol
from tests.closed_loop.same_experiment import SMOOTH
from tests.closed_loop.second_laws import LAWS
from tests.closed_loop.second_loop import run
from tests.closed_loop.second_program import LawStep, sampled
from tests.closed_loop.shipped_case import shipped_case

PROTOCOL = read_protocol()
STEP, STOP = 0.01, 140.0  # s: of communication; when the reference leaves its first depth


def nominal(controller: Controller) -> Scenario:
    """The dive of the nominal case of the protocol without noise, at half its step."""
    steps = {"plant.internal_step": STEP}
    given = {**controller.parameters, "internal_step": STEP}
    case = PROTOCOL.nominal
    layer = {**case.layer, "experiment": {"stop_time": STOP, "step_size": STEP}}
    with ClosedLoop(replace(controller, parameters=given, settings=SMOOTH | steps), PROTOCOL) as loop:
        case = replace(case, layer=layer)
        return replace(loop.scenario(case), experiment=loop.experiment(case))


def second(loaded: Scenario, controller: Controller) -> dict[str, np.ndarray]:
    """By the second program of the law."""
    case = shipped_case(loaded)
    if controller.fmu not in LAWS:
        return sampled(case, STEP, LawStep.BETWEEN_MEASUREMENTS)
    if not controller.reference_rates:
        case = replace(case, reference_rate=lambda t: 0.0)
    return run(case, STEP, LAWS[controller.fmu](case, STEP))


def figures(time: np.ndarray, depth: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """RMSE [m], and settling time [s] to 5 % of 0.8 m."""
    outside = time[abs(depth - 0.8) > 0.04]
    return math.sqrt(np.mean((depth - reference) ** 2)), float(outside[-1])


@pytest.mark.slow
@pytest.mark.parametrize("name", PROTOCOL.controllers)
def test_a_second_program_gives_the_figures_of_the_tuned_gains(scenario_fmus: None, name: str) -> None:
    controller = tuned(PROTOCOL, name)
    loaded = nominal(controller)
    own = simulate(loaded.system, loaded.experiment)
    ours = figures(own.time, own["plant.depth"], own["controller.depth_reference"])
    other = second(loaded, controller)
    theirs = figures(other["time"], other["depth"], other["reference"])
    assert ours == (pytest.approx(theirs[0], rel=5e-3), pytest.approx(theirs[1], abs=0.05))

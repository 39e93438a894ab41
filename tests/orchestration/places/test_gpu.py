"""Runs on the GPU of this machine agree with those of the processor: `pytest -m gpu` where there is one."""

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from orchestration import load_scenario
from orchestration.gym import FmuVectorEnv, task_of
from orchestration.many.places import place_of
from orchestration.results.recording import on_host
from orchestration.sweep import table
from orchestration.sweep.plan import plan
from orchestration.sweep.run import sweep

pytestmark = [pytest.mark.gpu, pytest.mark.usefixtures("vehicle_fmus")]
BOUNDS = dict.fromkeys(("plant.voltage[1]", "plant.voltage[2]"), (-6.0, 6.0))


def test_a_sweep_has_the_metrics_of_the_processor(tmp_path: Path) -> None:
    """To 1e-12: elementary functions differ in the last place.

    The settling time is a communication point, which changes by one where a comparison falls otherwise.
    The lag is the least of sums that a Fourier transform of 2^15 points gives. Each side rounds sums of
    1268 m2 in 15 stages, and divides them by the changes of the reference, 4.1e-4 m2. Half of a step of
    0.02 s times 15 * 2^-52 * 1268 / 4.1e-4 is 1e-10 s.
    """
    scenario = load_scenario("monte-carlo")
    planned = plan(replace(scenario, sweep={**scenario.sweep, "samples": 10_000}))
    here, there = (
        table.read(sweep(planned, tmp_path / where, place_of(where)))[0] for where in ("vectors", "gpu")
    )
    assert here["sample"].equals(there["sample"])
    for name in ("rmse", "holding_thrust", "control_effort", "total_variation"):
        np.testing.assert_allclose(there[name], here[name], rtol=1e-12, err_msg=name)
    np.testing.assert_allclose(there["lag"], here["lag"], rtol=0.0, atol=2e-10)
    apart = np.abs(there["settling_time"].to_numpy() - here["settling_time"].to_numpy())
    assert np.mean(apart > 1e-9) < 1e-3


def test_environments_have_the_observations_and_rewards_of_the_processor() -> None:
    task = task_of("nominal-extended", {"rmse": -1.0}, bounds=BOUNDS)
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, (50, 1000, 2))
    with (
        closing(FmuVectorEnv(task, 1000, where="vectors")) as here,
        closing(FmuVectorEnv(task, 1000, where="gpu")) as there,
    ):
        observations = here.reset(seed=7)[0], there.reset(seed=7)[0]
        np.testing.assert_allclose(on_host(observations[1]), observations[0], rtol=1e-12, atol=1e-15)
        for action in actions:
            expected, found = here.step(action), there.step(action)
            for one, other in zip(expected[:2], found[:2], strict=True):
                np.testing.assert_allclose(on_host(other), one, rtol=1e-12, atol=1e-15)

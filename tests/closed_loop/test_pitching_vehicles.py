"""Depth controllers on vehicles in heave and pitch: what unequal thrusters do to them.

The numbers stand in docs/explanation/disturbances.md.
"""

import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from orchestration.results import metrics
from orchestration.run import simulate
from orchestration.scenarios import scenario
from orchestration.score.closed_loop import ClosedLoop, tuned
from orchestration.score.protocol import read_protocol
from orchestration.score.vehicle import Vehicle
from plant_fmu.thruster import T200_FORCE, T200_VOLTAGE

pytestmark = pytest.mark.usefixtures("scenario_fmus")
# 10 % less than the aft one; of another gain, the controller would be told
WEAK_FORE = {"plant.thruster_efficiency[1]": 0.9}
LITTLE_DAMPING = {"plant.pitch_linear_damping": 0.005}  # a damping ratio of 0.04 in place of 0.16


def rmse(controller: str, settings: Mapping[str, float] = {}) -> float:
    """Returns the RMSE [cm] of the nominal case with tuned gains on RovHeavePitchPlant."""
    protocol = read_protocol(vehicle=Vehicle.of("RovHeavePitchPlant", settings=settings))
    with ClosedLoop(tuned(protocol, controller), protocol) as loop:
        return loop.metrics(protocol.nominal, names=["rmse"])["rmse"]


@pytest.mark.parametrize("controller", ["pid", "l1-pi", "adrc"])
def test_thrusters_that_differ_by_10_percent_cost_a_millimetre(controller: str) -> None:
    equal, unequal = rmse(controller), rmse(controller, WEAK_FORE)
    assert equal < unequal < equal + 0.15


@pytest.mark.parametrize(("controller", "least"), [("l1", 2.0), ("super-twisting", 2.0)])
def test_with_little_damping_of_pitch_fast_controllers_oscillate(controller: str, least: float) -> None:
    """The sensor at the bow rises where both thrusters push down, as the fore one is weaker."""
    assert rmse(controller, WEAK_FORE | LITTLE_DAMPING) > least


@pytest.mark.parametrize("controller", ["adrc", "sliding-mode", "mrac"])
def test_with_little_damping_of_pitch_slower_ones_do_not(controller: str) -> None:
    assert rmse(controller, WEAK_FORE | LITTLE_DAMPING) < 0.5


def nominal(settings: Mapping[str, object]) -> dict[str, float]:
    """Returns the metrics of the nominal scenario of BlueRov2Plant with a PID controller at 1 rad/s."""
    gains = {"controller.kp": 96.5, "controller.ki": 32.2, "controller.kd": 63.5}
    given = {"plant": "BlueRov2Plant", "controller": "PidDepthController", **gains, **settings}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        loaded = scenario.load(scenario.find("nominal-extended"), settings=given)
    recording = simulate(loaded.system, loaded.experiment)
    return metrics.evaluate(recording, loaded.metrics)


def test_the_inverse_of_the_table_follows_the_trajectory_on_the_edge_of_the_dead_band(
    built: Mapping[str, Path],
) -> None:
    """Without the inverse: a linear allocation with the same force at 12 V, 6.65 N/V a pair."""
    assert built["PidDepthController"].is_file()
    line: dict[str, object] = {f"controller.thruster_gain[{i}]": 6.65 for i in (1, 2)}
    inverse, linear = nominal({}), nominal(line | {"controller.thruster_tabulated": False})
    assert inverse["rmse"] < 0.15
    assert linear["rmse"] > 2.0 * inverse["rmse"]


def test_a_score_tells_the_table_and_computes_the_force_by_it() -> None:
    """Both pairs of two thrusters have one voltage, whose sign is that of the force."""
    protocol = read_protocol(vehicle=Vehicle.of("BlueRov2Plant"))
    with ClosedLoop(tuned(protocol, "pid"), protocol) as loop:
        given = loop.experiment(protocol.nominal).parameters
        signals = loop.run(protocol.nominal)
        numbers = loop.metrics(protocol.nominal, names=["total_variation", "effort"])
    assert [given[f"controller.thruster_table_force[{i}]"] for i in range(1, 25)] == [*T200_FORCE]
    u, size = signals["u"], np.minimum(signals["voltage"], 12.0)
    down, up = (4.0 * np.interp(voltage, T200_VOLTAGE, T200_FORCE) for voltage in (size, -size))
    # rounding of 206 N
    np.testing.assert_allclose(u, np.where(u < 0.0, up, down), atol=1e-12)
    assert numbers["total_variation"] == pytest.approx(np.abs(np.diff(u)).sum(), rel=1e-9)
    assert numbers["effort"] > 0.0

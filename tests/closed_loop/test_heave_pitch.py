"""The controller of both axes on the vehicle that pitches, beside the controller of the depth alone."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from orchestration.results.recording import Recording
from orchestration.run import simulate
from orchestration.scenarios import scenario
from orchestration.system.faults import Fault, Scale

pytestmark = pytest.mark.usefixtures("scenario_fmus")
STEADY = slice(5000, 7000)  # 100 s to 140 s, where the depth is held
NET, GAP, ARM = 1.2, 0.9, 0.06  # N of buoyancy; aft thruster over fore one; m
RIGHTING = 29.43 * 0.005  # N.m/rad: weight and metacentric height of RovHeavePitchPlant


@cache
def recording(controller: str, efficiency: float = GAP) -> Recording:
    settings = {"controller": controller, "plant.thruster_efficiency[2]": efficiency}
    chosen = scenario.load(scenario.find("heave-pitch"), settings=settings)
    return simulate(chosen.system, chosen.experiment)


def rmse(run: Recording) -> float:
    """In cm."""
    return 100.0 * float(np.sqrt(np.mean((run["plant.depth"] - run["controller.depth_reference"]) ** 2)))


def test_unequal_thrusters_turn_a_vehicle_whose_depth_alone_is_controlled() -> None:
    """The trim that follows from equal demands: fore F / 1.9, aft 0.9 F / 1.9."""
    moment = -ARM * NET * (1.0 - GAP) / (1.0 + GAP)
    pitch = recording("L1DepthController")["plant.pitch"][STEADY].mean()
    # thrust varies by some per cent about the net buoyancy
    assert pitch == pytest.approx(moment / RIGHTING, rel=0.02)


def test_the_controller_of_both_axes_holds_the_pitch_and_follows_the_depth_better() -> None:
    both, alone = recording("L1HeavePitchController"), recording("L1DepthController")
    # a hundredth of the trim of the other, 0.026 rad
    assert abs(both["plant.pitch"][STEADY].mean()) < 2.6e-4
    # noise of 2 mrad in the measured pitch leaves about as much
    assert both["plant.pitch"][STEADY].std() < 2e-3
    assert rmse(both) < rmse(alone) - 0.02


def test_it_learns_the_moment_that_makes_the_thrusters_equal() -> None:
    """F / 2 - m = 0.9 (F / 2 + m), both of half the net buoyancy."""
    couple = NET * (1.0 / GAP - 1.0) / 4.0
    run = recording("L1HeavePitchController")
    moment = 2.0 * ARM * couple
    assert run["controller.demanded_moment"][STEADY].mean() == pytest.approx(moment, rel=0.02)
    # by the adaptive control, since k_m x is 0 of a level vehicle
    assert run["controller.pitch_u_a"][STEADY].mean() == pytest.approx(moment, rel=0.05)
    assert run["controller.pitch_sigma_hat"][STEADY].mean() == pytest.approx(-moment, rel=0.1)


def test_with_equal_thrusters_the_depth_is_followed_as_by_the_controller_of_the_depth() -> None:
    both, alone = (recording(name, 1.0) for name in ("L1HeavePitchController", "L1DepthController"))
    # the sensor is 8 cm forward: 2 mrad of pitch are 0.16 mm of depth
    np.testing.assert_allclose(both["plant.depth"], alone["plant.depth"], atol=2e-3)
    assert rmse(both) == pytest.approx(rmse(alone), abs=2e-3)


def test_by_measured_rates_the_law_gets_that_of_the_pitch_too() -> None:
    """The law gets the true rate of both axes."""
    name = scenario.find("heave-pitch")
    loaded = scenario.load(name, settings={"controller.velocity_source": "measured"})
    record = ("controller.estimated_pitch_rate", "plant.pitch_rate")
    run = simulate(loaded.system, replace(loaded.experiment, stop_time=10.0, record=record))
    taken, true = run["controller.estimated_pitch_rate"], run["plant.pitch_rate"]
    # Jacobi: an output follows from the inputs of the point before
    np.testing.assert_array_equal(taken[1:], true[:-1])


def test_without_the_measured_rate_of_the_pitch_the_observer_is_as_it_was() -> None:
    """The connection counts where rates are measured: without it the pitch moves by 42 % more there."""
    sizes, pitches = dict[str, float](), list[np.ndarray]()
    for source in ("measured", "alpha_beta_observer"):
        loaded = scenario.load(scenario.find("heave-pitch"), settings={"controller.velocity_source": source})
        cut = (Fault("controller.measured_pitch_rate", Scale(0.0)),)
        pitches = [
            simulate(loaded.system, replace(loaded.experiment, faults=faults, record=("plant.pitch",)))[
                "plant.pitch"
            ]
            for faults in ((), cut)
        ]
        sizes[source] = float(np.sqrt(np.mean(pitches[1] ** 2) / np.mean(pitches[0] ** 2)))
    assert sizes["measured"] == pytest.approx(1.42, abs=5e-3)
    np.testing.assert_array_equal(pitches[0], pitches[1])

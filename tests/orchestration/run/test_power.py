"""The energy that exchanging at communication points creates, beside the energy of the system."""

from typing import Any

import numpy as np
import pytest

from orchestration.errors import ScenarioError
from orchestration.results import metrics
from orchestration.results.power import energy_residuals
from orchestration.results.recording import Recording
from orchestration.run import simulate
from orchestration.system.experiment import Algorithm, Event, Experiment
from orchestration.system.faults import Delay, Fault
from orchestration.system.system import System
from tests.shared_builds import Build

FORCE, VELOCITY = "spring.y[1]", "mass.y[1]"
RESIDUAL = {"function": "energy_residual", "signal": FORCE, "flow": VELOCITY}
STIFFNESS, MASS, DAMPING = 2.0, 0.5, 0.3  # N/m, kg, N.s/m


def run(linear: Build, damping: float, step: float, spring_first: bool = False, **settings: Any) -> Recording:
    """m v' = -F - c v and F' = k v, from 1 m/s: the spring pulls the mass, which pulls the spring."""
    mass = linear(a=-damping / MASS, b=(-1.0 / MASS,), initial_state=1.0)
    spring = linear(a=0.0, b=(STIFFNESS,), initial_state=0.0)
    fmus = {"spring": spring, "mass": mass} if spring_first else {"mass": mass, "spring": spring}
    system = System(fmus, [(FORCE, "mass.u[1]"), (VELOCITY, "spring.u[1]")])
    return simulate(system, Experiment(2.0, step, **settings))


def energy(recording: Recording) -> np.ndarray:
    """Of the mass and the spring [J]: m v^2 / 2 + F^2 / (2 k)."""
    return 0.5 * MASS * recording[VELOCITY] ** 2 + 0.5 * recording[FORCE] ** 2 / STIFFNESS


def test_it_takes_the_reduced_slopes_of_a_step_after_a_short_one(linear: Build) -> None:
    """An integrator's output tells the mean of the line that it was given, and so the end of that line."""
    integrator = {"a": 0.0, "interpolates_inputs": True}
    mass = linear(b=(-1.0 / MASS,), initial_state=1.0, **integrator)
    spring = linear(b=(STIFFNESS,), initial_state=0.0, **integrator)
    system = System({"mass": mass, "spring": spring}, [(FORCE, "mass.u[1]"), (VELOCITY, "spring.u[1]")])
    events = [Event(0.505, {"mass.a": 0.0})]
    recording = simulate(system, Experiment(1.0, 0.1, extrapolation=1, events=events))
    size, f, v = np.diff(recording.time), recording[FORCE], recording[VELOCITY]
    assert size[5:7] == pytest.approx([0.005, 0.095])
    of_force, of_velocity = -MASS * np.diff(v) / size, np.diff(f) / size / STIFFNESS  # means
    given = [(f[:-1], 2.0 * of_force - f[:-1]), (v[:-1], 2.0 * of_velocity - v[:-1])]
    work, other = (
        (2.0 * (a * c + b * d) + a * d + b * c) / 6.0
        for (a, b), (c, d) in zip(given, [(v[:-1], v[1:]), (f[:-1], f[1:])], strict=True)
    )
    # rounding of differences of 1 over 5 ms
    assert energy_residuals(recording, FORCE, VELOCITY) == pytest.approx(size * (work - other), abs=1e-13)


@pytest.mark.parametrize("spring_first", [True, False])
@pytest.mark.parametrize("algorithm", list(Algorithm))
def test_the_residual_is_the_energy_that_a_lossless_system_gains(
    linear: Build, algorithm: Algorithm, spring_first: bool
) -> None:
    """Force and velocity are lines where the other is held: the integrals are exact, and so is the sum.

    The spring draws F v from the mass: what the exchange creates enters with the sign of -F.
    """
    recording = run(linear, 0.0, 0.05, spring_first, algorithm=algorithm)
    gained = np.diff(energy(recording))
    assert np.abs(gained).max() > 1e-4
    assert -energy_residuals(recording, FORCE, VELOCITY) == pytest.approx(gained, abs=1e-14)


def test_what_a_damper_takes_is_no_residual(linear: Build) -> None:
    """Energy falls by the damper's work, c v^2 in time, and rises by the residual; lines bring h^2."""
    recording = run(linear, DAMPING, 0.005)
    gained = energy(recording)[-1] - energy(recording)[0]
    dissipated = DAMPING * np.trapezoid(recording[VELOCITY] ** 2, recording.time)
    created = -metrics.evaluate(recording, {"residual": RESIDUAL})["residual"]
    assert created > 5e-3
    assert gained + dissipated == pytest.approx(created, abs=1e-5)


@pytest.mark.parametrize("algorithm", list(Algorithm))
def test_the_residual_of_extrapolated_inputs_is_nearly_what_is_gained(
    linear: Build, algorithm: Algorithm
) -> None:
    """Force and velocity then are no lines: what differs is of order h^2, here 0.04 %."""
    recording = run(linear, 0.0, 0.02, algorithm=algorithm, extrapolation=1)
    gained = np.diff(energy(recording))
    assert np.abs(gained + energy_residuals(recording, FORCE, VELOCITY)).max() < 1e-3 * np.abs(gained).max()


def test_extrapolated_inputs_create_less(linear: Build) -> None:
    """Energy of order 2 in the step instead of 1."""

    def created(step: float, order: int) -> float:
        recording = run(linear, 0.0, step, extrapolation=order)
        return abs(energy_residuals(recording, FORCE, VELOCITY).sum())

    assert created(0.02, 0) / created(0.01, 0) == pytest.approx(2.0, rel=0.1)
    assert created(0.02, 1) / created(0.01, 1) > 3.5


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"step_sizes": {"spring": 1.0}}, "steps of one size and without faults, got one with step_sizes_s"),
        ({"faults": (Fault("mass.u[1]", Delay(0.5)),)}, "got one with faults"),
    ],
)
def test_a_run_whose_inputs_are_not_known_between_its_points_has_no_residual(
    linear: Build, settings: dict[str, Any], message: str
) -> None:
    """A component behind a fault is not given the output itself."""
    with pytest.raises(ScenarioError, match=message):
        energy_residuals(run(linear, 0.0, 0.5, **settings), FORCE, VELOCITY)


def test_the_residual_of_a_window_is_that_of_the_steps_within_it(linear: Build) -> None:
    recording = run(linear, 0.0, 0.05)
    residuals = energy_residuals(recording, FORCE, VELOCITY)
    measured = metrics.evaluate(recording, {"residual": RESIDUAL | {"window": [0.5, 1.0]}})
    assert measured["residual"] == pytest.approx(residuals[10:20].sum())

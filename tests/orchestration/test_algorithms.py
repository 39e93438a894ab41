"""Algorithms of the master against solutions in closed form."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from orchestration.errors import SystemDefinitionError
from orchestration.experiment import Algorithm, Event, Experiment
from orchestration.master import simulate
from orchestration.recording import Recording
from orchestration.reference import Cosine
from orchestration.system import System
from tests.orchestration.linear_systems import coupled, solution

Build = Callable[..., Path]
BOTH = list(Algorithm)


def error(recording: Recording, through: float = 0.0) -> float:
    ours = np.column_stack([recording["one.y[1]"], recording["two.y[1]"]])
    return float(np.abs(ours - solution(recording.time, through)).max())


def order(errors: list[float]) -> float:
    """Of convergence, from the errors at a step and at half of it."""
    return math.log2(errors[0] / errors[1])


# Rates of some 1/s, up to 10/s with the algebraic loop: the next order is about 1 % at these steps, or 5 %.
STEPS = (0.01, 0.005)


@pytest.mark.parametrize("algorithm", BOTH)
@pytest.mark.parametrize("through", [0.0, 0.4], ids=["no algebraic loop", "algebraic loop"])
def test_held_inputs_give_first_order(linear: Build, algorithm: Algorithm, through: float) -> None:
    system = coupled(linear, through)
    errors = [error(simulate(system, Experiment(2.0, h, algorithm=algorithm)), through) for h in STEPS]
    assert order(errors) == pytest.approx(1.0, abs=0.1 if through else 0.05)


@pytest.mark.parametrize("algorithm", BOTH)
@pytest.mark.parametrize("interpolates", [True, False], ids=["by the FMU", "at the middle"])
def test_extrapolated_inputs_give_second_order(
    linear: Build, algorithm: Algorithm, interpolates: bool
) -> None:
    system = coupled(linear, interpolates_inputs=interpolates)
    errors = [
        error(simulate(system, Experiment(2.0, h, algorithm=algorithm, extrapolation=1))) for h in STEPS
    ]
    assert order(errors) == pytest.approx(2.0, abs=0.05)
    assert errors[0] < 0.05 * error(simulate(system, Experiment(2.0, STEPS[0], algorithm=algorithm)))


def test_gauss_seidel_interpolates_what_is_known_already(linear: Build) -> None:
    """The second component gets the very line between two outputs of the first: only the first one lags."""
    system = coupled(linear, interpolates_inputs=True)
    jacobi, seidel = (
        error(simulate(system, Experiment(2.0, 0.01, algorithm=a, extrapolation=1))) for a in BOTH
    )
    assert seidel < jacobi


@pytest.mark.parametrize("tolerance", [1e-3, 1e-4])
@pytest.mark.parametrize("extrapolation", [0, 1])
def test_error_control_meets_its_tolerance(linear: Build, tolerance: float, extrapolation: int) -> None:
    """The system forgets errors, so that the sum of those of all steps bounds what is left of them."""
    system = coupled(linear, saves_state=True, interpolates_inputs=True)
    run = simulate(system, Experiment(2.0, 0.5, tolerance=tolerance, extrapolation=extrapolation))
    assert error(run) <= tolerance
    assert run.provenance["steps_between_points"] > 0


def test_error_control_takes_what_it_needs_and_not_more(linear: Build) -> None:
    """Held inputs: half the tolerance needs twice the steps; extrapolated ones: sqrt(2) times."""
    system = coupled(linear, saves_state=True, interpolates_inputs=True)

    def steps(tolerance: float, extrapolation: int) -> int:
        experiment = Experiment(2.0, 2.0, tolerance=tolerance, extrapolation=extrapolation)
        return simulate(system, experiment).provenance["steps_between_points"]

    assert steps(1e-4, 0) / steps(4e-4, 0) == pytest.approx(4.0, rel=0.15)
    assert steps(1e-5, 1) / steps(4e-5, 1) == pytest.approx(2.0, rel=0.15)


def test_error_control_needs_fmus_that_can_go_back(linear: Build) -> None:
    with pytest.raises(
        SystemDefinitionError, match=r"tolerance: one cannot repeat a step .* canGetAndSetFMUstate"
    ):
        simulate(coupled(linear), Experiment(2.0, 0.5, tolerance=1e-3))


def test_signals_are_followed_between_communication_points_if_a_tolerance_asks(linear: Build) -> None:
    """x' = -x + cos t from x = 0: x = (cos t + sin t - e^-t) / 2."""
    system = System({"one": linear(initial_state=0.0, saves_state=True)})
    signals = {"one.u[1]": Cosine(1.0, 1.0)}
    run = simulate(system, Experiment(6.0, 2.0, signals=signals, tolerance=1e-3))
    t = run.time
    assert run["one.y[1]"] == pytest.approx(0.5 * (np.cos(t) + np.sin(t) - np.exp(-t)), abs=1e-3)


@pytest.mark.parametrize("algorithm", BOTH)
@pytest.mark.parametrize("extrapolation", [0, 1])
def test_a_slow_component_keeps_the_order(linear: Build, algorithm: Algorithm, extrapolation: int) -> None:
    system = coupled(linear, interpolates_inputs=True)

    def run(h: float) -> Recording:
        return simulate(
            system,
            Experiment(2.0, h, algorithm=algorithm, extrapolation=extrapolation, step_sizes={"two": 4 * h}),
        )

    def at_common_points(h: float) -> float:
        recording = run(h)
        both = solution(recording.time)
        ours = np.column_stack([recording["one.y[1]"], recording["two.y[1]"]])
        return float(np.abs(ours - both)[::4].max())

    assert order([at_common_points(h) for h in STEPS]) == pytest.approx(1.0 + extrapolation, abs=0.1)
    held = run(0.01)["two.y[1]"][:12].reshape(3, 4)
    assert np.all(held == held[:, :1])
    assert len(set(held[:, 0])) == 3


def test_a_slow_component_takes_the_inputs_of_its_own_points(linear: Build) -> None:
    """Jacobi by hand: x' = -x + u, u = cos t held over four communication steps."""
    system = System({"one": linear(initial_state=0.0)})
    signals = {"one.u[1]": Cosine(1.0, 1.0)}
    run = simulate(system, Experiment(2.0, 0.1, signals=signals, step_sizes={"one": 0.4}))
    x, decay = 0.0, math.exp(-0.4)
    for i, t in enumerate(run.time.tolist()):
        if i and i % 4 == 0:
            x = decay * x + (1.0 - decay) * math.cos(t - 0.4)
        assert run["one.y[1]"][i] == pytest.approx(x, abs=1e-14)


def test_the_last_step_of_a_slow_component_is_shorter(linear: Build) -> None:
    system = System({"one": linear()})
    run = simulate(system, Experiment(1.0, 0.1, inputs={"one.u[1]": 0.0}, step_sizes={"one": 0.3}))
    assert run["one.y[1]"][-2:] == pytest.approx([math.exp(-0.9), math.exp(-1.0)], rel=1e-14)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"step_sizes": {"one": 0.25}}, r"step size of one, 0.25 s: expected a multiple of .* 0.1 s"),
        ({"step_sizes": {"ones": 0.2}}, "step size of 'ones': no such component; nearest is 'one'"),
        ({"step_sizes": {"one": 0.2}, "tolerance": 1e-3}, "tolerance and step_sizes: expected one of them"),
        ({"extrapolation": 2}, "extrapolation = 2: expected order 0 or 1"),
        ({"tolerance": 0.0}, "tolerance = 0.0: expected more than 0"),
    ],
)
def test_settings_that_do_not_fit_are_refused(linear: Build, settings: dict, message: str) -> None:
    with pytest.raises(SystemDefinitionError, match=message):
        simulate(System({"one": linear()}), Experiment(1.0, 0.1, inputs={"one.u[1]": 0.0}, **settings))


def test_an_event_between_communication_points_is_stepped_to(linear: Build) -> None:
    """x' = a x, from a = -1 to a = 0 at 0.25 s: x stands still from then on."""
    event = Event(0.25, {"one.a": 0.0})
    run = simulate(System({"one": linear()}), Experiment(0.5, 0.1, inputs={"one.u[1]": 0.0}, events=(event,)))
    assert run.time == pytest.approx([0.0, 0.1, 0.2, 0.25, 0.3, 0.4, 0.5])
    assert run["one.y[1]"][-1] == pytest.approx(math.exp(-0.25), rel=1e-14)


def test_an_event_waits_for_an_fmu_of_fixed_steps(linear: Build) -> None:
    event = Event(0.25, {"one.a": 0.0})
    system = System({"one": linear(varies_step_size=False)})
    run = simulate(system, Experiment(0.5, 0.1, inputs={"one.u[1]": 0.0}, events=(event,)))
    assert run["one.y[1]"][-1] == pytest.approx(math.exp(-0.3), rel=1e-14)


def test_an_event_waits_for_the_next_point_of_a_slow_component(linear: Build) -> None:
    event = Event(0.1, {"one.a": 0.0})
    experiment = Experiment(0.8, 0.1, inputs={"one.u[1]": 0.0}, events=(event,), step_sizes={"one": 0.4})
    run = simulate(System({"one": linear()}), experiment)
    assert run["one.y[1]"][-1] == pytest.approx(math.exp(-0.4), rel=1e-14)

"""Algorithms of the master against solutions in closed form."""

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestration.errors import OrchestrationError, SystemDefinitionError
from orchestration.results.recording import Recording
from orchestration.run import Simulator, simulate
from orchestration.system.experiment import Algorithm, Event, Experiment
from orchestration.system.signals import Constant, Cosine, Ramps, Table
from orchestration.system.system import System
from tests.described_fmus import members, redescribed
from tests.foreign_fmus import Misdeed
from tests.orchestration.linear_systems import alone, coupled, solution
from tests.shared_builds import Build

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


@pytest.mark.parametrize(("extrapolation", "tolerance"), [(0, 1e-3), (1, 1e-4)])
def test_error_control_meets_its_tolerance(linear: Build, tolerance: float, extrapolation: int) -> None:
    """The system forgets errors, so that the sum of those of all steps bounds what is left of them."""
    system = coupled(linear, saves_state=True, interpolates_inputs=True)
    run = simulate(system, Experiment(2.0, 0.5, tolerance=tolerance, extrapolation=extrapolation))
    assert error(run) <= tolerance
    assert run.provenance["steps_between_points"] > 0


@pytest.mark.parametrize(("extrapolation", "through"), [(0, 0.4), (1, 0.2)])
def test_error_control_lives_with_an_algebraic_loop(
    linear: Build, extrapolation: int, through: float
) -> None:
    """Outputs are late by the last change of the other, which is judged apart: twice the tolerance in all."""
    system = coupled(linear, through, saves_state=True, interpolates_inputs=True)
    run = simulate(system, Experiment(2.0, 0.5, tolerance=1e-2, extrapolation=extrapolation))
    assert error(run, through) <= 2e-2


@pytest.mark.parametrize(
    ("interpolates", "through", "is_stable"),
    [(True, 0.31, True), (True, 0.36, False), (False, 0.47, True), (False, 0.53, False)],
)
def test_extrapolation_carries_an_algebraic_loop_of_small_gain_only(
    linear: Build, interpolates: bool, through: float, is_stable: bool
) -> None:
    """y_k = -g (2 y_k-1 - y_k-2), or with the value at the middle -g (3 y_k-1 - y_k-2) / 2.

    The root of z^2 + 2 g z - g that is farthest out passes -1 at g = 1/3, that of z^2 + 3/2 g z - g/2 at 1/2.
    """
    system = coupled(linear, through, interpolates_inputs=interpolates)
    run = simulate(system, Experiment(2.0, 0.005, extrapolation=1))
    assert (error(run, through) < 0.1) == is_stable


def test_an_output_that_is_no_number_and_goes_nowhere_is_no_matter_of_the_error(rogue: Build) -> None:
    parameters = {"bad.misdeed": int(Misdeed.NAN_OUTPUT), "bad.misdeed_time": 0.5}
    experiment = Experiment(1.0, 0.1, parameters=parameters, inputs={"bad.u": 1.0}, tolerance=1e-3)
    run = simulate(System({"bad": rogue(saves_state=True)}), experiment)
    assert np.isnan(run["bad.y"][-1])
    assert run["bad.y"][4] == pytest.approx(0.4)


def test_a_jump_in_a_short_step_is_no_leap_in_a_long_one(linear: Build) -> None:
    """x' = -x + u, u jumps from 0 to 1: x stays below 1 and, with a slope twice the jump, a little more.

    The step from 0.29999 s to 0.3 s, which an event brings, sees the whole jump.
    """
    jump = Table([0.0, 0.3], [0.0, 1.0], hold=True)
    experiment = Experiment(
        1.0, 0.1, signals={"one.u[1]": jump}, extrapolation=1, events=(Event(0.29999, {"one.a": -1.0}),)
    )
    run = simulate(alone(linear, initial_state=0.0), experiment)
    assert len(run.time) == 12
    assert run["one.y[1]"].min() >= 0.0
    assert run["one.y[1]"].max() < 1.0


@pytest.mark.parametrize("interpolates", [True, False])
def test_what_is_discrete_is_held(foreign: Mapping[str, Path], linear: Build, interpolates: bool) -> None:
    """Integers that go to an FMU which would extrapolate."""
    fmu = linear(passes_discrete=True, interpolates_inputs=interpolates)
    inputs = {"one.u[1]": 0.0, "one.integer_in": 3, "one.boolean_in": True}
    system = System({"one": fmu, "two": fmu}, (("one.integer_out", "two.integer_in"),))
    inputs |= {"two.u[1]": 0.0, "two.boolean_in": False}
    run = simulate(system, Experiment(1.0, 0.1, inputs=inputs, extrapolation=1))
    assert set(run["two.integer_out"][2:]) == {3.0}


@pytest.mark.parametrize(("first", "last"), [(1.0, 0.0), (0.0, 1.0)])
def test_an_input_is_carried_to_the_end_of_its_range_and_no_farther(
    python_built: Mapping[str, Path], first: float, last: float
) -> None:
    """The efficiency of a thruster goes to 0 or 1, and its slope would go on."""
    signals = {"p.thruster_efficiency[1]": Ramps([[0.0, first], [0.5, last]])}
    settings: dict[str, Any] = {"inputs": {"p.voltage[1]": 3.0}, "open_inputs": "start", "extrapolation": 1}
    experiment = Experiment(1.0, 0.02, signals=signals, **settings)
    run = simulate(System({"p": python_built["RovDepthPlant"]}), experiment)
    force = run["p.thruster_force[1]"][run.time >= 0.5]
    assert len(force) == 26
    assert (np.diff(force) * (last - first) >= 0.0).all()  # it goes on as before, and not back


@pytest.mark.parametrize(
    ("start", "settings"), [(-3.0, {}), (36000.0, {}), (1e6, {}), (0.0, {"step_sizes": {"one": 0.5}})]
)
def test_an_fmu_of_fixed_steps_gets_them_wherever_time_begins(
    linear: Build, start: float, settings: dict[str, Any]
) -> None:
    """Far from 0 the difference of two communication points is no longer the step size."""
    experiment = Experiment(start + 1.0, 0.01, start_time=start, inputs={"one.u[1]": 0.0}, **settings)
    run = simulate(alone(linear, varies_step_size=False), experiment)
    assert run["one.y[1]"][-1] == pytest.approx(math.exp(-1.0), rel=1e-12)


def test_error_control_takes_what_it_needs_and_not_more(linear: Build) -> None:
    """Held inputs: half the tolerance needs twice the steps; extrapolated ones: sqrt(2) times."""
    system = coupled(linear, saves_state=True, interpolates_inputs=True)

    def steps(tolerance: float, extrapolation: int) -> int:
        experiment = Experiment(2.0, 2.0, tolerance=tolerance, extrapolation=extrapolation)
        return simulate(system, experiment).provenance["steps_between_points"]

    assert steps(4e-4, 0) / steps(16e-4, 0) == pytest.approx(4.0, rel=0.15)
    assert steps(1e-5, 1) / steps(4e-5, 1) == pytest.approx(2.0, rel=0.15)


def test_signals_are_followed_between_communication_points_if_a_tolerance_asks(linear: Build) -> None:
    """x' = -x + cos t from x = 0: x = (cos t + sin t - e^-t) / 2."""
    system = alone(linear, initial_state=0.0, saves_state=True)
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
    system = alone(linear, initial_state=0.0)
    signals = {"one.u[1]": Cosine(1.0, 1.0)}
    run = simulate(system, Experiment(2.0, 0.1, signals=signals, step_sizes={"one": 0.4}))
    x, decay = 0.0, math.exp(-0.4)
    for i, t in enumerate(run.time.tolist()):
        if i and i % 4 == 0:
            x = decay * x + (1.0 - decay) * math.cos(t - 0.4)
        assert run["one.y[1]"][i] == pytest.approx(x, abs=1e-14)


def test_a_slow_component_is_set_at_its_own_points_alone(linear: Build) -> None:
    with Simulator(alone(linear)) as simulator:
        run = simulator.start(Experiment(0.8, 0.1, inputs={"one.u[1]": 0.0}, step_sizes={"one": 0.4}))
        run.advance(0.3)
        with pytest.raises(OrchestrationError, match=r"one\.u\[1\]: one is within a step: .* every 0\.4 s"):
            run.set("one.u[1]", 1.0)
        run.advance(0.4)
        run.set("one.u[1]", 1.0)
        run.advance(0.8)
        expected = math.exp(-0.8) + 1.0 - math.exp(-0.4)
        assert run.recording()["one.y[1]"][-1] == pytest.approx(expected, rel=1e-14)


def test_the_last_step_of_a_slow_component_is_shorter(linear: Build) -> None:
    system = alone(linear)
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
        ({"tolerance": 1e-3}, r"tolerance: one cannot repeat a step .* canGetAndSetFMUstate"),
    ],
)
def test_settings_that_do_not_fit_are_refused(linear: Build, settings: dict, message: str) -> None:
    with pytest.raises(SystemDefinitionError, match=message):
        simulate(alone(linear), Experiment(1.0, 0.1, inputs={"one.u[1]": 0.0}, **settings))


@pytest.mark.parametrize(
    ("time", "capabilities", "settings", "points", "made"),
    [
        (0.25, {}, {}, 10, 0.25),
        (0.25, {"varies_step_size": False}, {}, 9, 0.3),
        (0.1, {}, {"step_sizes": {"one": 0.4}}, 9, 0.4),
    ],
    ids=["between points", "an FMU of fixed steps", "a slow component"],
)
def test_an_event_is_made_at_the_first_point_that_its_component_can_have(
    linear: Build, time: float, capabilities: dict, settings: dict, points: int, made: float
) -> None:
    """x' = a x, from a = -1 to a = 0: x stands still from then on."""
    event = Event(time, {"one.a": 0.0})
    experiment = Experiment(0.8, 0.1, inputs={"one.u[1]": 0.0}, events=(event,), **settings)
    run = simulate(alone(linear, **capabilities), experiment)
    assert len(run.time) == points
    assert (0.25 in run.time) == (made == 0.25)
    assert run["one.y[1]"][-1] == pytest.approx(math.exp(-made), rel=1e-14)


@pytest.mark.parametrize(("held", "smooth"), [("u[1]", "u[2]"), ("u[2]", "u[1]")])
def test_an_input_that_is_held_leaves_the_others_their_derivatives(
    linear: Build, tmp_path: Path, held: str, smooth: str
) -> None:
    """Of two inputs one is discrete; the other is extrapolated by the FMU as if it were alone."""
    fmu = linear(b=(1.0, 1.0), interpolates_inputs=True)
    pattern = rf'(<ScalarVariable[^>]*name="{re.escape(held)}"[^>]*variability=")continuous'
    discrete = redescribed(fmu, tmp_path / "held.fmu", lambda xml: re.sub(pattern, r"\1discrete", xml))
    assert members(discrete) != members(fmu)
    experiment = Experiment(1.0, 0.1, extrapolation=1, signals={f"one.{smooth}": Cosine(1.0, 3.0)})
    expected = simulate(System({"one": fmu}), replace(experiment, inputs={f"one.{held}": 0.0}))
    signals = {**experiment.signals, f"one.{held}": Constant(0.0)}
    beside = simulate(System({"one": discrete}), replace(experiment, signals=signals))
    assert np.array_equal(beside["one.y[1]"], expected["one.y[1]"])

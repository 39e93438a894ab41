"""The estimated error of a run beside the true one."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from orchestration.errors import FmuWarning, SystemDefinitionError
from orchestration.results.files import ERROR_ESTIMATE
from orchestration.run import Simulator, simulate
from orchestration.run.error_estimate import longer_internal_steps
from orchestration.system.experiment import Algorithm, Experiment
from orchestration.system.prepared_run import prepare
from orchestration.system.system import System
from tests.foreign_fmus import Misdeed
from tests.orchestration.linear_systems import coupled, solution
from tests.orchestration.runs import assert_same_bits
from tests.shared_builds import Build

OUTPUTS = ("one.y[1]", "two.y[1]")
NAMES = ("one", "two", "three", "four")


def drawn(random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A and x(0) of x' = A x, of two to four components, of which the slowest mode decays at 0.05/s."""
    while True:
        count = int(random.integers(2, 5))
        matrix = random.normal(0.0, 2.0, (count, count))
        matrix[random.random((count, count)) < 0.3] = 0.0
        np.fill_diagonal(matrix, 0.0)
        is_coupled = matrix.any()
        np.fill_diagonal(matrix, -random.uniform(0.1, 3.0, count))
        if is_coupled and np.linalg.eigvals(matrix).real.max() < -0.05:
            return matrix, random.normal(size=count)


def of_fmus(fmu: Path, matrix: np.ndarray) -> System:
    """x_i' = A_ii x_i + u_i and y = x: an FMU of three inputs, whose gains the connections have."""
    connections = []
    for i, row in enumerate(matrix):
        sources = [j for j in np.flatnonzero(row) if j != i]
        connections += [
            (f"{NAMES[j]}.y[1]", f"{NAMES[i]}.u[{k + 1}]", {"factor": float(row[j])})
            for k, j in enumerate(sources)
        ]
    return System(dict.fromkeys(NAMES[: len(matrix)], fmu), connections)


def ratios(fmu: Path, seed: int) -> tuple[float, float]:
    """Estimated over true error of a random system: the largest of the run over all outputs, and at its end.

    The step is 0.003 to 0.3 of the fastest mode's time; the run takes 8 to 100 of them.
    """
    random = np.random.default_rng(seed)
    matrix, start = drawn(random)
    fastest = np.abs([*np.linalg.eigvals(matrix), *np.diag(matrix)]).max()
    step = 10.0 ** random.uniform(-2.5, -0.5) / fastest
    count = int(random.integers(8, 101))
    parameters = {f"{name}.a": float(pole) for name, pole in zip(NAMES, np.diag(matrix), strict=False)}
    parameters |= {f"{name}.initial_state": float(x) for name, x in zip(NAMES, start, strict=False)}
    settings: dict[str, Any] = {
        "algorithm": random.choice([*Algorithm]),
        "extrapolation": int(random.integers(0, 2)),
        "parameters": parameters,
        "open_inputs": "start",
    }
    run = simulate(of_fmus(fmu, matrix), Experiment(step * count, step, error_estimate=True, **settings))
    of_a_step, states = expm(matrix * step), [start]
    for _ in run.time[1:]:
        states.append(of_a_step @ states[-1])
    outputs = [f"{name}.y[1]" for name in NAMES[: len(start)]]
    true = np.abs(np.column_stack([run[name] for name in outputs]) - np.array(states))
    estimated = np.column_stack([run[f"{ERROR_ESTIMATE}{name}"] for name in outputs])
    return float(estimated.max() / true.max()), float(estimated[-1].max() / true[-1].max())


@pytest.mark.slow
@pytest.mark.parametrize("count", [20, pytest.param(100, marks=pytest.mark.slow)])
def test_the_estimate_bounds_the_error_of_random_systems(linear: Build, count: int) -> None:
    """At least the true error in 95 of 100, at most ten times it in the median; FMUs cannot go back."""
    inputs: dict[str, Any] = {"b": (1.0, 1.0, 1.0), "d": ((0.0, 0.0, 0.0),)}
    fmus = [linear(**inputs, interpolates_inputs=interpolates) for interpolates in (True, False)]
    measured = np.array([ratios(fmus[seed % 2], seed) for seed in range(count)])
    assert np.all(np.mean(measured >= 1.0, axis=0) >= 0.95)
    assert np.all(np.median(measured, axis=0) <= 10.0)


def ends(system: System, **settings: Any) -> tuple[float, float]:
    """Estimated and true error of `coupled` at the end of a run, the larger of its two outputs."""
    run = simulate(system, Experiment(2.0, error_estimate=True, **settings))
    estimated = max(run[f"{ERROR_ESTIMATE}{name}"][-1] for name in OUTPUTS)
    values = np.array([run[name][-1] for name in OUTPUTS])
    return float(estimated), float(np.abs(values - solution(run.time[-1:])[0]).max())


BACK: dict[str, Any] = {"saves_state": True, "interpolates_inputs": True}
RUNS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "fixed steps": ({"varies_step_size": False}, {"step_size": 0.01}),
    "an odd number of them": ({"varies_step_size": False}, {"step_size": 0.08}),
    "a shorter last step": ({}, {"step_size": 0.03}),
    "a slow component": ({}, {"step_size": 0.01, "step_sizes": {"two": 0.04}}),
    "a tolerance": (BACK, {"step_size": 0.5, "tolerance": 1e-3}),
    "a tolerance of order 2": (BACK, {"step_size": 0.5, "tolerance": 1e-3, "extrapolation": 1}),
}


@pytest.mark.parametrize(("capabilities", "settings"), RUNS.values(), ids=RUNS)
def test_every_kind_of_run_is_estimated(linear: Build, capabilities: dict, settings: dict) -> None:
    estimated, true = ends(coupled(linear, **capabilities), **settings)
    assert true <= estimated <= 10.0 * true


@pytest.mark.parametrize(("extrapolation", "factor"), [(0, 3.0), (1, 2.0)])
def test_the_run_itself_is_the_same(linear: Build, extrapolation: int, factor: float) -> None:
    """The estimates are further columns."""
    system, experiment = coupled(linear), Experiment(1.0, 0.1, extrapolation=extrapolation)
    alone = simulate(system, experiment)
    run = simulate(system, replace(experiment, error_estimate=True))
    assert run.names == (*alone.names, *(f"{ERROR_ESTIMATE}{name}" for name in alone.names))
    assert np.array_equal(run.values[:, :2], alone.values)
    at_twice_the_step = simulate(system, replace(experiment, step_size=0.2))
    difference = np.abs(alone.values[::2] - at_twice_the_step.values)
    largest = [difference[max(k - 2, 0) : k + 1].max(axis=0) for k in range(len(difference))]
    assert np.array_equal(run.values[::2, 2:], factor * np.array(largest))
    for name in OUTPUTS:
        column = run[f"{ERROR_ESTIMATE}{name}"]
        found = run.provenance["error_estimate"]["quantities"][name]
        assert found == {"maximum": column.max(), "at_end": column[-1]}


@pytest.mark.slow
def test_a_run_in_a_process_of_its_own_has_the_same_estimate(linear: Build) -> None:
    experiment = Experiment(1.0, 0.1, error_estimate=True)
    apart = simulate(coupled(linear), experiment, timeout=60.0)
    assert_same_bits(apart, simulate(coupled(linear), experiment))


@pytest.mark.parametrize(
    ("internal_step", "longer"), [(0.01, None), (0.02, 0.04), (0.03, 0.06), (0.04, None)]
)
def test_an_internal_step_is_doubled_only_where_a_step_twice_as_long_would_be_divided(
    built: Mapping[str, Path], internal_step: float, longer: float | None
) -> None:
    system = System({"c": built["PidDepthController"]})
    parameters = {"c.internal_step": internal_step}
    prepared = prepare(system, Experiment(1.0, 0.02, open_inputs="start", parameters=parameters))
    assert longer_internal_steps(prepared) == ({"c.internal_step": longer} if longer else {})


def test_a_second_run_that_fails_leaves_the_first(rogue: Build) -> None:
    """Steps longer than 0.15 s are discarded: the one run takes 0.1 s, the other 0.2 s."""
    parameters = {"bad.misdeed": int(Misdeed.DISCARD), "bad.misdeed_time": 0.5, "bad.longest_step": 0.15}
    experiment = Experiment(1.0, 0.1, parameters=parameters, inputs={"bad.u": 1.0}, error_estimate=True)
    with pytest.warns(FmuWarning, match="no error estimate: the run at twice the step: bad at t = 0.6 s"):
        run = simulate(System({"bad": rogue()}), experiment)
    assert run["bad.y"][-1] == pytest.approx(1.0)
    assert np.isnan(run[f"{ERROR_ESTIMATE}bad.y"]).tolist() == [False] * 7 + [True] * 4
    estimate = run.provenance["error_estimate"]
    assert estimate["quantities"] == {"bad.y": {"maximum": None, "at_end": None}}
    assert estimate["failure"].startswith("bad at t = 0.6 s")


def test_what_cannot_be_estimated_is_refused(linear: Build) -> None:
    message = r"expected a run of at least 0\.2 s, two steps .* got 0\.1 s"
    with pytest.raises(SystemDefinitionError, match=message):
        simulate(coupled(linear), Experiment(0.1, 0.1, error_estimate=True))


def test_both_runs_of_an_estimate_report_their_progress(linear: Build) -> None:
    """So that either can be interrupted from there."""
    totals: list[int] = []
    with Simulator(coupled(linear)) as simulator:
        simulator.run(Experiment(2.0, 0.1, error_estimate=True), lambda done, total: totals.append(total))
    assert list(dict.fromkeys(totals)) == [20, 10]

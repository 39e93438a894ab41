"""Connections with a factor and an offset, and one output on several inputs."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestration.errors import SystemDefinitionError
from orchestration.run import simulate
from orchestration.system.faults import Fault, Offset
from orchestration.system.system import LinearTransformation, System, check
from tests.described_fmus import described
from tests.shared_builds import Build

RECORD = ["a.y[1]", "b.u[1]", "c.u[1]"]


def run(linear: Build, **settings: Any) -> Any:
    lag = linear(a=-2.0)
    connections = [("a.y[1]", "b.u[1]"), ("a.y[1]", "c.u[1]", {"factor": -0.5, "offset": 2.0})]
    system = System({"a": lag, "b": lag, "c": lag}, connections)
    return simulate(system, stop_time=1.0, step_size=0.1, inputs={"a.u[1]": 0.0}, record=RECORD, **settings)


@pytest.mark.parametrize("algorithm", ["jacobi", "gauss-seidel"])
@pytest.mark.parametrize("extrapolation", [0, 1])
def test_one_output_drives_several_inputs_each_in_its_own_way(
    linear: Build, algorithm: str, extrapolation: int
) -> None:
    recording = run(linear, algorithm=algorithm, extrapolation=extrapolation)
    np.testing.assert_array_equal(recording["b.u[1]"], recording["a.y[1]"])
    np.testing.assert_array_equal(recording["c.u[1]"], -0.5 * recording["a.y[1]"] + 2.0)


def test_a_fault_acts_on_the_transformed_value(linear: Build) -> None:
    recording = run(linear, faults=[Fault("c.u[1]", Offset(1.0))])
    np.testing.assert_array_equal(recording["c.u[1]"], -0.5 * recording["a.y[1]"] + 2.0 + 1.0)


def test_initial_values_are_transformed_in_a_loop_and_outside(function: Build) -> None:
    """y = u / 2: without a loop b.y = (4 * 1 / 2 + 1) / 2, with one y = (-4 y + 3) / 2."""
    half = function("0.5 * u")
    settings: dict[str, Any] = {"stop_time": 0.1, "step_size": 0.1}
    chain = System({"a": half, "b": half}, [("a.y", "b.u", {"factor": 4.0, "offset": 1.0})])
    assert simulate(chain, inputs={"a.u": 1.0}, **settings)["b.y"][0] == 1.5
    loop = System({"a": half}, [("a.y", "a.u", {"factor": -4.0, "offset": 3.0})])
    # the tolerance of the master's own solution
    assert simulate(loop, **settings)["a.y"][0] == pytest.approx(0.5, abs=1e-12)


def test_minus_zero_arrives_as_it_is(function: Build) -> None:
    negative = function("-0.0 * (1.0 + u * u)")
    system = System({"a": negative, "b": negative}, [("a.y", "b.u")])
    recording = simulate(system, stop_time=0.1, step_size=0.1, inputs={"a.u": 0.0}, record=["b.u"])
    assert np.signbit(recording["b.u"]).all()


def test_units_are_not_compared_where_a_connection_has_a_factor(tmp_path: Path) -> None:
    a = described(tmp_path / "a.fmu", outputs=["y", "n:Integer"], units={"y": "mm"})
    b = described(tmp_path / "b.fmu", inputs=["u", "k:Integer"], units={"u": "m"})
    components = {"a": a, "b": b}
    with pytest.raises(SystemDefinitionError, match="expected equal units, got mm and m"):
        check(System(components, [("a.y", "b.u"), ("a.n", "b.k")]))
    system = System(components, [("a.y", "b.u", {"factor": 0.001}), ("a.n", "b.k")])
    assert check(system).transformations == {"b.u": LinearTransformation(0.001)}
    with pytest.raises(SystemDefinitionError, match="input of type Real for a factor or an offset, got Inte"):
        check(System(components, [("a.y", "b.u", {"factor": 0.001}), ("a.n", "b.k", {"factor": 2})]))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"factr": 1.0}, r"connection a.y -> b.u: unknown key 'factr'; nearest is 'factor'"),
        ({"factor": "2"}, r"factor = '2': expected a finite number"),
        ({"offset": float("nan")}, r"offset = nan: expected a finite number"),
        (3, r"expected {factor, offset} third, got 3"),
    ],
)
def test_a_wrong_transformation_names_its_connection(given: Any, message: str) -> None:
    with pytest.raises(SystemDefinitionError, match=message):
        System({"a": "a.fmu"}, [("a.y", "b.u", given)])

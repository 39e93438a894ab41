"""Initial values by the declared dependencies; loops against solutions that are known."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.fmi.instance import FmuInstance
from orchestration.errors import FmuError, OrchestrationError, SimulationError
from orchestration.run import simulate
from orchestration.run.initialisation import nominal_of, solve_initial_values
from orchestration.system.experiment import Experiment, Initialisation
from orchestration.system.open_inputs import OpenInputs
from orchestration.system.system import CheckedSystem, System, check
from tests.shared_builds import Build, Fmus

Connections = tuple[tuple[str, str], ...]
ROUNDING = 1e-11  # relative: settled to 1e-12, and a loop of gain 0.9 magnifies what is left ten times
DOTTIE = 0.7390851332151607  # cos(x) = x

AUTOMATIC, FIXED_POINT, NEWTON = Initialisation


class Counted:
    """A component that counts what it is asked for."""

    def __init__(self, component: FmuInstance) -> None:
        self._component = component
        self.calls: Counter[str] = Counter()

    def get(self, variable: Any) -> Any:
        self.calls["get"] += 1
        return self._component.get(variable)

    def set(self, variable: Any, value: Any) -> None:
        self.calls["set"] += 1
        self._component.set(variable, value)


@contextmanager
def initialising(
    components: Mapping[str, Path], connections: Connections, **inputs: float
) -> Iterator[tuple[CheckedSystem, dict[str, Any]]]:
    """A system in initialisation mode; inputs: `component_u` -> value of its first input."""
    named = {f"{name}.u[1]": value for name, value in inputs.items()}
    checked = check(System(components, connections), named)
    with ExitStack() as stack:
        live = {
            name: stack.enter_context(FmuInstance(name, path, checked.descriptions[name]))
            for name, path in components.items()
        }
        for component in live.values():
            component.initialise(0.0, None)
        for name, value in named.items():
            port = checked.ports[name]
            live[port.component].set(port.variable, value)
        counted = {name: Counted(component) for name, component in live.items()}
        yield checked, counted


def value(checked: CheckedSystem, components: Mapping[str, Any], name: str) -> float:
    port = checked.ports[name]
    return components[port.component].get(port.variable)


def gain(linear: Build, d: float, offset: float = 1.0, **options: Any) -> Path:
    """y = offset + d u at the start."""
    return linear(d=((d,),), initial_state=offset, **options)


def settled(
    components: Mapping[str, Path],
    connections: Connections,
    method: Initialisation = AUTOMATIC,
    **inputs: float,
) -> dict[str, float]:
    """The inputs that are connected, by name."""
    with initialising(components, connections, **inputs) as (checked, live):
        solve_initial_values(checked, live, method)
        return {target: value(checked, live, target) for _, target in connections}


@pytest.mark.parametrize("declares", [True, False])
def test_a_chain_is_one_pass_in_the_order_of_the_dependencies(linear: Build, declares: bool) -> None:
    """Listed in reverse; an output that declares nothing follows every input."""
    double = gain(linear, 2.0, declares_dependencies=declares)
    chain = (("b.y[1]", "c.u[1]"), ("a.y[1]", "b.u[1]"))
    with initialising(dict.fromkeys("abc", double), chain, a=5.0) as (checked, live):
        solve_initial_values(checked, live, AUTOMATIC)
        assert sum((component.calls for component in live.values()), Counter()) == {"get": 2, "set": 2}
        assert value(checked, live, "c.u[1]") == 1.0 + 2.0 * (1.0 + 2.0 * 5.0)
    with initialising({"a": double}, (("a.y[1]", "a.u[1]"),)) as (checked, live):
        assert [group.is_loop for group in checked.connection_groups] == [True]


def test_an_output_that_follows_no_input_closes_no_loop(linear: Build) -> None:
    components = {"plant": linear(), "controller": gain(linear, 3.0)}
    both = (("controller.y[1]", "plant.u[1]"), ("plant.y[1]", "controller.u[1]"))
    with initialising(components, both) as (checked, live):
        assert [[t.name for _, t in group.connections] for group in checked.connection_groups] == [
            ["controller.u[1]"],
            ["plant.u[1]"],
        ]
        solve_initial_values(checked, live, AUTOMATIC)
        assert value(checked, live, "plant.u[1]") == 4.0


LOOP = (("a.y[1]", "b.u[1]"), ("b.y[1]", "a.u[1]"))
NAMED = r"the loop b.u\[1\], a.u\[1\]"


CONTRACTING = [(method, gain) for method in Initialisation for gain in (0.5, -0.7, 0.9)]
OTHERS = [(method, gain) for method in (AUTOMATIC, NEWTON) for gain in (0.99, -1.0, -2.0, 30.0)]


@pytest.mark.parametrize(("method", "loop_gain"), CONTRACTING + OTHERS)
def test_a_loop_comes_to_its_solution_by_newtons_method_if_it_does_not_contract(
    linear: Build, method: Initialisation, loop_gain: float
) -> None:
    """a.u = 3 + g b.u, b.u = 1 + a.u."""
    components = {"a": gain(linear, 1.0), "b": gain(linear, loop_gain, 3.0)}
    solved = settled(components, LOOP, method)
    solution = (1.0 + 3.0) / (1.0 - loop_gain)
    precision = ROUNDING * max(1.0, 0.1 / abs(1.0 - loop_gain))
    assert solved["b.u[1]"] == pytest.approx(solution, rel=precision)
    assert solved["a.u[1]"] == pytest.approx(solution - 1.0, rel=2.0 * precision)


def test_several_loop_variables_of_different_size_are_solved_together(linear: Build) -> None:
    """u = F u + f of two components with two inputs each, whose values differ by nine orders of magnitude."""
    matrix = np.array(
        [[0.0, 0.0, 2.0, 1e6], [0.0, 0.0, 1e-6, -3.0], [-4.0, 0.5, 0.0, 0.0], [0.0, 3.0, 0.0, 0.0]]
    )
    offset = np.array([1e6, 1.0, 1e6, 2.0])
    common: dict[str, Any] = {"b": (0.0, 0.0), "initial_state": 1.0}
    components = {
        "a": linear(d=tuple(map(tuple, matrix[2:, :2].tolist())), c=tuple(offset[2:].tolist()), **common),
        "b": linear(d=tuple(map(tuple, matrix[:2, 2:].tolist())), c=tuple(offset[:2].tolist()), **common),
    }
    pairs = tuple((f"{s}.y[{i}]", f"{t}.u[{i}]") for s, t in ("ba", "ab") for i in (1, 2))
    solved = settled(components, pairs)
    exact = np.linalg.solve(np.eye(4) - matrix, offset)
    assert list(solved.values()) == pytest.approx(exact, rel=ROUNDING)


@pytest.mark.parametrize(
    ("loop_gain", "offset", "method", "message"),
    [
        *((1.0, 1.0, method, f"no solution was found for {NAMED}") for method in Initialisation),
        (-2.0, 1.0, FIXED_POINT, f"{NAMED} .* iteration diverges"),
        (1.0, 0.0, NEWTON, "the loop is singular"),
    ],
)
def test_a_loop_without_one_solution_that_is_found_is_said(
    linear: Build, loop_gain: float, offset: float, method: Initialisation, message: str
) -> None:
    """a.u = offset + g b.u and b.u = offset + a.u: none, one to which no exchange leads, or every number."""
    components = {"a": gain(linear, 1.0, offset), "b": gain(linear, loop_gain, offset)}
    with pytest.raises(OrchestrationError, match=message):
        settled(components, LOOP, method)


def test_two_loops_and_the_chain_between_them_are_solved_in_order(linear: Build) -> None:
    """The first loop's value feeds the chain, the chain's the second loop; the chain is read once."""
    joined = linear(d=((0.5, 1.0),), b=(0.0, 0.0), initial_state=1.0)  # y = 1 + u1 / 2 + u2
    gains = {name: gain(linear, d) for name, d in (("a", 0.5), ("b", 1.0), ("c", 3.0))}
    chain = (("c.y[1]", "d.u[2]"), ("b.y[1]", "c.u[1]"))
    connections = (("e.y[1]", "d.u[1]"), ("d.y[1]", "e.u[1]"), *chain, *LOOP)
    with initialising(gains | {"d": joined, "e": gain(linear, 1.0, 0.0)}, connections) as (checked, live):
        loops = [len(group.connections) for group in checked.connection_groups if group.is_loop]
        solve_initial_values(checked, live, AUTOMATIC)
        assert loops == [2, 2]
        assert live["c"].calls == {"get": 1, "set": 1}
        assert value(checked, live, "c.u[1]") == pytest.approx(4.0, rel=ROUNDING)  # b = 1 + a, a = 1 + b / 2
        assert value(checked, live, "e.u[1]") == pytest.approx(28.0, rel=ROUNDING)  # d = 1 + d / 2 + 13


@pytest.mark.parametrize(
    ("expression", "nominal", "solution"),
    [("cos(u)", None, DOTTIE), ("1e-9 + 0.5 * u", 1e-9, 2e-9)],
    ids=["nonlinear", "below what counts as none without a nominal"],
)
@pytest.mark.parametrize("method", list(Initialisation))
def test_a_loop_of_one_output_comes_to_its_solution(
    function: Build, method: Initialisation, expression: str, nominal: float | None, solution: float
) -> None:
    solved = settled({"f": function(expression, nominal=nominal)}, (("f.y", "f.u"),), method)
    assert solved["f.u"] == pytest.approx(solution, rel=ROUNDING, abs=0.0)


@pytest.mark.parametrize(
    ("output", "input_", "size"),
    [(None, None, 1.0), ("3", None, 3.0), ("3", "-2", 2.0), (None, "0", 1.0), ("-3", None, 3.0)],
)
def test_changes_are_relative_to_the_size_of_the_nominal_of_the_input_or_else_of_the_output(
    linear: Build, output: str | None, input_: str | None, size: float
) -> None:
    ports = check(System({"one": linear()}), ["one.u[1]"]).ports
    ends = [
        replace(ports[name], variable=replace(ports[name].variable, nominal=nominal))
        for name, nominal in (("one.y[1]", output), ("one.u[1]", input_))
    ]
    assert nominal_of((ends[0], ends[1])) == size


def test_newtons_method_takes_shorter_steps_where_a_value_is_discarded(function: Build) -> None:
    """x = x + log(x) - 1 has the solution e; a full step ends below zero from everywhere above e^2."""
    solved = settled({"f": function("u + log(u) - 1", start=20.0)}, (("f.y", "f.u"),), NEWTON)
    assert solved["f.u"] == pytest.approx(np.e, rel=ROUNDING)


@pytest.mark.parametrize(
    ("method", "message"),
    [
        (AUTOMATIC, "no solution .* was discarded"),
        (NEWTON, r"\(Newton's method ends .*, and a value was discarded"),
    ],
)
def test_a_loop_whose_every_value_is_discarded_says_so(
    function: Build, method: Initialisation, message: str
) -> None:
    path = function("log(u) - 10", start=0.5)  # less than its own argument wherever it is defined
    with pytest.raises(OrchestrationError, match=f"{message}: f at t = 0 s: .*has no"):
        settled({"f": path}, (("f.y", "f.u"),), method)


def test_an_output_that_is_no_number_is_not_passed_on(linear: Build) -> None:
    components = {"a": linear(c=(10.0,), initial_state=1e308), "b": gain(linear, 2.0)}
    message = r"a.y\[1\] is inf: .* finite number, as it goes to b.u\[1\]"
    with initialising(components, (("a.y[1]", "b.u[1]"),), a=0.0) as (checked, live):
        with pytest.raises(OrchestrationError, match=message):
            solve_initial_values(checked, live, AUTOMATIC)
        assert live["b"].calls["set"] == 0


def test_newtons_method_takes_shorter_steps_where_an_output_is_no_number(function: Build) -> None:
    class Infinite(Counted):
        """Gives infinity where the FMU discards."""

        def get(self, variable: Any) -> Any:
            try:
                return super().get(variable)
            except FmuError:
                return math.inf

    with initialising({"f": function("u + log(u) - 1", start=20.0)}, (("f.y", "f.u"),)) as (checked, live):
        solve_initial_values(checked, {"f": Infinite(live["f"])}, NEWTON)  # type: ignore[dict-item]
        assert value(checked, live, "f.u") == pytest.approx(np.e, rel=ROUNDING)


def test_an_error_of_an_fmu_is_not_taken_for_a_try(linear: Build) -> None:
    class Broken(Counted):
        def set(self, variable: Any, value: Any) -> None:
            raise FmuError("b", 0.0, "fmi2SetReal", "error", ["out of order"])

    components = {"a": gain(linear, 1.0), "b": gain(linear, 0.5)}
    with initialising(components, LOOP) as (checked, live):
        broken: Any = live | {"b": Broken(live["b"])}
        with pytest.raises(FmuError, match="out of order"):
            solve_initial_values(checked, broken, AUTOMATIC)


def test_integers_and_booleans_settle_by_exchange_alone(linear: Build) -> None:
    through = linear(passes_discrete=True)
    kinds = ("integer", "boolean")
    connections = tuple((f"{s}.{k}_out", f"{t}.{k}_in") for s, t in ("ab", "ba") for k in kinds)
    assert settled({"a": through, "b": through}, connections, a=0.0, b=0.0) == dict.fromkeys(
        [target for _, target in connections], 0
    )
    with pytest.raises(OrchestrationError, match="Newton's method needs variables of type Real"):
        settled({"a": through, "b": through}, connections, NEWTON, a=0.0, b=0.0)


def test_newtons_method_takes_no_loop_in_which_one_variable_is_no_real(linear: Build) -> None:
    """Integers and Reals are one loop, as no output declares what it follows."""
    through = linear(passes_discrete=True, declares_dependencies=False, d=((0.5,),))
    connections = tuple(
        (f"{s}.{name}_out" if name else f"{s}.y[1]", f"{t}.{name}_in" if name else f"{t}.u[1]")
        for s, t in ("ab", "ba")
        for name in ("", "integer", "boolean")
    )
    with pytest.raises(OrchestrationError, match="Newton's method needs variables of type Real"):
        settled({"a": through, "b": through}, connections, NEWTON)


def test_the_experiment_chooses_the_method(linear: Build) -> None:
    system = System({"a": gain(linear, 1.0), "b": gain(linear, -2.0)}, LOOP)
    run = simulate(system, Experiment(0.01, 0.01))
    assert run["a.y[1]"][0] == pytest.approx(2.0 / 3.0, rel=ROUNDING)  # a = 1 + b, b = 1 - 2 a
    with pytest.raises(SimulationError, match="iteration diverges"):
        simulate(system, Experiment(0.01, 0.01, initialisation=FIXED_POINT))


def test_the_controller_follows_the_plant(built: Mapping[str, Path]) -> None:
    system = System(
        {"controller": built["L1DepthController"], "plant": built["RovDepthPlant"]},
        (
            ("controller.voltage[1]", "plant.voltage[1]"),
            ("controller.voltage[2]", "plant.voltage[2]"),
            ("plant.measured_depth", "controller.measured_depth"),
            ("plant.depth_rate", "controller.measured_depth_rate"),
        ),
    )
    groups = check(system, open_inputs=OpenInputs.START).connection_groups
    targets = [target.name for group in groups for _, target in group.connections]
    assert not any(group.is_loop for group in groups)
    assert targets.index("controller.measured_depth") < targets.index("plant.voltage[1]")


def test_parameters_hold_though_the_set_up_of_the_experiment_resets_them(
    built: Fmus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As that of 20-sim's FMUs does, such as those of libcosim's demo.ssp."""
    set_up, name = FmuInstance.set_up_experiment, "internal_step"

    def resetting(instance: FmuInstance, *arguments: Any) -> None:
        set_up(instance, *arguments)
        (parameter,) = [v for v in instance.description.modelVariables if v.name == name]
        instance.set(parameter, float(parameter.start or 0))

    monkeypatch.setattr(FmuInstance, "set_up_experiment", resetting)
    system = System({"a": built["ExamplePlant"]})
    experiment = Experiment(0.5, 0.125, parameters={f"a.{name}": 0.03125}, record=(f"a.{name}",))
    assert simulate(system, replace(experiment, open_inputs="start")).values.min() == 0.03125

"""CasADi's importer on model exchange of FMI 2.0 and 3.0, beside the functions of the blocks themselves."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import casadi
import fmpy
import numpy as np
import pytest

from fmus.block import Block, NoValues, variable
from fmus.block.scalars import flatten, unflatten
from fmus.generate import builder
from fmus.generate.trace import trace
from fmus.numerics import absolute, exp, sin
from tests.shared_builds import Fmus

pytestmark = pytest.mark.importers


@dataclass(frozen=True)
class Parameters:
    mass: float = variable(5.5, "Mass", unit="kg", min=0.1)
    drag: float = variable(7.0, "Quadratic drag", unit="N.s2/m2")


@dataclass(frozen=True)
class Inputs:
    force: float = variable(0.0, "Force", unit="N")
    current: float = variable(0.0, "Current", unit="m/s")


@dataclass(frozen=True)
class Continuous:
    depth: float = variable(0.5, "Depth", unit="m", nominal=3.0)
    rate: float = variable(0.0, "Depth rate", unit="m/s", nominal=0.1)


@dataclass(frozen=True)
class State(Continuous):
    current: float = 0.0


@dataclass(frozen=True)
class Outputs:
    energy: float = variable(0.0, "Kinetic energy", unit="J")
    resistance: float = variable(0.0, "Drag, which follows the current at once", unit="N")


def _drag(state: State, p: Parameters) -> float:
    relative = state.rate - state.current
    return p.drag * absolute(relative) * relative


def derivative(t: float, state: State, u: Inputs, p: Parameters, c: NoValues) -> Continuous:
    lift = u.force * sin(3.0 * state.depth) * exp(-state.depth)
    return Continuous(state.rate, (u.force - _drag(state, p) - lift) / p.mass)


def step(t: float, h: float, state: State, u: Inputs, p: Parameters, c: NoValues) -> State:
    return State(state.depth, state.rate, u.current)


def output(t: float, state: State, p: Parameters, c: NoValues) -> Outputs:
    return Outputs(0.5 * p.mass * state.rate**2, _drag(state, p))


DRIFT = Block.of_module(__name__, "Drift", "A vehicle in a current, of scalars alone")

Open = Callable[[str, int], tuple[Block, casadi.DaeBuilder]]
CASES = [("RovDepthPlant", 2), ("Drift", 2), ("Drift", 3), ("RovDepthPlant", 3)]


@pytest.fixture(scope="module")
def of_scalars(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, int], Path]:
    """FMUs by name and version of FMI, of scalars alone."""
    folder = tmp_path_factory.mktemp("scalars")
    blocks = {name: DRIFT if name == "Drift" else builder.load_block(name) for name, _ in CASES}
    return {
        (name, fmi): builder.build_block(blocks[name], folder / f"fmi{fmi}", fmi=fmi, scalars=fmi == 3)
        for name, fmi in CASES
    }


@pytest.fixture
def imported(fmi3_built: Fmus, of_scalars: dict[tuple[str, int], Path], tmp_path: Path) -> Open:
    """Returns a block and its FMU as CasADi reads it."""

    def one(name: str, fmi: int) -> tuple[Block, casadi.DaeBuilder]:
        block = DRIFT if name == "Drift" else builder.load_block(name)
        path = of_scalars.get((name, fmi)) or fmi3_built[name]
        folder = fmpy.extract(str(path), str(tmp_path / "unpacked"))
        return block, casadi.DaeBuilder(name, str(folder))

    return one


def points(block: Block, count: int) -> list[tuple[list[float], list[float]]]:
    """Returns continuous states, and inputs within their ranges."""
    random, limits = np.random.default_rng(3), []
    for v in block.of_causality("input"):
        low, high = v.minimum, v.maximum
        limits.append((-3.0 if low is None else max(low, -3.0), 3.0 if high is None else min(high, 3.0)))
    low, high = np.array(limits).T
    states = len(flatten(block.continuous))
    return [
        (random.uniform(-2.0, 2.0, states).tolist(), random.uniform(low, high).tolist()) for _ in range(count)
    ]


def held(block: Block, x: list[float], u: list[float]) -> tuple:
    """Returns the arguments of a block's functions at 0 s, with the discrete state of the start."""
    p = block.parameters()
    c = block.calculate(p)
    start = flatten(block.initial_state(0.0, block.inputs(), p, c))
    inputs = unflatten(block.inputs, u)
    state = unflatten(block.state, [*x, *start[len(x) :]])
    return block.held(0.0, state, inputs, p, c), inputs, p, c


def jacobian(block: Block) -> casadi.Function:
    """Returns the Jacobian of (derivatives, outputs) by (x, u), by CasADi, of the functions of the block."""
    f, p = trace(block), flatten(block.parameters())
    c = f.calculate(p)
    start = f.initial_state(0.0, flatten(block.inputs()), p, c)
    count = len(flatten(block.continuous))
    x, u = casadi.MX.sym("x", count), casadi.MX.sym("u", f.step.size1_in(3))
    state = f.held(0.0, casadi.vertcat(x, start[count:]), u, p, c)
    unknowns = casadi.vertcat(f.derivative(0.0, state, u, p, c), f.output(0.0, state, p, c))
    return casadi.Function("j", [x, u], [casadi.densify(casadi.jacobian(unknowns, casadi.vertcat(x, u)))])


@pytest.mark.parametrize(("name", "fmi"), CASES)
def test_derivatives_and_outputs_are_those_of_the_block(imported: Open, name: str, fmi: int) -> None:
    block, dae = imported(name, fmi)
    f = dae.create("f", ["x", "u"], ["ode", "y"])
    assert block.derivative
    for x, u in points(block, 10):
        state, *others = held(block, x, u)
        rates, outputs = (np.array(values).ravel() for values in f(x, u))
        rounding = 1e-12  # sums in another order
        own = flatten(block.derivative(0.0, state, *others))
        assert rates == pytest.approx(own, rel=rounding, abs=rounding)
        assert outputs == pytest.approx(
            flatten(block.output(0.0, state, *others[1:])), rel=rounding, abs=rounding
        )


@pytest.mark.parametrize(("name", "fmi"), CASES)
def test_jacobians_and_adjoints_are_those_of_casadi(imported: Open, name: str, fmi: int) -> None:
    """To 1e-12 of each number, or of the products that it is the sum of.

    CasADi asks FMUs of FMI 3.0 for adjoint derivatives, those of FMI 2.0 for directional ones.
    """
    block, dae = imported(name, fmi)
    f = dae.create("f", ["x", "u"], ["ode", "y"])
    whole, reverse, reference = f.jacobian(), f.reverse(1), jacobian(block)
    assert reverse.class_name() == "FmuFunction"
    random = np.random.default_rng(5)
    for x, u in points(block, 10):
        expected = np.array(reference(x, u))
        by = whole(x=x, u=u)
        got = np.block([[np.array(by[f"jac_{row}_{column}"]) for column in "xu"] for row in ("ode", "y")])
        assert np.all(np.abs(got - expected) <= 1e-12 * np.abs(expected))
        seed = random.normal(size=len(expected))
        across = np.concatenate(
            [np.array(part).ravel() for part in reverse(x, u, 0, 0, seed[: len(x)], seed[len(x) :])]
        )
        assert np.all(np.abs(across - seed @ expected) <= 1e-12 * np.abs(seed) @ np.abs(expected))


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_parameter_that_is_set_before_acts(imported: Open, fmi: int) -> None:
    _, dae = imported("Drift", fmi)
    dae.set("mass", 11.0)
    heavy = dae.create("heavy", ["x", "u"], ["ode"])
    dae.set("mass", 5.5)
    light = dae.create("light", ["x", "u"], ["ode"])
    ratio = light([0.5, 0.1], [2.0, 0.0])[1] / heavy([0.5, 0.1], [2.0, 0.0])[1]
    assert float(ratio) == pytest.approx(2.0, rel=1e-12)


def test_arrays_of_fmi_3_are_refused(imported: Open) -> None:
    """By CasADi 3.8: the page on it must change when this fails."""
    _, dae = imported("ExamplePlant", 3)
    with pytest.raises(RuntimeError, match="FmuInternal::get_in failed"):
        dae.create("f", ["x", "u"], ["ode", "y"])

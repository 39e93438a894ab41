"""Directional and adjoint derivatives of FMUs of FMI 3.0, beside those of CasADi's own virtual machine."""

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

import casadi
import numpy as np
import pytest

from fmus.block import Block
from fmus.block.variables import BlockVariable
from fmus.generate import builder
from fmus.generate.describe import array_name, arrays, fmi3_variables, other_variables
from fmus.generate.trace import trace

from .blocks import EVERYTHING, block_named, in_fmi3
from .exchanged import BALL
from .fmi3_instance import Fmi3Instance

traced = cache(trace)
NAMES = [*in_fmi3(builder.block_names()), EVERYTHING.name, BALL.name]
Open = Callable[..., Fmi3Instance]


class Reference(NamedTuple):
    """Derivatives of all unknowns by all knowns in one mode: functions of (t, x, u, p), and a seed.

    CasADi makes them of the traced functions, without what makes the FMU's own derivatives.
    """

    jacobian: casadi.Function
    adjoint: casadi.Function


@cache
def derivatives(name: str) -> dict[str, Reference]:
    block = block_named(name)
    f, count = traced(block), len(block.states) // 2
    t, x, u, p = arguments = [
        casadi.MX.sym("t"),
        *(casadi.MX.sym(*of) for of in zip("xup", map(f.step.size1_in, (2, 3, 4)), strict=True)),
    ]
    c, start = f.calculate(p), f.initial_state(t, u, p, f.calculate(p))

    def present(x: casadi.MX, held: casadi.MX) -> list[casadi.MX]:
        rates = [f.derivative(t, f.held(t, x, u, p, c), u, p, c)] if count else []
        return [f.output(t, held, p, c), *rates]

    unknowns = {
        "initial": [c, *present(start, start), *([start[:count]] if count else [])],
        "CoSimulation": present(x, x),
        "ModelExchange": present(x, f.held(t, x, u, p, c) if count else x),
    }
    made = {}
    for mode, columns in unknowns.items():
        unknown = casadi.vertcat(*columns)
        seed = casadi.MX.sym("seed", unknown.size1())
        by = [casadi.jacobian(unknown, known) for known in (p, u, x, t)]
        across = [casadi.jtimes(unknown, known, seed, True) for known in (p, u, x, t)]
        by[2], across[2] = by[2][:, :count], across[2][:count]
        made[mode] = Reference(
            casadi.Function("jacobian", arguments, [casadi.densify(casadi.horzcat(*by))]),
            casadi.Function(
                "adjoint", [*arguments, seed], [casadi.vertcat(*(a for a in across if a.numel()))]
            ),
        )
    return made


def references(name: str, mode: str) -> tuple[list[int], list[int]]:
    """Value references of the scalars that rows and columns of the Jacobian stand for."""
    block = block_named(name)
    count, time = len(block.states) // 2, other_variables(traced(block))[0].value_reference
    of = {role: [v.value_reference for v in block.of_causality(role)] for role in _ROLES}
    states, rates = (
        [v.value_reference for v in part] for part in (block.states[:count], block.states[count:])
    )
    rows = [*of["output"], *rates]
    if mode == "initial":
        return [*of["calculatedParameter"], *rows, *states], [*of["parameter"], *of["input"], *states, time]
    return rows, [*of["parameter"], *of["input"], *states, time]


_ROLES = ("parameter", "calculatedParameter", "input", "output")


def in_arrays(chosen: Sequence[int], block: Block) -> tuple[list[int], list[int]]:
    """Value references of the Float64 variables of some scalars, and the scalars that they are made of."""
    variables, members = [], []
    for place, (*_, scalars) in enumerate(fmi3_variables(traced(block)), 1):
        if scalars[0].value_reference in chosen and scalars[0].type == "Real":
            variables.append(place)
            members += [v.value_reference for v in scalars]
    return variables, members


@pytest.mark.parametrize("mode", ["initial", "CoSimulation", "ModelExchange"])
@pytest.mark.parametrize("name", NAMES)
def test_derivatives_are_those_of_casadi(open_fmi3: Open, name: str, mode: str) -> None:
    """To 1e-12 of the products that each is the sum of: the order of the sums is another.

    A row in which CasADi's order leaves none, as of a unit vector, is held to the largest product of all.
    CasADi has no number where a thruster's table has an interval of no length: it multiplies its slope by 0.
    """
    block, reference = block_named(name), derivatives(name)[mode]
    fmu = open_fmi3(name, "ModelExchange" if mode == "ModelExchange" else "CoSimulation")
    point = (*_led(fmu, block, mode), [float(v.start) for v in block.of_causality("parameter")])
    jacobian = np.array(reference.jacobian(*point))
    rows, columns = references(name, mode)
    is_finite = np.array(np.isfinite(jacobian).all(axis=0))
    without = {array_name(block.variables[columns[i]]) for i in np.nonzero(~is_finite)[0]}
    assert without <= {"thruster_table_force", "thruster_table_voltage"}
    jacobian[:, ~is_finite] = 0.0
    is_known = np.array([not (mode == "initial" and _is_state(block, r)) for r in columns])
    unknowns, chosen_rows = in_arrays(rows, block)
    knowns, chosen_columns = in_arrays(
        [r for r, known in zip(columns, is_known, strict=True) if known], block
    )
    i, j = [rows.index(r) for r in chosen_rows], [columns.index(r) for r in chosen_columns]
    random, size = np.random.default_rng(7), np.abs(jacobian[np.ix_(i, j)])
    for _ in range(3):
        along, across = np.zeros(len(columns)), np.zeros(len(rows))
        along[j], across[i] = random.normal(size=len(j)) * is_finite[j], random.normal(size=len(i))
        forward = fmu.fmu.getDirectionalDerivative(unknowns, knowns, along[j], len(i))
        products = size @ np.abs(along[j])
        products[products == 0.0] = products.max()
        assert np.all(np.abs(forward - (jacobian @ along)[i]) <= 1e-12 * products)
        adjoint = np.array(fmu.fmu.getAdjointDerivative(unknowns, knowns, across[i], len(j)))
        expected = np.array(reference.adjoint(*point, across)).ravel()
        off = np.abs(adjoint - expected[j])[is_finite[j]]
        assert np.all(off <= 1e-12 * (np.abs(across[i]) @ size)[is_finite[j]])
    assert size.any()


def _is_state(block: Any, reference: int) -> bool:
    return 0 <= reference - len(block.variables) < len(block.states) // 2


def _led(fmu: Fmi3Instance, block: Block, mode: str) -> tuple[float, np.ndarray, np.ndarray]:
    """Leads an instance with moving inputs away from where functions have corners.

    Returns its time, state and inputs, all from the bytes of its saved state (fmus/native/snapshot.h).
    """
    groups = [*arrays(v for v in block.of_causality("input") if v.type == "Real")]
    h = block.step_size

    def move(i: int) -> None:
        for k, (name, _, scalars) in enumerate(groups):
            v, count = scalars[0], len(scalars)
            fmu[name] = [_within(v, 0.3 + math.cos(3.0 * i * h + k + 0.4 * one)) for one in range(count)]

    fmu.fmu.enterInitializationMode(startTime=0.5)
    move(0)
    if mode != "initial":
        fmu.fmu.exitInitializationMode()
        for i in range(30 if mode == "CoSimulation" else 0):
            move(i)
            fmu.fmu.doStep(0.5 + i * h, h)
    saved = fmu.fmu.serializeFMUState(fmu.fmu.getFMUState())
    inputs, first = block.of_causality("input"), 16 + len(fmu.description.guid) + 4 * 8
    numbers = np.frombuffer(saved[first:], "<f8")
    begin = 1 + len(block.variables) + len(inputs) + 1
    u = numbers[1 + inputs[0].value_reference :][: len(inputs)] if inputs else np.zeros(0)
    return numbers[0], numbers[begin : begin + traced(block).step.numel_out(0)], u


def _within(v: BlockVariable, value: float) -> float:
    low, high = (
        limit if limit is not None else math.copysign(math.inf, s)
        for limit, s in ((v.minimum, -1), (v.maximum, 1))
    )
    return min(max(value, low), high)


@pytest.mark.parametrize("name", NAMES)
def test_what_is_no_dependency_has_no_derivative(open_fmi3: Open, name: str) -> None:
    """FMI 3.0.2, 2.4.8, where parameters and the time are knowns too."""
    block = block_named(name)
    description = open_fmi3(name).description
    groups = enumerate(fmi3_variables(traced(block)), 1)
    places = {v.value_reference: place for place, (*_, members) in groups for v in members}
    f = traced(block)
    u, p = ([float(v.start) for v in block.of_causality(role)] for role in ("input", "parameter"))
    x = np.array(f.initial_state(0.5, u, p, f.calculate(p))).ravel() + 0.125
    present = [*description.outputs, *description.derivatives]
    for mode, listed in (
        ("CoSimulation", present),
        ("ModelExchange", present),
        ("initial", description.initialUnknowns),
    ):
        rows, columns = references(name, mode)
        declared = {
            one.variable.valueReference: {v.valueReference for v in one.dependencies} for one in listed
        }
        for i, j in zip(*np.nonzero(np.array(derivatives(name)[mode].jacobian(0.5, x, u, p))), strict=True):
            assert places[columns[j]] in declared[places[rows[i]]], (mode, rows[i], columns[j])


def test_dependencies_are_no_more_than_there_are(open_fmi3: Open) -> None:
    """x = start + force at first; y = gain limit x, square = x^2 + t, of Everything."""
    description = open_fmi3(EVERYTHING.name).description
    names = {
        (kind, one.variable.name): {v.name for v in one.dependencies}
        for kind, listed in (("output", description.outputs), ("initial", description.initialUnknowns))
        for one in listed
    }
    assert names["output", "y"] == {"gain", "limit"}
    assert names["output", "square"] == {"time"}
    assert names["output", "high"] == names["output", "steps"] == set()
    assert names["initial", "ratio"] == {"gain", "limit"}
    assert names["initial", "square"] == {"start", "force", "time"}
    assert names["initial", "steps"] == {"count"}
    assert names["initial", "high"] == {"start", "force"}

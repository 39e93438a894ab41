"""Modes of an FMU: what is calculated in each by what is known, dependencies and directional derivatives."""

from collections.abc import Iterable
from functools import cache
from typing import NamedTuple

import casadi

from fmus.block import Block
from fmus.block.variables import BlockVariable
from fmus.build.symbolic import Traced, traced


class Mode(NamedTuple):
    """Mode of an FMU: expressions of what is calculated in it, and the symbols that they follow from.

    arguments: symbols t, x, u, p
    known, unknown: value reference -> symbol of what is set, expression of what is calculated
    """

    arguments: list[casadi.SX]
    known: dict[int, casadi.SX]
    unknown: dict[int, casadi.SX]

    def dependencies(self, among: Iterable[BlockVariable] | None = None) -> dict[int, tuple[int, ...]]:
        """Returns value reference of each unknown -> those of the knowns behind it; among: these alone."""
        chosen = {*self.known} if among is None else {v.value_reference for v in among}
        knowns, unknowns = [*self.known], [*self.unknown]
        sparsity = casadi.jacobian_sparsity(*map(_column, (self.unknown, self.known)))
        found: dict[int, set[int]] = {unknown: set() for unknown in unknowns}
        for row, column in zip(*sparsity.get_triplet(), strict=True):
            found[unknowns[row]].add(knowns[column])
        return {unknown: tuple(sorted(behind & chosen)) for unknown, behind in found.items()}

    def derivative(self, name: str, count: int, is_adjoint: bool) -> casadi.Function:
        """Returns the function (t, x, u, p, v) -> sensitivities of unknowns along the seed v of knowns.

        count: of all variables, the length of seed and result, which are 0 where there is nothing to say
        is_adjoint: of the knowns along a seed of the unknowns
        """
        seed, along = casadi.SX.sym("v", count), casadi.SX.zeros(count)
        given, derived = (self.unknown, self.known) if is_adjoint else (self.known, self.unknown)
        unknown, known = _column(self.unknown), _column(self.known)
        along[[*derived]] = casadi.jtimes(unknown, known, seed[[*given]], is_adjoint)
        return casadi.Function(name, [*self.arguments, seed], [casadi.cse(along)], [*"txupv"], ["along"])


def _column(expressions: dict[int, casadi.SX]) -> casadi.SX:
    return casadi.vertcat(*expressions.values()) if expressions else casadi.SX(0, 1)


class Sensitivities:
    """The modes of a block: initialization, step mode of co-simulation, and those of model exchange."""

    def __init__(self, functions: Traced) -> None:
        block = functions.block
        self._count = len(block.variables) + len(block.states) + 1
        t, x, u, p = arguments = [
            casadi.SX.sym("t"),
            *(casadi.SX.sym(name, functions.step.numel_in(i)) for name, i in (("x", 2), ("u", 3), ("p", 4))),
        ]
        c = functions.calculate(p)
        start = functions.initial_state(t, u, p, c)
        count = len(block.states) // 2
        inputs = _at(block.of_causality("parameter"), p) | _at(block.of_causality("input"), u)
        time = {self._count - 1: t}
        outputs = block.of_causality("output")

        def held(x: casadi.SX) -> casadi.SX:
            return functions.held(t, x, u, p, c)

        def calculated(x: casadi.SX, of_outputs: casadi.SX) -> dict[int, casadi.SX]:
            rates = functions.derivative(t, held(x), u, p, c) if count else casadi.SX()
            return _at(outputs, functions.output(t, of_outputs, p, c)) | _at(block.states[count:], rates)

        known = inputs | _at(block.states[:count], x) | time
        self._calculated = _at(block.of_causality("calculatedParameter"), c)
        first = self._calculated | _at(block.states[:count], start)
        self.initial = Mode(arguments, inputs | time, first | calculated(start, start))
        self.step = Mode(arguments, known, calculated(x, x))
        # without continuous states outputs are the same at all times
        self.exchange = Mode(arguments, known, calculated(x, held(x))) if count else self.step

    def functions(self, fmi: int) -> dict[str, casadi.Function]:
        """Returns the functions of an FMU of a version of the standard, by name.

        Those of FMI 2.0 are forward alone, and in all modes of calculated parameters, too.
        """
        modes = {"initial": self.initial, "step": self.step}
        if self.exchange is not self.step:
            modes["exchange"] = self.exchange
        more, kinds = (self._calculated, ("forward",)) if fmi == 2 else ({}, ("forward", "adjoint"))
        functions: dict[str, casadi.Function] = {}
        for name, mode in modes.items():
            of_all = mode._replace(unknown=more | mode.unknown)
            for kind in kinds:
                own = f"{name}_{kind}"
                functions[own] = of_all.derivative(own, self._count, kind == "adjoint")
        return functions


def _at(variables: tuple, values: casadi.SX) -> dict[int, casadi.SX]:
    return {v.value_reference: values[i] for i, v in enumerate(variables)}


@cache
def sensitivities(block: Block) -> Sensitivities:
    """Returns the modes of a block, traced once in a process."""
    return Sensitivities(traced(block))

"""Directional and adjoint derivatives of FMI 3.0 (2.2.12), and which variables follow from which.

All values of the variables are one column `v`, at the places of their value references: those of the block,
its continuous states, their derivatives, and time.
"""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import casadi

from fmus.block import Block
from fmus.build.symbolic import Traced, traced


class Mode(NamedTuple):
    """What is calculated in one mode: expressions by value reference, and the symbols that they follow from.

    arguments: symbols t, x, u, p
    known, unknown: value reference -> symbol of what is set, expression of what is calculated
    """

    arguments: list[casadi.SX]
    known: dict[int, casadi.SX]
    unknown: dict[int, casadi.SX]

    def dependencies(self) -> dict[int, tuple[int, ...]]:
        """Returns value reference of each unknown -> those of the knowns behind it."""
        knowns, unknowns = [*self.known], [*self.unknown]
        sparsity = casadi.jacobian_sparsity(*map(_column, (self.unknown, self.known)))
        found: dict[int, set[int]] = {unknown: set() for unknown in unknowns}
        for row, column in zip(*sparsity.get_triplet(), strict=True):
            found[unknowns[row]].add(knowns[column])
        return {unknown: tuple(sorted(references)) for unknown, references in found.items()}

    def derivatives(self, name: str, count: int) -> dict[str, casadi.Function]:
        """Returns NAME_forward and NAME_adjoint: (t, x, u, p, v) -> sensitivities along the seed v.

        count: of all variables, the length of seed and result, which are 0 where there is nothing to say
        """
        seed, (known, unknown) = casadi.SX.sym("v", count), map(_column, (self.known, self.unknown))
        forward = casadi.jtimes(unknown, known, seed[[*self.known]])
        adjoint = casadi.jtimes(unknown, known, seed[[*self.unknown]], True)
        functions = {}
        for kind, references, result in (
            ("forward", self.unknown, forward),
            ("adjoint", self.known, adjoint),
        ):
            along = casadi.SX.zeros(count)
            along[[*references]] = result
            functions[f"{name}_{kind}"] = casadi.Function(
                f"{name}_{kind}", [*self.arguments, seed], [casadi.cse(along)], [*"txupv"], ["along"]
            )
        return functions


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

        def calculated(x: casadi.SX, held: Callable[[casadi.SX], casadi.SX]) -> dict[int, casadi.SX]:
            rates = functions.derivative(t, functions.held(t, x, u, p, c), u, p, c) if count else casadi.SX()
            return _at(outputs, functions.output(t, held(x), p, c)) | _at(block.states[count:], rates)

        def between_events(x: casadi.SX) -> casadi.SX:
            return functions.held(t, x, u, p, c) if count else x

        known = inputs | _at(block.states[:count], x) | time
        first = _at(block.of_causality("calculatedParameter"), c) | _at(block.states[:count], start)
        self.initial = Mode(arguments, inputs | time, first | calculated(start, lambda x: x))
        self.step = Mode(arguments, known, calculated(x, lambda x: x))
        self.exchange = Mode(arguments, known, calculated(x, between_events))

    def functions(self) -> dict[str, casadi.Function]:
        """Returns the functions of an FMU, by name."""
        modes = {"initial": self.initial, "step": self.step, "exchange": self.exchange}
        named = [mode.derivatives(name, self._count) for name, mode in modes.items()]
        return {name: function for functions in named for name, function in functions.items()}


def _at(variables: tuple, values: casadi.SX) -> dict[int, casadi.SX]:
    return {v.value_reference: values[i] for i, v in enumerate(variables)}


@cache
def sensitivities(block: Block) -> Sensitivities:
    """Returns the modes of a block, traced once in a process."""
    return Sensitivities(traced(block))

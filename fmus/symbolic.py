"""A block traced to CasADi: what its functions compute, as expressions.

Used where the structure of a block is wanted rather than its values: which initial output depends
on what, and proof that every block can be traced.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi

from fmus.block import Block, flatten, unflatten


@dataclass(frozen=True)
class Traced:
    """The functions of a block over column vectors, in the order of `flatten`."""

    block: Block

    @cached_property
    def step(self) -> casadi.Function:
        """(t, h, state, inputs, parameters) -> state."""
        h, state = casadi.SX.sym("h"), self._of(self._state_template)
        after = self.block.step(
            self._t, h, state.filled, self._inputs.filled, self._parameters.filled, self._calculated
        )
        arguments = [self._t, h, state.column, self._inputs.column, self._parameters.column]
        return casadi.Function("step", arguments, [_column(after)])

    @cached_property
    def output(self) -> casadi.Function:
        """(t, state, parameters) -> outputs."""
        state = self._of(self._state_template)
        outputs = self.block.output(self._t, state.filled, self._parameters.filled, self._calculated)
        arguments = [self._t, state.column, self._parameters.column]
        return casadi.Function("output", arguments, [_column(outputs)])

    @cached_property
    def initial_state(self) -> casadi.Function:
        """(t, inputs, parameters) -> state."""
        arguments = [self._t, self._inputs.column, self._parameters.column]
        return casadi.Function("initial_state", arguments, [_column(self._initial_state)])

    @cached_property
    def initial_unknowns(self) -> casadi.Function:
        """(parameters, inputs) -> calculated parameters and outputs, in initialisation mode."""
        outputs = self.block.output(self._t, self._initial_state, self._parameters.filled, self._calculated)
        unknowns = casadi.vertcat(_column(self._calculated), _column(outputs))
        known = [casadi.vertcat(self._parameters.column, self._inputs.column)]
        return casadi.Function("initial_unknowns", [self._t, *known], [unknowns], {"allow_free": False})

    @cached_property
    def _t(self) -> casadi.SX:
        return casadi.SX.sym("t")

    @cached_property
    def _parameters(self) -> "_Symbols":
        return self._of(self.block.parameters)

    @cached_property
    def _inputs(self) -> "_Symbols":
        return self._of(self.block.inputs)

    @cached_property
    def _calculated(self) -> Any:
        return self.block.calculate(self._parameters.filled)

    @cached_property
    def _initial_state(self) -> Any:
        return self.block.initial_state(
            self._t, self._inputs.filled, self._parameters.filled, self._calculated
        )

    @property
    def _state_template(self) -> Any:
        return self._initial_state

    @staticmethod
    def _of(template: Any) -> "_Symbols":
        names = flatten(template() if isinstance(template, type) else template)
        column = casadi.SX.sym("x", len(names))
        return _Symbols(column, unflatten(template, [column[i] for i in range(len(names))]))


@dataclass(frozen=True)
class _Symbols:
    """A column of symbols and the dataclass that they fill."""

    column: casadi.SX
    filled: Any


def _column(value: Any) -> casadi.SX:
    return casadi.vertcat(*flatten(value)) if flatten(value) else casadi.SX(0, 1)


def initial_dependencies(block: Block) -> dict[int, tuple[int, ...]]:
    """Value reference of each initial unknown -> those of the parameters and inputs it follows from."""
    unknowns = (*block.of_causality("calculatedParameter"), *block.of_causality("output"))
    knowns = (*block.of_causality("parameter"), *block.of_causality("input"))
    sparsity = Traced(block).initial_unknowns.jac_sparsity(0, 1)
    found: dict[int, list[int]] = {v.value_reference: [] for v in unknowns}
    for row, column in zip(*sparsity.get_triplet(), strict=True):
        found[unknowns[row].value_reference].append(knowns[column].value_reference)
    return {unknown: tuple(sorted(known)) for unknown, known in found.items()}

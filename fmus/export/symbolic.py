"""A block traced to CasADi: what its functions compute, as expressions and as C99.

Every function takes and gives column vectors in the order of `flatten`; parameters `p`, calculated
parameters `c`, inputs `u`, state `x`, outputs `y`, times `t` and `h` in s.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi

from fmus.block import Block, flatten, unflatten


@dataclass(frozen=True)
class Traced:
    """The functions of a block as CasADi functions."""

    block: Block

    @cached_property
    def calculate(self) -> casadi.Function:
        """p -> c."""
        return self._function("calculate", [self._p], self.block.calculate(self._p.filled))

    @cached_property
    def requirements(self) -> casadi.Function:
        """(p, c) -> 1 for each condition that holds, 0 for each that does not."""
        conditions = self.block.requirements(self._p.filled, self._c.filled)
        return self._function("requirements", [self._p, self._c], tuple(holds for holds, _ in conditions))

    @cached_property
    def required(self) -> tuple[str, ...]:
        """What each of the requirements expects, in words."""
        return tuple(text for _, text in self.block.requirements(self._p.filled, self._c.filled))

    @cached_property
    def initial_state(self) -> casadi.Function:
        """(t, u, p, c) -> x."""
        return self._function("initial_state", [self._t, self._u, self._p, self._c], self._initial)

    @cached_property
    def step(self) -> casadi.Function:
        """(t, h, x, u, p, c) -> x."""
        arguments = [self._t, self._h, self._x, self._u, self._p, self._c]
        return self._function("step", arguments, self.block.step(*(each.filled for each in arguments)))

    @cached_property
    def output(self) -> casadi.Function:
        """(t, x, p, c) -> y."""
        arguments = [self._t, self._x, self._p, self._c]
        return self._function("output", arguments, self.block.output(*(each.filled for each in arguments)))

    @cached_property
    def output_rate(self) -> casadi.Function:
        """(t, x, u, p, c) -> dy/dt just after t: the derivative of the outputs after a step by its length."""
        t, h, x, u, p, c = (each.filled for each in (self._t, self._h, self._x, self._u, self._p, self._c))
        y = _column(self.block.output(t + h, self.block.step(t, h, x, u, p, c), p, c))
        rate = casadi.substitute(casadi.jacobian(y, h), h, 0.0)
        return self._function("output_rate", [self._t, self._x, self._u, self._p, self._c], rate)

    @cached_property
    def initial_unknowns(self) -> casadi.Function:
        """(t, p, u) -> (c, y): what is calculated in initialisation mode."""
        return self._function("initial_unknowns", [self._t, self._p, self._u], self._initial_unknowns)

    @cached_property
    def initial_derivative(self) -> casadi.Function:
        """(t, p, u, v) -> directional derivative of (c, y) along the seed v of (p, u)."""
        known = casadi.vertcat(self._p.column, self._u.column)
        return self._along("initial_derivative", [self._t, self._p, self._u], self._initial_unknowns, known)

    @cached_property
    def output_derivative(self) -> casadi.Function:
        """(t, x, p, v) -> directional derivative of (c, y) along the seed v of p, the state held."""
        c = self.block.calculate(self._p.filled)
        y = self.block.output(self._t.filled, self._x.filled, self._p.filled, c)
        unknowns = casadi.vertcat(_column(c), _column(y))
        return self._along("output_derivative", [self._t, self._x, self._p], unknowns, self._p.column)

    def c_code(self) -> str:
        """All functions as static C99 functions called MODEL_FUNCTION, after CasADi's convention."""
        generator = casadi.CodeGenerator(self.block.name)
        for function in self.functions():
            generator.add(function)
        return generator.dump()

    def functions(self) -> list[casadi.Function]:
        """Everything that an FMU needs."""
        return [
            self.calculate,
            self.requirements,
            self.initial_state,
            self.step,
            self.output,
            self.output_rate,
            self.initial_derivative,
            self.output_derivative,
        ]

    # symbols

    @cached_property
    def _t(self) -> "_Symbols":
        return _scalar("t")

    @cached_property
    def _h(self) -> "_Symbols":
        return _scalar("h")

    @cached_property
    def _p(self) -> "_Symbols":
        return _symbols(self.block.parameters)

    @cached_property
    def _c(self) -> "_Symbols":
        return _symbols(self.block.calculated)

    @cached_property
    def _u(self) -> "_Symbols":
        return _symbols(self.block.inputs)

    @cached_property
    def _x(self) -> "_Symbols":
        return _symbols(self._initial)

    @cached_property
    def _initial(self) -> Any:
        return self.block.initial_state(self._t.filled, self._u.filled, self._p.filled, self._c.filled)

    @cached_property
    def _initial_unknowns(self) -> casadi.SX:
        t, u, p = self._t.filled, self._u.filled, self._p.filled
        c = self.block.calculate(p)
        y = self.block.output(t, self.block.initial_state(t, u, p, c), p, c)
        return casadi.vertcat(_column(c), _column(y))

    def _along(self, name: str, arguments: list, result: casadi.SX, known: casadi.SX) -> casadi.Function:
        seed = casadi.SX.sym("v", known.numel())
        seeded = [*arguments, _Symbols(seed, None)]
        return self._function(name, seeded, casadi.jtimes(result, known, seed))

    def _function(self, name: str, arguments: list["_Symbols"], result: Any) -> casadi.Function:
        column = result if isinstance(result, casadi.SX) else _column(result)
        columns = [each.column for each in arguments]
        return casadi.Function(f"{self.block.name}_{name}", columns, [casadi.cse(casadi.densify(column))])


@dataclass(frozen=True)
class _Symbols:
    """A column of symbols and what it fills: a scalar or a dataclass."""

    column: casadi.SX
    filled: Any


def _scalar(name: str) -> _Symbols:
    symbol = casadi.SX.sym(name)
    return _Symbols(symbol, symbol)


def _symbols(template: Any) -> _Symbols:
    count = len(flatten(template() if isinstance(template, type) else template))
    column = casadi.SX.sym("x", count)
    return _Symbols(column, unflatten(template, [column[i] for i in range(count)]))


def _column(value: Any) -> casadi.SX:
    scalars = flatten(value)
    return casadi.vertcat(*(casadi.SX(each) for each in scalars)) if scalars else casadi.SX(0, 1)


def initial_dependencies(block: Block) -> dict[int, tuple[int, ...]]:
    """Value reference of each initial unknown -> those of the parameters and inputs it follows from."""
    unknowns = (*block.of_causality("calculatedParameter"), *block.of_causality("output"))
    function = Traced(block).initial_unknowns
    found: dict[int, list[int]] = {v.value_reference: [] for v in unknowns}
    for argument, causality in ((1, "parameter"), (2, "input")):
        knowns = block.of_causality(causality)
        for row, column in zip(*function.jac_sparsity(0, argument).get_triplet(), strict=True):
            found[unknowns[row].value_reference].append(knowns[column].value_reference)
    return {unknown: tuple(sorted(known)) for unknown, known in found.items()}

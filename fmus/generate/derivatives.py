"""Modes of an FMU: the knowns and unknowns of each, their dependencies and directional derivatives."""

from collections.abc import Iterable
from typing import NamedTuple

from fmus.block.variables import BlockVariable
from fmus.extras import imports_of
from fmus.generate.operations import follows_from, operations_of
from fmus.generate.trace import Traced

with imports_of("build", "building an FMU"):
    import casadi

_STEEP = {"SQRT", "POW", "CONSTPOW", "ASIN", "ACOS", "ACOSH", "ATANH", "ATAN2", "HYPOT"}
_STEEP |= {"LOG", "LOG1P", "INV"}
"""Operations whose derivatives may be infinite or NaN; a quotient by its divisor is another one."""


class Mode(NamedTuple):
    """Mode of an FMU: the expressions of its unknowns, and the symbols of its knowns.

    arguments: symbols t, x, u, p
    known, unknown: value reference -> symbol that is set, expression that is calculated
    """

    arguments: list[casadi.SX]
    known: dict[int, casadi.SX]
    unknown: dict[int, casadi.SX]

    def dependencies(self, among: Iterable[BlockVariable] | None = None) -> dict[int, tuple[int, ...]]:
        """Returns value reference of each unknown -> value references of the knowns that it depends on.

        among: the only knowns to list
        """
        chosen = {*self.known} if among is None else {v.value_reference for v in among}
        knowns, unknowns = [*self.known], [*self.unknown]
        sparsity = casadi.jacobian_sparsity(*map(_column, (self.unknown, self.known)))
        found: dict[int, set[int]] = {unknown: set() for unknown in unknowns}
        for row, column in zip(*sparsity.get_triplet(), strict=True):
            found[unknowns[row]].add(knowns[column])
        return {unknown: tuple(sorted(behind & chosen)) for unknown, behind in found.items()}

    def derivative(self, name: str, count: int, is_adjoint: bool) -> casadi.Function:
        """Returns the function (t, x, u, p, v) -> sensitivities of unknowns along the seed v of knowns.

        count: the length of seed and result, which are 0 for variables that are no knowns or unknowns
        is_adjoint: whether the result is of the knowns, along a seed of the unknowns
        """
        seed, along = casadi.SX.sym("v", count), casadi.SX.zeros(count)
        given, derived = (self.unknown, self.known) if is_adjoint else (self.known, self.unknown)
        unknown, known = _column(self.unknown), _column(self.known)
        along[[*derived]] = casadi.jtimes(unknown, known, seed[[*given]], is_adjoint)
        return casadi.Function(name, [*self.arguments, seed], [casadi.cse(along)], [*"txupv"], ["along"])


def _column(expressions: dict[int, casadi.SX]) -> casadi.SX:
    return casadi.vertcat(*expressions.values()) if expressions else casadi.SX(0, 1)


class Sensitivities:
    """The modes of a block: initialization, step mode of co-simulation, and the modes of model exchange."""

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
        self._settable = (*block.of_causality("parameter"), *block.of_causality("input"))
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
        # Without continuous states, outputs between events are outputs of step mode.
        self.exchange = Mode(arguments, known, calculated(x, held(x))) if count else self.step
        # States that are no variables get places behind the time.
        places = [*range(self._count, self._count + x.numel())]
        places[:count] = [v.value_reference for v in block.states[:count]]
        before, after = (dict(zip(places, casadi.vertsplit(s), strict=True)) for s in (x, start))
        self._start = Mode(arguments, inputs | time, inputs | time | after)
        self._whole = Mode(arguments, known | before, before | self.step.unknown)

    def of_settable(self) -> dict[int, tuple[int, ...]]:
        """Returns value reference of each initial unknown -> those parameters and inputs it depends on."""
        return self.initial.dependencies(self._settable)

    def functions(self, fmi: int) -> dict[str, casadi.Function]:
        """Returns the functions of an FMU of a version of the standard, by name.

        FMI 2.0 has forward derivatives alone. With start_KIND in place of initial_KIND, derivatives of
        initialization are made of two functions: of the initial state, and of step mode. The functions of
        step mode then have seeds and results of the rest of the state, too, behind the time.
        """
        modes, size = {"initial": self.initial, "step": self.step}, self._count
        if self._is_smooth():
            modes, size = {"start": self._start, "step": self._whole}, size + self._whole.arguments[1].numel()
        if self.exchange is not self.step:
            modes["exchange"] = self.exchange
        functions: dict[str, casadi.Function] = {}
        for name, mode in modes.items():
            more = {} if name == "start" else self._calculated
            of_all = mode._replace(unknown=more | mode.unknown)
            for kind in ("forward",) if fmi == 2 else ("forward", "adjoint"):
                own = f"{name}_{kind}"
                functions[own] = of_all.derivative(own, size, kind == "adjoint")
        return functions

    def _is_smooth(self) -> bool:
        """Whether no seed 0 of the state can meet an infinite slope in step mode, which gives no number."""
        column = _column(self.step.unknown)
        operations = operations_of(
            casadi.Function("unknown", self.step.arguments, [column], [*"txup"], ["y"])
        )
        follows = follows_from(operations, "x")
        steep = (o.arguments for o in operations if o.name in _STEEP)
        divisors = (o.arguments[1:] for o in operations if o.name == "DIV")
        return not any(follows[number] for numbers in (*steep, *divisors) for number in numbers)


def _at(variables: tuple, values: casadi.SX) -> dict[int, casadi.SX]:
    return {v.value_reference: values[i] for i, v in enumerate(variables)}

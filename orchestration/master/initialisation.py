"""Initial values along the connections, where the declared dependencies form a loop and where they do not.

The unknowns are the connected inputs. Each follows an output, which follows inputs of its component, as far
as the model description says (`InitialUnknowns`; what is not said depends on every input). The strongly
connected components of this graph are settled one after another in topological order:

    no loop   one pass: read the output, set the input
    loop      x = F(x), F the outputs that come of the inputs x: repeated passes, or Newton's method

SciPy finds the components and the standard library their order: a library of graphs would do both, and is not
needed for anything else.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from graphlib import TopologicalSorter
from typing import Any

import numpy as np
from scipy.optimize import approx_fprime, root
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from orchestration.errors import FmuError, OrchestrationError
from orchestration.fmi.instance import FmuInstance
from orchestration.system.experiment import Initialisation
from orchestration.system.system import CheckedSystem, Port

Connection = tuple[Port, Port]

_PASSES = 1000
_TOLERANCE = 1e-12  # of a value or its nominal, whichever is larger
_GROWTH = 1e3  # of the change from pass to pass: it will not settle any more
_WORSE = 10.0  # than the worst residual that was seen: the one of a value that is discarded
_SINGULAR = 1e-7  # smallest singular value of the Jacobian; difference quotients are good to about 1e-8
_DIFFERENCE = 1.5e-8  # relative change for a difference quotient, about the root of the rounding


@dataclass(frozen=True)
class Group:
    """Connections whose values follow each other in a loop, or one that follows no later one."""

    connections: tuple[Connection, ...]
    is_loop: bool


class _NotSettledError(Exception):
    """What a method ended with, in words."""


def settle(order: Sequence[Group], components: Mapping[str, FmuInstance], method: Initialisation) -> None:
    """Exchange initial values until every connected input equals its output; in initialisation mode.

    order: of `groups`
    Raises OrchestrationError for a loop of which no solution is found, FmuError for what an FMU refuses.
    """
    for group in order:
        if group.is_loop:
            _settle_loop(_Loop(group.connections, components), method)
        else:
            _settle_once(group.connections, components)


def groups(checked: CheckedSystem) -> tuple[Group, ...]:
    """The strongly connected components of the connected inputs, in the order in which values flow."""
    connections = checked.connections
    place = {target.name: i for i, (_, target) in enumerate(connections)}
    before = [
        {place[name] for name in checked.initial_dependencies(source) if name in place}
        for source, _ in connections
    ]
    edges = [(earlier, i) for i, all_earlier in enumerate(before) for earlier in all_earlier]
    rows, columns = np.array(edges, dtype=int).reshape(-1, 2).T
    matrix = coo_array((np.ones(len(edges)), (rows, columns)), shape=(len(before), len(before)))
    labels = connected_components(matrix.tocsr(), connection="strong")[1].tolist() if connections else []
    members: dict[int, list[int]] = {}
    for i, label in enumerate(labels):
        members.setdefault(label, []).append(i)
    graph = {
        label: {labels[earlier] for i in inside for earlier in before[i]} - {label}
        for label, inside in members.items()
    }
    return tuple(
        Group(
            connections=tuple(connections[i] for i in members[label]),
            is_loop=len(members[label]) > 1 or members[label][0] in before[members[label][0]],
        )
        for label in TopologicalSorter(graph).static_order()
    )


def _settle_once(connections: Sequence[Connection], components: Mapping[str, FmuInstance]) -> None:
    try:
        _pass(connections, components)
    except _NotSettledError as reason:
        raise OrchestrationError(f"initial values: {reason}") from reason


def _pass(connections: Sequence[Connection], components: Mapping[str, FmuInstance]) -> list[float]:
    """Read each output and set its input, one after the other; the values."""
    values = []
    for source, target in connections:
        value = components[source.component].get(source.variable)
        if not math.isfinite(value):
            raise _NotSettledError(
                f"{source.name} is {value:g}: expected a finite number, as it goes to {target.name}"
            )
        components[target.component].set(target.variable, value)
        values.append(value)
    return values


class _Loop:
    """x = F(x), x being the inputs of the connections of a loop."""

    def __init__(self, connections: Sequence[Connection], components: Mapping[str, FmuInstance]) -> None:
        self.connections, self.components = connections, components
        self.nominal = np.array([_nominal(connection) for connection in connections])
        self.is_real = all(target.variable.type == "Real" for _, target in connections)

    @property
    def names(self) -> str:
        return ", ".join(target.name for _, target in self.connections)

    def values(self) -> np.ndarray:
        return np.array([self.components[t.component].get(t.variable) for _, t in self.connections], float)

    def outputs(self, values: np.ndarray) -> np.ndarray:
        """F: set the inputs, then read the outputs."""
        for (_, target), value in zip(self.connections, values.tolist(), strict=True):
            self.components[target.component].set(target.variable, value)
        return np.array([self.components[s.component].get(s.variable) for s, _ in self.connections])

    def scaled(self, change: np.ndarray, values: np.ndarray) -> float:
        """The largest change of a value, relative to it or to its nominal; infinite if it is no number."""
        with np.errstate(invalid="ignore", over="ignore"):
            largest = np.max(np.abs(change) / np.maximum(np.abs(values), self.nominal))
        return float(largest) if math.isfinite(largest) else math.inf


def _nominal(connection: Connection) -> float:
    """The input's nominal, or the output's, or 1."""
    stated = [port.variable.nominal for port in reversed(connection) if port.variable.nominal is not None]
    return abs(float(stated[0])) or 1.0 if stated else 1.0


def _settle_loop(loop: _Loop, method: Initialisation) -> None:
    start = loop.values()
    said = []
    if method is not Initialisation.NEWTON:
        try:
            _iterate(loop)
            return
        except _NotSettledError as reason:
            said.append(str(reason))
    if method is not Initialisation.FIXED_POINT:
        try:
            _solve(loop, start)
            return
        except _NotSettledError as reason:
            said.append(str(reason))
    raise OrchestrationError(
        f"initial values: the loop {loop.names} has no solution that was found ({'; '.join(said)}); "
        "break it, or let its FMUs start from other values"
    )


def _iterate(loop: _Loop) -> None:
    """Repeat passes until the last one changes nothing."""
    before, least, change = np.full(len(loop.connections), math.inf), math.inf, math.inf
    for _ in range(_PASSES):
        try:
            values = np.array(_pass(loop.connections, loop.components), float)
        except FmuError as error:
            raise _refusal("repeated exchange stops", error) from error
        change = np.max(np.abs(values - before) / loop.nominal)
        if loop.scaled(values - before, values) <= _TOLERANCE:
            return
        if _GROWTH * least < change < math.inf:
            raise _NotSettledError(f"repeated exchange diverges, from changes of {least:.3g} to {change:.3g}")
        before, least = values, min(least, change)
    raise _NotSettledError(f"repeated exchange still changes values by {change:.3g} after {_PASSES} passes")


def _solve(loop: _Loop, start: np.ndarray) -> None:
    """Newton's method (Powell's hybrid one) on F(x) - x, in units of the nominals.

    A value that an FMU discards, or answers with no number, counts as bad: the method takes a shorter step.
    """
    if not loop.is_real:
        raise _NotSettledError("Newton's method needs variables of type Real")
    discards: list[FmuError] = []
    worst = np.zeros(len(start))

    def residual(scaled: np.ndarray) -> np.ndarray:
        values = scaled * loop.nominal
        return (loop.outputs(values) - values) / loop.nominal

    def guarded(scaled: np.ndarray) -> np.ndarray:
        try:
            found = residual(scaled)
        except FmuError as error:
            if error.status != "discard" or not worst.any():
                raise
            discards.append(error)
            return _WORSE * worst
        if not np.all(np.isfinite(found)) and worst.any():
            return _WORSE * worst
        worst[:] = np.fmax(worst, np.abs(found).max())
        return found

    try:
        found = root(guarded, start / loop.nominal, options={"xtol": 1e-15}).x
        _check_solution(loop, found, residual)
    except FmuError as error:
        raise _refusal("Newton's method stops", error) from error
    except _NotSettledError as reason:
        raise _refusal(str(reason), discards[-1]) if discards else reason from None


def _check_solution(loop: _Loop, found: np.ndarray, residual: Callable[[np.ndarray], np.ndarray]) -> None:
    values = found * loop.nominal
    width = _DIFFERENCE * np.maximum(np.abs(found), 1.0)
    jacobian: Any = approx_fprime(found, residual, width)
    left = residual(found) * loop.nominal  # last, so that the FMUs keep these values
    remains = loop.scaled(left, values)
    if remains > _TOLERANCE:
        raise _NotSettledError(f"Newton's method ends where values still differ by {remains:.3g}")
    if np.linalg.svd(np.atleast_2d(jacobian), compute_uv=False)[-1] < _SINGULAR:
        raise _NotSettledError("Newton's method ends where the loop is singular: no solution stands alone")


def _refusal(method: str, error: FmuError) -> _NotSettledError:
    """A discarded value may be followed by another; anything worse is raised as it is."""
    if error.status != "discard":
        raise error
    return _NotSettledError(f"{method}, and a value was discarded: {error}")

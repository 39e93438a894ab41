"""Initial values: parameters and inputs are set, and outputs exchanged until every connection is consistent.

The groups of connections (`CheckedSystem.connection_groups`) follow each other. A connection outside of any
loop is exchanged once. A loop is x = F(x), x the inputs of the loop, F the outputs that result from them. It
is solved by fixed-point iteration, by Newton's method, or by both in this order.
"""

import math
import zlib
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import numpy as np

from fmus.fmi.instance import FmuInstance
from fmus.fmi.model_description import ScalarVariable
from fmus.fmi.variable_types import FmiValue
from orchestration.errors import FmuError, OrchestrationError
from orchestration.system.experiment import Initialisation
from orchestration.system.prepared_run import PreparedRun, Setting
from orchestration.system.system import CheckedSystem, LinearTransformation, Port

_MOST_ITERATIONS = 1000
_TOLERANCE = 1e-12  # of a value or its nominal, whichever is larger
_DIVERGENCE = 1e3  # growth of the change from iteration to iteration, from which on it diverges
# of Newton's method, and of one of its steps
_MOST_STEPS, _MOST_HALVINGS = 100, 30
# Smallest singular value of the Jacobian: difference quotients are good to about 1e-8.
_SINGULAR = 1e-7
# Relative change for a difference quotient, about the square root of the rounding error.
_DIFFERENCE = 1.5e-8


def initialise(
    prepared: PreparedRun, instances: Mapping[str, FmuInstance], settings: Sequence[Setting] | None = None
) -> None:
    """Brings new instances to step mode with consistent initial values.

    settings: in place of `prepared.initial_settings`
    """
    experiment = prepared.experiment
    sorted_settings: dict[tuple[str, bool], list[tuple[ScalarVariable, FmiValue]]] = defaultdict(list)
    for port, value in prepared.initial_settings if settings is None else settings:
        is_input = port.variable.causality == "input"
        sorted_settings[port.component, is_input].append((port.variable, value))
    for name, instance in instances.items():
        times = experiment.start_time, experiment.stop_time
        instance.initialise(*times, experiment.fmu_tolerance, sorted_settings[name, False])
    for name, instance in instances.items():
        instance.set_all(sorted_settings[name, True])
    solve_initial_values(prepared.system, instances, Initialisation(experiment.initialisation))
    for instance in instances.values():
        instance.exit_initialization_mode()


def solve_initial_values(
    system: CheckedSystem, instances: Mapping[str, FmuInstance], method: Initialisation
) -> None:
    """Exchanges values, in initialization mode, until every connected input equals its output.

    Raises OrchestrationError for a loop without a solution, FmuError for a call that an FMU refuses.
    """
    for group in system.connection_groups:
        loop = Loop(group.connections, system.transformations, instances)
        if group.is_loop:
            loop.solve(method)
            continue
        try:
            loop.exchange()
        except NoSolutionError as reason:
            raise OrchestrationError(f"initial values: {reason}") from reason


class NoSolutionError(Exception):
    """Error of values that could not be found."""


class Loop:
    """Connections of an algebraic loop, or one connection in no loop: x = F(x), x the inputs, shape (n,).

    transformations: of connections, by the names of their inputs
    """

    def __init__(
        self,
        connections: Sequence[tuple[Port, Port]],
        transformations: Mapping[str, LinearTransformation],
        instances: Mapping[str, FmuInstance],
    ) -> None:
        self._connections, self._transformations, self._instances = connections, transformations, instances

    @cached_property
    def nominal(self) -> np.ndarray:
        """Nominal values of the inputs, shape (n,)."""
        return np.array([nominal_of(connection) for connection in self._connections])

    @property
    def is_real(self) -> bool:
        """Whether all variables are of type Real."""
        return all(port.variable.type == "Real" for ends in self._connections for port in ends)

    def exchange(self) -> list[float]:
        """Reads each output and sets its input, one connection after the other; returns the inputs.

        Raises NoSolutionError for an output that is not finite.
        """
        values = []
        for source, target in self._connections:
            value = self._arriving(source, target)
            number = _number(value)
            if not math.isfinite(number):
                raise NoSolutionError(
                    f"{source.name} is {value:g}: expected a finite number, as it goes to {target.name}"
                )
            self._instances[target.component].set(target.variable, value)
            values.append(number)
        return values

    def values(self) -> np.ndarray:
        """Returns the present inputs x."""
        return np.array([_number(self._instances[t.component].get(t.variable)) for _, t in self._connections])

    def outputs(self, values: np.ndarray) -> np.ndarray:
        """Returns F(x): sets the inputs, then reads the outputs."""
        for (_, target), value in zip(self._connections, values.tolist(), strict=True):
            self._instances[target.component].set(target.variable, value)
        return np.array([self._arriving(source, target) for source, target in self._connections])

    def relative_size(self, change: np.ndarray, values: np.ndarray) -> float:
        """Returns the largest change of a value over it or its nominal; infinite if it is not a number."""
        with np.errstate(invalid="ignore", over="ignore"):
            largest = np.max(np.abs(change) / np.maximum(np.abs(values), self.nominal))
        return float(largest) if math.isfinite(largest) else math.inf

    def _arriving(self, source: Port, target: Port) -> FmiValue:
        """Returns the value of an output as it arrives at an input."""
        value = self._instances[source.component].get(source.variable)
        transformation = self._transformations.get(target.name)
        return transformation(value) if transformation else value

    def solve(self, method: Initialisation) -> None:
        """Finds inputs that equal their outputs, and sets them.

        Raises OrchestrationError if no method finds a solution, FmuError for a call that an FMU refuses.
        """
        start, reasons = self.values(), []
        names = ", ".join(target.name for _, target in self._connections)
        methods = ((_iterate, Initialisation.NEWTON), (_solve_by_newton, Initialisation.FIXED_POINT))
        for solve, other in methods:
            if method is not other:
                try:
                    return solve(self, start)
                except NoSolutionError as reason:
                    reasons.append(str(reason))
        raise OrchestrationError(
            f"initial values: no solution was found for the loop {names} ({'; '.join(reasons)}); "
            "break it, or let its FMUs start from other values"
        )


def _number(value: FmiValue) -> float:
    """Returns the value; for a String, a number that differs for different texts."""
    return float(zlib.crc32(value.encode()) if isinstance(value, str) else value)


def nominal_of(connection: tuple[Port, Port]) -> float:
    """Returns the input's nominal, or the output's, or 1."""
    declared = (port.variable.nominal for port in reversed(connection))
    return abs(float(next((nominal for nominal in declared if nominal is not None), 1.0))) or 1.0


def _iterate(loop: Loop, start: np.ndarray) -> None:
    """Iterates to a fixed point: exchanges until the values no longer change."""
    before, least, change = np.full(start.shape, math.inf), math.inf, math.inf
    for _ in range(_MOST_ITERATIONS):
        try:
            values = np.array(loop.exchange(), float)
        except FmuError as error:
            raise _discarded_value("fixed-point iteration ends", error) from error
        change = np.max(np.abs(values - before) / loop.nominal)
        if loop.relative_size(values - before, values) <= _TOLERANCE:
            return
        if _DIVERGENCE * least < change < math.inf:
            raise NoSolutionError(
                f"fixed-point iteration diverges, from changes of {least:.3g} to {change:.3g}"
            )
        before, least = values, min(least, change)
    raise NoSolutionError(
        f"fixed-point iteration still changes values by {change:.3g} after {_MOST_ITERATIONS} iterations"
    )


def _solve_by_newton(loop: Loop, start: np.ndarray) -> None:
    """Solves F(x) - x = 0 by Newton's method, in units of the nominals.

    A step to a value that an FMU discards, for which an output is not finite, or that comes no nearer to the
    solution, is halved.
    """
    if not loop.is_real:
        raise NoSolutionError("Newton's method needs variables of type Real")
    discards: list[FmuError] = []

    def residual(scaled: np.ndarray) -> np.ndarray:
        values = scaled * loop.nominal
        return (loop.outputs(values) - values) / loop.nominal

    def size(scaled: np.ndarray) -> float:
        try:
            return float(np.linalg.norm(residual(scaled)))
        except FmuError as error:
            if error.status != "discard":
                raise
            discards.append(error)
            return math.inf

    solution = start / loop.nominal
    try:
        for _ in range(_MOST_STEPS):
            present = residual(solution)
            if not (present.any() and np.all(np.isfinite(present))):
                break
            step, *_ = np.linalg.lstsq(_jacobian(residual, solution, present), -present)
            shortened = (solution + step / 2.0**halvings for halvings in range(_MOST_HALVINGS))
            least = np.linalg.norm(present)
            nearer = next((point for point in shortened if size(point) < least), None)
            if nearer is None:
                break
            solution = nearer
        _check_solution(loop, solution, residual)
    except FmuError as error:
        raise _discarded_value("Newton's method ends", error) from error
    except NoSolutionError as reason:
        raise _discarded_value(str(reason), discards[-1]) if discards else reason from None


def _jacobian(
    residual: Callable[[np.ndarray], np.ndarray], point: np.ndarray, at_point: np.ndarray
) -> np.ndarray:
    """Returns the matrix of difference quotients at a point, shape (n, n)."""
    widths = _DIFFERENCE * np.maximum(np.abs(point), 1.0)
    return np.column_stack([(residual(point + row) - at_point) / row.sum() for row in np.diag(widths)])


def _check_solution(loop: Loop, solution: np.ndarray, residual: Callable[[np.ndarray], np.ndarray]) -> None:
    values = solution * loop.nominal
    jacobian = _jacobian(residual, solution, residual(solution))
    # computed last: the FMUs keep the values of the last evaluation
    difference = residual(solution) * loop.nominal
    size = loop.relative_size(difference, values)
    if size > _TOLERANCE:
        raise NoSolutionError(f"Newton's method ends where values still differ by {size:.3g}")
    if np.linalg.svd(jacobian, compute_uv=False)[-1] < _SINGULAR:
        raise NoSolutionError("Newton's method ends where the loop is singular: its solution is not unique")


def _discarded_value(method: str, error: FmuError) -> NoSolutionError:
    """Returns the reason for a discarded value; any worse error is raised as it is."""
    if error.status != "discard":
        raise error
    return NoSolutionError(f"{method}, and a value was discarded: {error}")

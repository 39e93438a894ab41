"""The permitted error of a step, and errors of the FMUs' own solvers, which no shorter step takes away.

A step in two halves without an exchange between them shows these. An FMU that computes exactly, or with fixed
steps that fit, reaches the same state as in one step. An FMU whose solver starts anew in every step,
with its own tolerance, does not.
"""

from dataclasses import replace

import numpy as np

from fmus.fmi.description import of_causality
from orchestration.run.access import Snapshot
from orchestration.run.loop_data import Call, InputMode
from orchestration.run.run_recording import step_unless_discarded
from orchestration.run.wiring import WiredRun
from orchestration.system.system import CheckedSystem, Port

# Each of the two steps that are compared has an error of the solver.
_OF_TWO_RESULTS = 2.0
# Share of the solvers' errors that is kept from one communication point to the next: they change with the
# state.
_KEPT = 0.5


class Tolerance:
    """The permitted error, relative to max(|value|, nominal), of all Real outputs exchanged or recorded.

    order: of the exchange in the step size
    names, bus_index: of the outputs, (m,)
    adds_up: whether the errors of an output add up from step to step, (m,)
    solver_error: change of the outputs if a step is split, though nothing is exchanged in it, (m,)
    """

    def __init__(self, run: WiredRun) -> None:
        experiment, ports = run.prepared.experiment, run.prepared.system.ports
        groups = [group for group in run.bus.calls[Call.GET_OUTPUTS] if group.type == "Real"]
        outputs = [p for group in groups for p in group.ports if p.variable.causality == "output"]
        self.names = [port.name for port in outputs]
        driven = {ports[target] for _, target in run.bus.connections}
        self.order = 1 + experiment.extrapolation
        self.bus_index = np.array([run.bus.index[name] for name in self.names], np.int64)
        self.solver_error = np.zeros(len(self.names))
        self.relative: float = experiment.tolerance or 0.0
        self.duration = experiment.stop_time - experiment.start_time
        self._nominal = np.array([abs(float(port.variable.nominal or 1.0)) for port in outputs])
        # The error of an output that may depend directly on an input in step mode does not add up from step
        # to step: it is compared with the whole tolerance.
        feedthrough = outputs_with_feedthrough(run.prepared.system, driven)
        self.adds_up = np.array([name not in feedthrough for name in self.names], bool)

    def error_ratios(self, coarse: np.ndarray, fine: np.ndarray, size: float) -> np.ndarray:
        """Returns estimated errors of the fine values over the permitted ones of a step of `size` [s], (m,).

        A value that is not finite in both is left out: 0.
        """
        with np.errstate(invalid="ignore"):
            ratios = self._difference(coarse, fine) / self._permitted(fine, size)
        ratios[~(np.isfinite(coarse) | np.isfinite(fine))] = 0.0
        ratios[np.isnan(ratios)] = np.inf
        return ratios

    def beyond_solvers(self, ratios: np.ndarray, fine: np.ndarray, size: float) -> np.ndarray:
        """Returns `error_ratios` where the solvers' own errors are permitted too."""
        permitted, of_solvers = self._permitted(fine, size), _OF_TWO_RESULTS * self.solver_error
        # False where the value is not finite: such an error is not a solver's
        is_below = of_solvers > permitted
        return np.where(is_below, ratios * permitted / np.where(is_below, of_solvers, 1.0), ratios)

    def is_below_solvers(self, fine: np.ndarray, size: float) -> bool:
        """Whether a solver's own error, as far as it is known, is larger than what is permitted."""
        return bool(np.any(_OF_TWO_RESULTS * self.solver_error > self._permitted(fine, size)))

    def learn_solver_error(self, together: np.ndarray, split: np.ndarray) -> None:
        """Takes the difference of a step and the same in two halves without an exchange between them."""
        difference = self._difference(together, split)
        self.solver_error = np.fmax(self.solver_error, np.where(np.isfinite(difference), difference, 0.0))

    def forget_solver_error(self) -> None:
        """Forgets the solvers' error, at a communication point."""
        self.solver_error = _KEPT * self.solver_error

    def _difference(self, coarse: np.ndarray, fine: np.ndarray) -> np.ndarray:
        """Returns the estimated error of the fine values: the difference over 2^p - 1."""
        return np.abs(fine - coarse) / (2.0**self.order - 1.0)

    def _permitted(self, fine: np.ndarray, size: float) -> np.ndarray:
        share = np.where(self.adds_up, size / self.duration, 1.0)
        return self.relative * np.maximum(np.abs(fine), self._nominal) * share


def outputs_with_feedthrough(system: CheckedSystem, driven: set[Port]) -> set[str]:
    """Returns the outputs that may depend directly on driven inputs in step mode; all if not declared."""
    own = {id(port.variable) for port in driven}
    components = {port.component for port in driven}
    names = set()
    for component, description in system.descriptions.items():
        declared = {id(unknown.variable): unknown.dependencies for unknown in description.outputs}
        for variable in of_causality(description, "output"):
            dependencies = declared.get(id(variable))
            if component in components if dependencies is None else any(id(v) in own for v in dependencies):
                names.add(f"{component}.{variable.name}")
    return names


def step_together_and_split(
    run: WiredRun, before: Snapshot, point: int, start: float, end: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """Returns the bus at `end` [s] after one step, and after two with inputs that go on as in the one.

    before: the snapshot at `start`; point: the communication point at or before it
    None if a component discards a step; raises OrchestrationError if a step fails otherwise. Call
    `before.restore` afterwards.
    """
    wiring = run.wiring
    before.restore()
    if not step_unless_discarded(run, point, start, end):
        return None
    together, slopes = wiring.bus.copy(), wiring.slopes.copy()
    before.restore()
    _carry_on(run, together, slopes, start)
    # Gauss-Seidel would exchange within a half
    halves = replace(run, wiring=wiring._replace(gauss_seidel=0))
    middle = start + 0.5 * (end - start)
    if not (
        step_unless_discarded(halves, point, start, middle)
        and step_unless_discarded(halves, point, middle, end)
    ):
        return None
    return together, wiring.bus.copy()


def _carry_on(run: WiredRun, bus: np.ndarray, slopes: np.ndarray, start: float) -> None:
    """Lets every connection carry the inputs, and slopes, that a step from `start` [s] left on the bus."""
    connections = run.wiring.connections
    target, is_sloped = connections.target, connections.input_mode == InputMode.FMU_DERIVATIVE
    connections.value[:] = run.wiring.bus[target] = bus[target]
    connections.slope[:] = np.where(is_sloped, slopes[target], 0.0)
    connections.sample_time[:] = start
    connections.sample_interval[:] = np.inf

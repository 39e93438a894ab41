"""The loop of our own blocks as their code makes it, linear about the end of a hold.

A communication step of all blocks is one function of their states, and CasADi differentiates it. So the
linear loop has the sampling of sensor and observer, the hold, the exchange of Jacobi's algorithm, the lag of
the thrusters and the adaptation at its gain as the FMUs have them. A period is the number of communication
steps after which every block samples again.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from fmus.block import Block
from fmus.block.instance import internal_steps
from fmus.extras import imports_of
from fmus.fmi.variable_types import FmiValue
from fmus.generate.trace import trace
from fmus.registry import BLOCKS, block_names, installed, load
from orchestration.scenarios.scenario import Scenario
from orchestration.scenarios.vehicle import description_file, description_of
from orchestration.system.experiment import Algorithm
from orchestration.system.prepared_run import PreparedRun
from orchestration.system.system import LinearTransformation
from orchestration.system.values import fmi_value

with imports_of("study", "a margin"):
    import casadi
    from scipy.sparse.csgraph import connected_components

_LONGEST_PERIOD = 64  # communication steps
# of an eigenvalue beyond 1: estimates whose sum alone has an effect have one that is 1 but for rounding
_ROUNDING = 1e-6


class Step(NamedTuple):
    """A communication step of the closed loop, with n states on the loop and m inputs where it may be cut.

    a: of the next state by the state, (n, n); b: by what is added to the inputs, (n, m)
    c: of the values of the inputs by the state, (m, n)
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray


@dataclass(frozen=True)
class CodeLoop:
    """The loop of a scenario about the end of a hold.

    parameters: "component.parameter" -> its place among the values
    points: states, time and signals at the beginning of each step of a period
    drag: linear damping -> quadratic damping, as parameters of vehicles
    """

    jacobians: casadi.Function
    values: Sequence[float]
    parameters: Mapping[str, int]
    points: tuple[tuple[np.ndarray, float, np.ndarray], ...]
    step_size: float
    drag: Mapping[str, str]

    def steps(self, *instead: Mapping[str, float]) -> list[list[Step]]:
        """Returns the steps of a period for each set of other values of parameters, of the same states."""
        sets = []
        for changed in instead:
            values = [*self.values]
            for name, value in changed.items():
                values[self.parameters[name]] = value
            sets.append([Step(*map(np.array, self.jacobians(*point, values))) for point in self.points])
        kept = _on_a_loop([step.a for steps in sets for step in steps])
        return [[Step(a[np.ix_(kept, kept)], b[kept], c[:, kept]) for a, b, c in steps] for steps in sets]

    def is_stable(self, delay: float = 0.0, gain: float = 1.0) -> bool:
        """Whether motions about the hold stay bounded, with late [s] and multiplied values of the inputs."""
        return is_bounded([delayed(step, delay / self.step_size, gain) for step in self._own_steps])

    @cached_property
    def _own_steps(self) -> list[Step]:
        """The steps with the values of the scenario: a search for a margin asks for them again and again."""
        (steps,) = self.steps({})
        return steps


def delayed(step: Step, delay: float, gain: float) -> np.ndarray:
    """Returns the matrix of a step with inputs that are late, on straight lines between communication points.

    delay: in communication steps; the states are followed by the last values of the inputs, newest first
    """
    (n, m), (whole, part) = step.b.shape, divmod(delay, 1.0)
    count = int(whole) + 1
    shares = np.zeros(count + 1)
    shares[count - 1 :] = gain * (1.0 - part), gain * part
    a = np.zeros((n + m * count,) * 2)
    a[:n, :n] = step.a + (shares[0] - 1.0) * step.b @ step.c
    a[:n, n:] = np.kron(shares[1:], step.b)
    a[n : n + m, :n] = step.c
    a[n + m :, n:-m] = np.eye(m * (count - 1))
    return a


def is_bounded(matrices: Iterable[np.ndarray]) -> bool:
    """Whether the eigenvalues of a period lie in the unit circle."""
    return bool(np.abs(np.linalg.eigvals(product(matrices))).max() <= 1.0 + _ROUNDING)


def product(matrices: Iterable[np.ndarray]) -> np.ndarray:
    """Returns the matrix of a period: the product of its steps' matrices."""
    whole, *others = matrices
    for a in others:
        whole = a @ whole
    return whole


def _on_a_loop(matrices: Sequence[np.ndarray]) -> np.ndarray:
    """Returns the numbers of the states of the largest set in which each has an effect on each.

    Others, such as clocks and seeds of noise, drive the loop or follow it, and change no stability.
    """
    _, labels = connected_components(np.any(matrices, axis=0), connection="strong")
    return np.flatnonzero(labels == np.bincount(labels).argmax())


def code_loop(
    chosen: Scenario, until: float, cut: Sequence[str], instead: Mapping[str, FmiValue] = {}
) -> CodeLoop | None:
    """Returns the loop of a scenario about its state at the end of a hold; None if its code is not known.

    It is not known for FMUs of others, and not made for events, faults, extrapolated inputs, components with
    steps of their own, and another algorithm than Jacobi's.

    until: end of the hold [s]; cut: connected inputs; instead: other values of parameters
    """
    prepared, experiment = chosen.prepared, chosen.prepared.experiment
    models = {d.modelName for d in prepared.system.descriptions.values()}
    others = experiment.events, experiment.faults, experiment.extrapolation, experiment.step_sizes
    if any(others) or experiment.algorithm is not Algorithm.JACOBI or not models <= {*block_names()}:
        return None
    return _Blocks(prepared, cut, instead).loop(until)


class _Blocks:
    """A communication step of all blocks, as functions of CasADi.

    Arguments: x, the states; t; s, the signals; d, added to the inputs that are cut; p, the parameters.
    """

    def __init__(self, prepared: PreparedRun, cut: Sequence[str], instead: Mapping[str, FmiValue]) -> None:
        self._prepared, self._size = prepared, prepared.experiment.step_size
        models = {name: d.modelName or "" for name, d in prepared.system.descriptions.items()}
        blocks = {name: load(installed(BLOCKS)[model], "block") for name, model in models.items()}
        traced = {name: trace(block) for name, block in blocks.items()}
        constant = _constants(prepared, blocks, "input")
        parameters = _constants(prepared, blocks, "parameter")
        for key, value in instead.items():
            parameters[key] = float(fmi_value(prepared.system.port(key, "a parameter"), value))
        self._drag = _dampings(blocks, parameters)
        self.parameters, self.values = {name: i for i, name in enumerate(parameters)}, [*parameters.values()]
        signals = [*prepared.experiment.signals]
        counts = {"t": 1, "s": len(signals), "d": len(cut), "p": len(parameters)}
        t, s, d, p = (casadi.SX.sym(name, count) for name, count in counts.items())
        states = {name: casadi.SX.sym("x", each.step.numel_in(2)) for name, each in traced.items()}
        own = {
            name: casadi.vertcat(*(p[self.parameters[key]] for key in _names(name, block, "parameter")))
            for name, block in blocks.items()
        }
        calculated = {name: each.calculate(own[name]) for name, each in traced.items()}
        driven: dict[str, Any] = constant | {name: s[i] for i, name in enumerate(signals)}
        for name, block in blocks.items():
            y = traced[name].output(t, states[name], own[name], calculated[name])
            driven |= {key: y[i] for i, key in enumerate(_names(name, block, "output"))}
        for source, target in prepared.system.connections:
            transformed = prepared.system.transformations.get(target.name, LinearTransformation())
            driven[target.name] = transformed(driven[source.name])
        arriving = casadi.vertcat(*(driven[name] for name in cut))
        driven |= {name: driven[name] + d[i] for i, name in enumerate(cut)}
        after, first = [], []
        for name, block in blocks.items():
            u = casadi.vertcat(*(driven[key] for key in _names(name, block, "input")))
            count = internal_steps(self._size, parameters[f"{name}.internal_step"])
            x, h = states[name], self._size / count
            for i in range(count):
                x = traced[name].step(t + i * h, h, x, u, own[name], calculated[name])
            after.append(x)
            first.append(traced[name].initial_state(t, u, own[name], calculated[name]))
        x, next_x = casadi.vertcat(*states.values()), casadi.vertcat(*after)
        arguments = [x, t, s, d, p]
        self._step = casadi.Function("step", arguments, [next_x])
        self._first = casadi.Function("first", arguments, [casadi.vertcat(*first)])
        pairs = (next_x, x), (next_x, d), (arriving, x)
        jacobians = casadi.Function("at", arguments, [casadi.jacobian(*pair) for pair in pairs])
        self._nothing = casadi.DM.zeros(len(cut))
        results = [*jacobians(x, t, s, self._nothing, p)]
        self._jacobians = casadi.Function("jacobians", [x, t, s, p], results)

    def loop(self, until: float) -> CodeLoop | None:
        """Returns the loop about the state that these blocks reach; None for one without a period."""
        points, prepared = self._prepared.points, self._prepared
        end = int(np.searchsorted(points, until)) + 2 * _LONGEST_PERIOD
        times = prepared.experiment.start_time + self._size * np.arange(end)
        signals = prepared.signal_values[:, np.minimum(np.arange(end), np.searchsorted(points, until))]
        x = casadi.DM.zeros(self._step.numel_in(0))
        for _ in range(4):
            # states that begin at what outputs of others begin with
            x = self._first(x, times[0], signals[:, 0], self._nothing, self.values)
        constant = [casadi.repmat(casadi.DM(each), 1, end) for each in (self._nothing, self.values)]
        states = self._step.mapaccum(end)(x, times[np.newaxis], signals, *constant)
        late = range(end - 2 * _LONGEST_PERIOD, end)
        found = [(np.array(states[:, i - 1]), float(times[i]), signals[:, i]) for i in late]
        patterns = [
            b"".join((np.array(matrix) != 0.0).tobytes() for matrix in self._jacobians(*point, self.values))
            for point in found
        ]
        for n in range(1, _LONGEST_PERIOD + 1):
            if patterns[n:] == patterns[:-n]:
                return CodeLoop(
                    self._jacobians, self.values, self.parameters, tuple(found[:n]), self._size, self._drag
                )
        return None


def _names(component: str, block: Block, causality: str) -> list[str]:
    return [f"{component}.{v.name}" for v in block.of_causality(causality)]


def _dampings(blocks: Mapping[str, Block], parameters: Iterable[str]) -> dict[str, str]:
    """Returns linear damping -> quadratic damping of the blocks whose descriptions name both."""
    known = ((name, description_of(description_file(block.name)).variables) for name, block in blocks.items())
    pairs = {f"{name}.{each.damping}": f"{name}.{each.drag}" for name, each in known}
    return {linear: drag for linear, drag in pairs.items() if {linear, drag} <= {*parameters}}


def _constants(prepared: PreparedRun, blocks: Mapping[str, Block], causality: str) -> dict[str, Any]:
    """Returns the name and value of parameters, or inputs, as the run begins, for a sensor that is exact:
    a rounded value has no derivative, and noise moves the state about which the loop is linear.
    """
    values: dict[str, Any] = {port.name: value for port, value in prepared.settings}
    for component, block in blocks.items():
        known = description_of(description_file(block.name)).variables
        values |= {f"{component}.{name}": 0.0 for name in (known.sensor_noise, known.sensor_resolution)}
    return {
        (name := f"{component}.{v.name}"): float(values.get(name, v.start))
        for component, block in blocks.items()
        for v in block.of_causality(causality)
    }

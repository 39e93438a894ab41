"""The master algorithm on FMPy, in one file: the loop of `orchestration.run`, call by call.

    Jacobi         all inputs are set, all components step, all outputs are read
    Gauss-Seidel   component by component, each with the newest outputs there are

Communication points are start + i h, never accumulated. Faults, events, extrapolation, step sizes of single
components, step control, and checks of units and ranges are left to `orchestration.simulate`. Where both can
run a system, every recorded value has the same bits (tests/orchestration/test_fmpy_master.py).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave

from fmus.errors import nearest
from orchestration.errors import OrchestrationError, SystemDefinitionError
from orchestration.results.recording import Recording
from orchestration.system.signals import values_at
from orchestration.system.time_grid import time_grid

Connections = Sequence[tuple[str, str]]
_PYTHON_TYPE = {"String": str, "Real": float, "Float64": float, "Float32": float}  # others are integers


class Variable:
    """A scalar variable of an instance: a variable of the model description, or one element of its array.

    Parameters
    ----------
    component : Component
        The instance.
    declared : fmpy.model_description.ModelVariable
        The variable of the model description.
    element : int
        The place in the array, row by row; 0 of a scalar.
    """

    def __init__(self, component: "Component", declared: Any, element: int) -> None:
        self.component, self._element, self._references = component, element, [declared.valueReference]
        self._name, self._type = f"{component.name}.{declared.name}", declared.type
        self.unit, self._is_array = declared.unit or "", bool(declared.shape)
        items = declared.declaredType.items if declared.type == "Enumeration" else ()
        self._items = {item.name: int(item.value) for item in items}
        self._convert = _PYTHON_TYPE.get(declared.type, int)
        # a further argument in FMI 3.0: an array has several values under one value reference
        self._size = (math.prod(declared.shape),) if component.is_fmi_3 else ()
        suffix = declared.type.replace("Enumeration", "Int64" if component.is_fmi_3 else "Integer")
        self._get, self._set = (getattr(component.fmu, verb + suffix) for verb in ("get", "set"))

    def get(self) -> Any:
        """Returns the value."""
        value = self._get(self._references, *self._size)[self._element]
        # FMPy decodes Strings of FMI 3.0 but not of FMI 2.0
        return value.decode() if isinstance(value, bytes) else value

    def set(self, value: Any) -> None:
        """Sets the value, of an Enumeration also by the name of an item.

        Raises
        ------
        SystemDefinitionError
            For a value of another type.
        """
        values = self._get(self._references, *self._size) if self._is_array else [None]
        if (given := self._items.get(value, value)) != self._convert(given):
            raise SystemDefinitionError(f"{self._name} = {value!r}: expected a value of type {self._type}")
        values[self._element] = self._convert(given)
        self._set(self._references, values)


class Component:
    """An instance of an FMU for co-simulation, of FMI 2.0 or 3.0.

    Parameters
    ----------
    name : str
        Name of the component.
    path : str or Path
        The FMU.
    times : mapping
        "startTime" and "stopTime" of the experiment [s].
    resources : ExitStack
        Frees the instance, then removes its folder.

    Raises
    ------
    SystemDefinitionError
        For an FMU without co-simulation.
    """

    def __init__(self, name: str, path: str | Path, times: Mapping[str, float], resources: ExitStack) -> None:
        self.name, description = name, read_model_description(str(path))
        if not description.coSimulation:
            raise SystemDefinitionError(f"{path}: expected co-simulation, got model exchange alone")
        self.is_fmi_3 = str(description.fmiVersion).startswith("3")
        self.fmu: Any = (FMU3Slave if self.is_fmi_3 else FMU2Slave)(
            instanceName=name,
            guid=description.guid,
            modelIdentifier=description.coSimulation.modelIdentifier,
            unzipDirectory=extract(str(path), resources.enter_context(TemporaryDirectory())),
        )
        self.fmu.instantiate(loggingOn=True)
        resources.callback(self.fmu.freeInstance)
        # FMI 3.0 takes the times as it enters the initialization mode
        self.times = times if self.is_fmi_3 else {}
        if not self.is_fmi_3:
            self.fmu.setupExperiment(**times)
        self.variables: dict[str, Variable] = {}
        for declared in description.modelVariables:
            for element, index in enumerate(np.ndindex(*declared.shape or ())):
                suffix = f"[{','.join(str(i + 1) for i in index)}]" if index else ""
                self.variables[declared.name + suffix] = Variable(self, declared, element)

    def step(self, start: float, end: float) -> None:
        """Steps from `start` to `end` [s]."""
        reply = self.fmu.doStep(start, end - start)
        if self.is_fmi_3 and any(reply[:3]):
            raise OrchestrationError(f"{self.name}: the step from {start:.9g} s to {end:.9g} s ended early")


class Master:
    """Components, connections, and the newest values of what is exchanged or recorded.

    Parameters
    ----------
    components : list of Component
        In the order of Gauss-Seidel.
    connections : sequence of pairs
        (output, input), as "component.variable".
    driven : list of str
        Inputs that signals drive.
    read : sequence of str
        Further variables to read after each step.

    Raises
    ------
    SystemDefinitionError
        For an input with several sources, or a name that no component has.
    """

    def __init__(
        self, components: list[Component], connections: Connections, driven: list[str], read: Sequence[str]
    ) -> None:
        self.components, self.connections, self.values = components, connections, dict[str, Any]()
        self._variables = {f"{c.name}.{name}": v for c in components for name, v in c.variables.items()}
        targets = [*driven, *(target for _, target in connections)]
        if twice := next((name for name in targets if targets.count(name) > 1), ""):
            raise SystemDefinitionError(f"{twice}: expected one connection or one signal, got several")
        sources = {*read, *(source for source, _ in connections)}.difference(targets)
        self._inputs, self._outputs = (
            {c: [(n, v) for n in names if (v := self[n]).component is c] for c in components}
            for names in (targets, sorted(sources))
        )

    def __getitem__(self, name: str) -> Variable:
        """Returns the variable "component.variable"."""
        if name not in self._variables:
            raise SystemDefinitionError(f"no variable {name!r}; {nearest(name, self._variables)}")
        return self._variables[name]

    def exchange(self, signals: Mapping[str, float]) -> None:
        """Notes the next values of the inputs that signals or connected outputs drive."""
        self.values.update(signals)
        for source, target in self.connections:
            value = self.values[target] = self.values[source]
            if isinstance(value, float) and not math.isfinite(value):
                raise OrchestrationError(f"{target}: expected a finite number, {source} is {value}")

    def set_inputs(self, component: Component) -> None:
        for name, variable in self._inputs[component]:
            variable.set(self.values[name])

    def read_outputs(self, component: Component) -> None:
        self.values.update((name, variable.get()) for name, variable in self._outputs[component])

    def initialise(self, signals: Mapping[str, float]) -> None:
        """Exchanges initial values until none changes."""
        # a signal, a chain of n connections and an output need n + 2 passes; one more shows no change
        for _ in range(len(self.connections) + 3):
            before = self.values.copy()
            self.for_each(self.read_outputs)
            self.exchange(signals)
            self.for_each(self.set_inputs)
            if self.values == before:
                return
        raise OrchestrationError(
            "initial values do not settle: orchestration.simulate solves algebraic loops"
        )

    def step(self, start: float, end: float, algorithm: str) -> None:
        """Steps all components from `start` to `end` [s]; Gauss-Seidel exchanges before each one."""
        if algorithm == "jacobi":
            self.for_each(self.set_inputs)
            self.for_each(lambda component: component.step(start, end))
            self.for_each(self.read_outputs)
            return
        for component in self.components:
            self.exchange({})
            self.set_inputs(component)
            component.step(start, end)
            self.read_outputs(component)

    def for_each(self, action: Callable[[Component], object]) -> None:
        for component in self.components:
            action(component)


def simulate(
    fmus: Mapping[str, str | Path],
    connections: Connections = (),
    *,
    stop_time: float,
    step_size: float,
    start_time: float = 0.0,
    algorithm: Literal["jacobi", "gauss-seidel"] = "jacobi",
    start_values: Mapping[str, Any] = {},
    signals: Mapping[str, Callable[[float], float]] = {},
    record: Sequence[str],
) -> Recording:
    """Runs components once and returns the recorded variables at the communication points.

    Parameters
    ----------
    fmus : mapping
        Component -> path of its FMU.
    connections : sequence of pairs
        (output, input), as "component.variable".
    stop_time, step_size, start_time : float
        Times [s].
    algorithm : {"jacobi", "gauss-seidel"}
        The order in which components step and exchange values.
    start_values : mapping
        Parameter or input -> value.
    signals : mapping
        Input -> function of time [s].
    record : sequence of str
        Variables, "component.variable".

    Returns
    -------
    Recording
        Times, shape (n,), and values, shape (n, len(record)).

    Raises
    ------
    SystemDefinitionError
        For a wrong name, input, value or algorithm, or an FMU without co-simulation.
    OrchestrationError
        For values that are not finite or do not settle at the start, or a step of FMI 3.0 that ends early.
    FMICallException
        Of FMPy, for a call that an FMU refuses.

    Examples
    --------
    >>> from orchestration import load_scenario
    >>> fmus = {"plant": load_scenario("nominal-extended").system.components["plant"]}
    >>> voltages = {"plant.voltage[1]": 6.0, "plant.voltage[2]": 6.0}
    >>> recording = simulate(
    ...     fmus, stop_time=2.0, step_size=0.02, start_values=voltages, record=["plant.depth"]
    ... )
    >>> recording["plant.depth"].shape
    (101,)
    """
    if algorithm not in ("jacobi", "gauss-seidel"):
        raise SystemDefinitionError(f"algorithm {algorithm!r}: expected 'jacobi' or 'gauss-seidel'")
    points = time_grid(start_time, stop_time, step_size)
    tables = {name: values_at(signal, points).tolist() for name, signal in signals.items()}
    rows, times = np.empty((len(points), len(record))), {"startTime": start_time, "stopTime": stop_time}
    with ExitStack() as resources:
        components = [Component(name, path, times, resources) for name, path in fmus.items()]
        master = Master(components, connections, [*signals], record)
        for name, value in start_values.items():
            master[name].set(value)
        master.for_each(lambda component: component.fmu.enterInitializationMode(**component.times))
        master.initialise({name: table[0] for name, table in tables.items()})
        master.for_each(lambda component: component.fmu.exitInitializationMode())
        master.for_each(master.read_outputs)
        for point, time in enumerate(points.tolist()):
            if point:
                master.step(float(points[point - 1]), time, algorithm)
            master.exchange({name: table[point] for name, table in tables.items()})
            rows[point] = [master.values[name] for name in record]
        master.for_each(lambda component: component.fmu.terminate())
    return Recording(tuple(record), tuple(master[name].unit for name in record), points, rows)

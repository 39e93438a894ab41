"""Components and connections, checked against the model descriptions before anything is loaded."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any, NamedTuple

from fmus.errors import nearest
from fmus.fmi.description import describe, of_causality
from fmus.fmi.model_description import ModelDescription, ScalarVariable
from orchestration.errors import Key, SystemDefinitionError
from orchestration.system.open_inputs import OpenInputs
from orchestration.system.quantities import are_equal


@dataclass(frozen=True)
class LinearTransformation:
    """A linear transformation of a connection: the input is factor * output + offset."""

    factor: float = 1.0
    offset: float = 0.0

    def __call__(self, value: float) -> float:
        return self.factor * value + self.offset

    @classmethod
    def of(cls, given: Any, source: str, target: str) -> "LinearTransformation":
        """Returns the transformation of a table with `factor` and `offset`; an error names the connection."""
        connection, about = f"connection {source} -> {target}", _about_connection(source, target)
        known = [field.name for field in fields(cls)]
        if isinstance(given, cls):
            given = {name: getattr(given, name) for name in known}
        if not isinstance(given, dict):
            raise SystemDefinitionError(
                f"{connection}: expected {{factor, offset}} third, got {given!r}", *about
            )
        for name, value in given.items():
            if name not in known:
                raise SystemDefinitionError(
                    f"{connection}: unknown key {name!r}; {nearest(name, known)}", *about
                )
            is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if not (is_number and math.isfinite(value)):
                raise SystemDefinitionError(
                    f"{connection}: {name} = {value!r}: expected a finite number", *about
                )
        return cls(**{name: float(value) for name, value in given.items()})


# type of an input -> types of outputs that it accepts, of which it can hold every value;
# items of an enumeration are transferred as Integers, and some tools declare them so
_ACCEPTED = {
    "Real": ("Real", "Integer"),
    "Integer": ("Integer", "Enumeration"),
    "Boolean": ("Boolean",),
    "Enumeration": ("Enumeration", "Integer"),
    "String": ("String",),
}


@dataclass(frozen=True)
class Port:
    """A port: a variable of a component."""

    component: str
    variable: ScalarVariable

    @property
    def name(self) -> str:
        return f"{self.component}.{self.variable.name}"


@dataclass(frozen=True, init=False)
class System:
    """A system: named FMUs and their connections, (source, target) as "component.variable".

    Parameters
    ----------
    components : mapping
        Name -> path of an FMU, or policy class, "my.py:Policy", whose FMU is made in the user's cache.
    connections : iterable
        (source, target). A third item, {"factor": 0.001, "offset": 0.0}, transforms the value.

    Raises
    ------
    SystemDefinitionError
        For another form.
    ExportError
        For a class that is no policy.

    Examples
    --------
    >>> fmus = {"controller": "pid.fmu", "plant": "vehicle.fmu"}
    >>> system = System(fmus, [("controller.force", "plant.force"), ("plant.depth", "controller.depth")])
    >>> system.connections[0]
    ('controller.force', 'plant.force')
    """

    components: Mapping[str, Path]
    connections: tuple[tuple[str, str] | tuple[str, str, LinearTransformation], ...]

    def __init__(
        self, components: Mapping[str, str | Path], connections: Iterable[Sequence[object]] = ()
    ) -> None:
        if not isinstance(components, Mapping):
            raise SystemDefinitionError(f'components: expected {{"name": "path.fmu"}}, got {components!r}')
        for name in components:
            if not isinstance(name, str) or not name:
                raise SystemDefinitionError(f"component {name!r}: expected a name without a dot")
            # a component of a nested system has the name of that system before its own
            if any(name.startswith(f"{other}.") for other in components):
                raise SystemDefinitionError(f"component {name!r}: expected a name that no other begins")
        paths = {name: _fmu(path) for name, path in components.items()}
        object.__setattr__(self, "components", paths)
        object.__setattr__(self, "connections", tuple(_ends(connection) for connection in connections))


def _fmu(path: str | Path) -> Path:
    """Returns the path of an FMU, which is made first of a policy class, FILE.py:Class."""
    if ".py:" not in str(path):
        return Path(path)
    from fmus.generate.policy import fmu_of_class

    return fmu_of_class(str(path))


def _about_connection(source: str, target: str) -> tuple[Key, ...]:
    """Returns where a file has a connection: in a table under its input, in a list by both ends."""
    return ("connections", target), source, target


def _ends(connection: Any) -> tuple[str, str] | tuple[str, str, LinearTransformation]:
    is_connection = isinstance(connection, (tuple, list)) and len(connection) in (2, 3)
    if not is_connection or not all(isinstance(name, str) for name in connection[:2]):
        raise SystemDefinitionError(f'connection {connection!r}: expected ("a.output", "b.input")')
    source, target, *given = connection
    if not given:
        return source, target
    return source, target, LinearTransformation.of(given[0], source, target)


class ConnectionGroup(NamedTuple):
    """The connections of an algebraic loop, or one connection that is in no loop."""

    connections: tuple[tuple[Port, Port], ...]
    is_loop: bool


@dataclass(frozen=True)
class CheckedSystem:
    """A system and its model descriptions: every name exists, every connection fits.

    ports: "component.variable" -> variable, of all components
    open_inputs: inputs that nothing drives
    transformations: of connections, by their input
    """

    components: Mapping[str, Path]
    descriptions: Mapping[str, ModelDescription]
    ports: Mapping[str, Port]
    connections: tuple[tuple[Port, Port], ...]
    open_inputs: tuple[Port, ...] = ()
    transformations: Mapping[str, LinearTransformation] = field(default_factory=dict)

    def port(self, name: str, purpose: str) -> Port:
        """Returns the variable called "component.variable"; an unknown one offers the nearest."""
        if name in self.ports:
            return self.ports[name]
        begun = (own for own in self.components if name.startswith(f"{own}."))
        component = next(begun, name.partition(".")[0])
        if component not in self.components:
            raise SystemDefinitionError(
                f"{purpose}: no component {component!r} for {name!r}; {nearest(component, self.components)}",
                name,
            )
        left_out = self.descriptions[component].left_out.get(name.removeprefix(f"{component}."))
        if left_out:
            raise SystemDefinitionError(
                f"{purpose}: {name} has type {left_out}: expected a number, a Boolean or a String, "
                "and no Clock",
                name,
            )
        candidates = [known for known in self.ports if known.startswith(component + ".")]
        raise SystemDefinitionError(f"{purpose}: no variable {name!r}; {nearest(name, candidates)}", name)

    def components_without(self, capability: str) -> list[str]:
        """Returns the components whose FMU does not declare a capability of FMI 2.0 co-simulation."""
        return [
            name
            for name, description in self.descriptions.items()
            if not getattr(description.coSimulation, capability)
        ]

    @cached_property
    def inputs(self) -> dict[str, list[str]]:
        """Component -> names of its inputs."""
        return {
            component: [f"{component}.{v.name}" for v in of_causality(description, "input")]
            for component, description in self.descriptions.items()
        }

    @cached_property
    def declared_dependencies(self) -> dict[str, list[str]]:
        """Output -> names of the inputs that it depends on in initialisation mode, where that is declared."""
        return {
            f"{component}.{unknown.variable.name}": [
                f"{component}.{v.name}" for v in unknown.dependencies if v.causality == "input"
            ]
            for component, description in self.descriptions.items()
            for unknown in description.initialUnknowns
            if unknown.variable is not None and unknown.dependencies is not None
        }

    @cached_property
    def connection_groups(self) -> tuple[ConnectionGroup, ...]:
        """The connections in the order in which initial values are exchanged.

        Each connected input follows an output, which depends on inputs of its component as the model
        description declares (`InitialUnknowns`; an output without declaration depends on every input). The
        groups are the strongly connected components of this graph, in topological order.
        """
        connections, declared = self.connections, self.declared_dependencies
        index = {target.name: i for i, (_, target) in enumerate(connections)}
        # One more node for each component: all its connected inputs, for the outputs that declare nothing.
        nodes = {name: len(connections) + c for c, name in enumerate(self.components)}
        dependencies: dict[int, set[int]] = {}
        for i, (source, _) in enumerate(connections):
            names = declared.get(source.name)
            inputs = {nodes[source.component]} if names is None else {index[n] for n in names if n in index}
            dependencies[i] = inputs
        for name, node in nodes.items():
            dependencies[node] = {index[n] for n in self.inputs[name] if n in index}
        try:
            TopologicalSorter(dependencies).prepare()
            labels = list(dependencies)
        except CycleError:
            labels = _component_labels(dependencies)
        members: dict[int, list[int]] = {}
        for i, label in enumerate(labels):
            members.setdefault(label, []).append(i)
        graph = {
            label: {labels[earlier] for i in inside for earlier in dependencies[i]} - {label}
            for label, inside in members.items()
        }
        groups = (members[label] for label in TopologicalSorter(graph).static_order())
        return tuple(
            ConnectionGroup(
                connections=tuple(connections[i] for i in group if i < len(connections)),
                is_loop=len(group) > 1 or group[0] in dependencies[group[0]],
            )
            for group in groups
            if group[0] < len(connections)
        )


def _component_labels(dependencies: Mapping[int, set[int]]) -> list[int]:
    """Returns the strongly connected component of each node, by two walks in depth (Sharir 1981)."""
    dependants: dict[int, list[int]] = {i: [] for i in dependencies}
    for i, all_earlier in dependencies.items():
        for earlier in all_earlier:
            dependants[earlier].append(i)
    last_first = [i for _, inside in _walks(dependencies, dependencies) for i in inside][::-1]
    labels = {i: root for root, inside in _walks(dependants, last_first) for i in inside}
    return [labels[i] for i in range(len(labels))]


def _walks(graph: Mapping[int, Iterable[int]], roots: Iterable[int]) -> Iterator[tuple[int, list[int]]]:
    """Yields each root that no earlier walk reached, and what its walk reaches anew, the farthest first."""
    reached = set[int]()
    for root in roots:
        path, ended = [(root, iter(graph[root]))] if root not in reached else [], list[int]()
        reached.add(root)
        while path:
            new = next((one for one in path[-1][1] if one not in reached), None)
            if new is None:
                ended.append(path.pop()[0])
            else:
                reached.add(new)
                path.append((new, iter(graph[new])))
        if ended:
            yield root, ended


def check(
    system: System,
    driven: Iterable[str] = (),
    descriptions: Mapping[str, ModelDescription] | None = None,
    open_inputs: OpenInputs = OpenInputs.ERROR,
) -> CheckedSystem:
    """Reads every model description and checks every name, type and unit of the system.

    driven: inputs that a signal or a constant drives; every other input needs a connection
    descriptions: of the components, if they have been read already
    open_inputs: whether an input that nothing drives is an error
    Raises FmuLoadError for a file that is no FMU, SystemDefinitionError for what does not fit.
    """
    descriptions = descriptions or {name: describe(Path(path)) for name, path in system.components.items()}
    ports = {
        f"{component}.{variable.name}": Port(component, variable)
        for component, description in descriptions.items()
        for variable in description.modelVariables
    }
    transformations = {target: given[0] for _, target, *given in system.connections if given}
    checked = CheckedSystem(system.components, descriptions, ports, (), (), transformations)
    connections = tuple(_connection(checked, source, target) for source, target, *_ in system.connections)
    drivers = Counter(target.name for _, target in connections)
    for name in driven:
        port = checked.port(name, "driven input")
        if port.variable.causality != "input":
            raise SystemDefinitionError(
                f"{name} is driven: expected an input, got {port.variable.causality}", name
            )
        drivers[name] += 1
    for name, count in drivers.items():
        if count > 1:
            raise SystemDefinitionError(f"{name} is driven {count} times: expected once", name)
    undriven = [p for n, p in ports.items() if p.variable.causality == "input" and n not in drivers]
    if undriven and open_inputs is OpenInputs.ERROR:
        raise SystemDefinitionError(
            f"{', '.join(port.name for port in undriven)}: driven by nothing; connect each input, drive it "
            'by a signal, give it a constant value, or set open_inputs = "start" for the FMU\'s start value',
            *((table, port.name) for port in undriven for table in ("inputs", "connections", "signals")),
        )
    return replace(checked, connections=connections, open_inputs=tuple(undriven))


def _connection(checked: CheckedSystem, source: str, target: str) -> tuple[Port, Port]:
    purpose = f"connection {source} -> {target}"
    start, end = checked.port(source, purpose), checked.port(target, purpose)
    output, input_ = start.variable, end.variable
    if output.causality != "output":
        problem = f"expected an output first, got {output.causality}"
    elif input_.causality != "input":
        problem = f"expected an input second, got {input_.causality}"
    elif output.type not in _ACCEPTED[input_.type]:
        expected = " or ".join(_ACCEPTED[input_.type])
        problem = (
            f"expected an output of type {expected} for an input of type {input_.type}, got {output.type}"
        )
    elif target in checked.transformations and input_.type != "Real":
        problem = f"expected an input of type Real for a factor or an offset, got {input_.type}"
    elif target not in checked.transformations and not are_equal(
        output.unit, input_.unit, input_.units, output.units
    ):
        note = ", of which one is a relative quantity" if output.is_relative != input_.is_relative else ""
        problem = f"expected equal units, got {output.unit} and {input_.unit}{note}"
    else:
        return start, end
    raise SystemDefinitionError(f"{purpose}: {problem}", *_about_connection(source, target))

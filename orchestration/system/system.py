"""Components and connections, checked against the model descriptions before anything is loaded."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fmpy.model_description import ModelDescription, ScalarVariable

from fmus.errors import nearest
from orchestration.errors import SystemDefinitionError
from orchestration.fmi.description import describe


@dataclass(frozen=True)
class Port:
    """A variable of a component."""

    component: str
    variable: ScalarVariable

    @property
    def name(self) -> str:
        return f"{self.component}.{self.variable.name}"


@dataclass(frozen=True, init=False)
class System:
    """Named FMUs and the connections between them, (source, target) as "component.variable".

    SystemDefinitionError for what is not of this form.
    """

    components: Mapping[str, Path]
    connections: tuple[tuple[str, str], ...]

    def __init__(
        self, components: Mapping[str, str | Path], connections: Iterable[Sequence[str]] = ()
    ) -> None:
        if not isinstance(components, Mapping):
            raise SystemDefinitionError(f'components: expected {{"name": "path.fmu"}}, got {components!r}')
        odd = [name for name in components if not isinstance(name, str) or not name or "." in name]
        if odd:
            raise SystemDefinitionError(f"component {odd[0]!r}: expected a name without a dot")
        paths = {name: Path(path) for name, path in components.items()}
        object.__setattr__(self, "components", paths)
        object.__setattr__(self, "connections", tuple(_pair(each) for each in connections))


def _pair(connection: Any) -> tuple[str, str]:
    is_pair = isinstance(connection, (tuple, list)) and len(connection) == 2
    if not is_pair or not all(isinstance(name, str) for name in connection):
        raise SystemDefinitionError(f'connection {connection!r}: expected ("a.output", "b.input")')
    return connection[0], connection[1]


@dataclass(frozen=True)
class CheckedSystem:
    """A system whose every name exists and fits."""

    components: Mapping[str, Path]
    descriptions: Mapping[str, ModelDescription]
    ports: Mapping[str, Port]
    connections: tuple[tuple[Port, Port], ...]

    def port(self, name: str, purpose: str) -> Port:
        """The variable called "component.variable"; an unknown one offers the nearest."""
        component = name.partition(".")[0]
        if component not in self.components:
            raise SystemDefinitionError(
                f"{purpose}: no component {component!r} for {name!r}; {nearest(component, self.components)}"
            )
        if name not in self.ports:
            candidates = [known for known in self.ports if known.startswith(component + ".")]
            raise SystemDefinitionError(f"{purpose}: no variable {name!r}; {nearest(name, candidates)}")
        return self.ports[name]

    def initial_inputs(self, output: Port) -> list[str]:
        """Names of the inputs that an output follows in initialisation mode; unstated means all."""
        description = self.descriptions[output.component]
        inputs = [v for v in description.modelVariables if v.causality == "input"]
        for unknown in description.initialUnknowns:
            if unknown.variable is output.variable and unknown.dependencies is not None:
                known = {id(each) for each in unknown.dependencies}
                inputs = [v for v in inputs if id(v) in known]
        return [f"{output.component}.{v.name}" for v in inputs]


def check(
    system: System,
    driven: Iterable[str] = (),
    descriptions: Mapping[str, ModelDescription] | None = None,
) -> CheckedSystem:
    """Read every model description and check every name, type and unit of the system.

    driven: the inputs that are set by something else than a connection: a signal or a constant;
    descriptions: those of the components, if they have been read already.
    Raises FmuLoadError for a file that is no FMU, SystemDefinitionError for what does not fit.
    """
    descriptions = descriptions or {name: describe(Path(path)) for name, path in system.components.items()}
    ports = {
        f"{component}.{variable.name}": Port(component, variable)
        for component, description in descriptions.items()
        for variable in description.modelVariables
    }
    checked = CheckedSystem(system.components, descriptions, ports, ())
    connections = tuple(_connection(checked, source, target) for source, target in system.connections)
    drivers = [target.name for _, target in connections]
    for name in driven:
        port = checked.port(name, "driven input")
        if port.variable.causality != "input":
            raise SystemDefinitionError(f"{name} is driven: expected an input, got {port.variable.causality}")
        drivers.append(name)
    _check_each_input_is_driven_once(ports, drivers)
    return CheckedSystem(system.components, descriptions, ports, connections)


def _connection(checked: CheckedSystem, source: str, target: str) -> tuple[Port, Port]:
    purpose = f"connection {source} -> {target}"
    begin, end = checked.port(source, purpose), checked.port(target, purpose)
    if begin.variable.causality != "output":
        raise SystemDefinitionError(f"{purpose}: expected an output first, got {begin.variable.causality}")
    if end.variable.causality != "input":
        raise SystemDefinitionError(f"{purpose}: expected an input second, got {end.variable.causality}")
    if begin.variable.type != end.variable.type:
        raise SystemDefinitionError(
            f"{purpose}: expected equal types, got {begin.variable.type} and {end.variable.type}"
        )
    if begin.variable.type == "String":
        raise SystemDefinitionError(f"{purpose}: expected numbers, Strings are not exchanged")
    stated = begin.variable.unit and end.variable.unit  # an FMU need not state units
    if stated and _unit(checked, begin) != _unit(checked, end):
        raise SystemDefinitionError(
            f"{purpose}: expected equal units, got {begin.variable.unit} and {end.variable.unit}"
        )
    return begin, end


def _unit(checked: CheckedSystem, port: Port) -> object:
    """What makes two units equal: base units, factor and offset if the FMU gives them, else the name."""
    name = port.variable.unit
    for unit in checked.descriptions[port.component].unitDefinitions:
        base = unit.baseUnit
        if unit.name == name and base is not None:
            exponents = (base.kg, base.m, base.s, base.A, base.K, base.mol, base.cd, base.rad)
            return (*exponents, base.factor, base.offset)
    return name


def _check_each_input_is_driven_once(ports: Mapping[str, Port], drivers: list[str]) -> None:
    for name in drivers:
        if drivers.count(name) > 1:
            raise SystemDefinitionError(f"{name} is driven {drivers.count(name)} times: expected once")
    idle = [n for n, p in ports.items() if p.variable.causality == "input" and n not in drivers]
    if idle:
        raise SystemDefinitionError(
            f"{', '.join(idle)}: driven by nothing; connect each input, drive it by a signal "
            "or give it a constant value"
        )

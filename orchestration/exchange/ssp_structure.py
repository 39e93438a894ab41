"""The systems of an SSP package, one in another, as components and connections of one level."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element
from zipfile import is_zipfile

from fmus.errors import nearest
from fmus.units import of_differences
from orchestration.errors import SystemDefinitionError
from orchestration.exchange.ssp_package import OpenedPackage
from orchestration.exchange.ssp_values import BoundValue, Values, is_suppressed, linear_transformation
from orchestration.exchange.ssp_xml import tag
from orchestration.system.quantities import Units, are_equal, conversion
from orchestration.system.system import LinearTransformation, Port

# SSP 2.0, 5.3.5.2 (Allowed Connections): a connection starts at these kinds of connectors of elements;
# of the enclosing system it ends at them
_OUT_OF = ("output", "local", "constant", "calculatedParameter")
_INTO = ("input", "parameter", "structuralParameter")


class Node(NamedTuple):
    """A connector: the path of its element, with a dot at its end, and its name."""

    path: str
    name: str


class Edge(NamedTuple):
    """A connection that leads into a connector."""

    source: Node
    element: Element


@dataclass(frozen=True)
class Structure:
    """All systems of a package.

    components: "system.component" -> FMU; into: connector -> the connections that lead into it
    outputs: of components; _of_systems: connectors of systems and of signal dictionaries
    """

    package: OpenedPackage
    units: Units
    components: dict[str, Path] = field(default_factory=dict)
    connectors: dict[Node, Element] = field(default_factory=dict)
    into: dict[Node, list[Edge]] = field(default_factory=dict)

    @classmethod
    def of(cls, root: Element, package: OpenedPackage) -> "Structure":
        """Returns the structure; raises ScenarioError for what it cannot hold."""
        structure = cls(package, package.units(root))
        for system in root.iterfind(tag("ssd:System")):
            structure._add(system, "")
        return structure

    @property
    def outputs(self) -> list[str]:
        """The outputs of components, as "system.component.variable"."""
        own = {node: e for node, e in self.connectors.items() if node.path[:-1] in self.components}
        return ["".join(node) for node, element in own.items() if element.get("kind") == "output"]

    def _add(self, system: Element, path: str) -> None:
        """Adds the elements, the connectors and the connections of a system."""
        self._add_connectors(system, path)
        elements: dict[str, str] = {}
        for element in system.iterfind(f"{tag('ssd:Elements')}/*"):
            name, kind = element.get("name", ""), element.tag
            elements[name] = f"{path}{name}."
            if kind == tag("ssd:System"):
                self._add(element, elements[name])
                continue
            if kind == tag("ssd:SignalDictionaryReference"):
                # all references to one dictionary have its connectors
                elements[name] = f"dictionary {element.get('dictionary')}."
            elif kind == tag("ssd:Component"):
                self.components[path + name] = self._fmu(element, path + name)
            self._add_connectors(element, elements[name])
        for connection in system.iterfind(f"{tag('ssd:Connections')}/{tag('ssd:Connection')}"):
            target, edge = self._directed(connection, path, elements)
            self.into.setdefault(target, []).append(edge)

    def _add_connectors(self, element: Element, path: str) -> None:
        for connector in element.iterfind(f"{tag('ssd:Connectors')}/{tag('ssd:Connector')}"):
            self.connectors[Node(path, connector.get("name", ""))] = connector

    def _fmu(self, component: Element, name: str) -> Path:
        self.package.check_attribute(component, "type", "application/x-fmu-sharedlibrary", name)
        file = self.package.file(component.get("source", ""), name)
        if not is_zipfile(file):
            raise self.package.error(f"component {name}: source {file.name}: expected an FMU")
        return file

    def _directed(self, element: Element, path: str, elements: Mapping[str, str]) -> tuple[Node, Edge]:
        """Returns the connector that a connection leads into, and where it comes from.

        Source: SSP 2.0, 5.3 (Connections): start and end do not denote the direction, kinds do.
        """
        ends, leads_out = list[Node](), list[bool | None]()
        for end in ("start", "end"):
            if f"{end}Indices" in element.attrib:
                hint = "not supported; expected scalar connectors"
                raise self.package.error(f"{end}Indices of a connection: {hint}")
            owner, name = element.get(f"{end}Element", ""), element.get(f"{end}Connector", "")
            if owner and owner not in elements:
                purpose = f"connection of {path}{owner}.{name}"
                raise self.package.error(f"{purpose}: no element {owner!r}; {nearest(owner, elements)}")
            node = Node(elements[owner] if owner else path, name)
            connector = self.connectors.get(node)
            if connector is None and node.path[:-1] not in self.components:
                known = nearest(name, (other.name for other in self.connectors if other.path == node.path))
                raise self.package.error(f"connection of {''.join(node)}: no connector {name!r}; {known}")
            kind = None if connector is None else connector.get("kind")
            is_out, is_in = (_OUT_OF, _INTO) if owner else (_INTO, _OUT_OF)
            ends.append(node)
            leads_out.append(True if kind in is_out else False if kind in is_in else None)
        (start, end), (first, last) = ends, leads_out
        if first == last is not None:
            kind = "output" if first else "input"
            names = f"{''.join(start)} and {''.join(end)}"
            raise self.package.error(f"connection of {names}, both {kind}s: expected one output")
        if first is False or last is True:
            start, end = end, start
        return end, Edge(start, element)

    def connections(self, ports: Mapping[str, Port]) -> Iterator[tuple[Any, ...]]:
        """Yields (output, input) or (output, input, transformation) of components."""
        for target in self.into:
            if target.path[:-1] in self.components:
                for source, change in self.sources(target, ports):
                    if source.path[:-1] in self.components:
                        yield from _of_elements("".join(source), "".join(target), change, ports)

    def sources(
        self, target: Node, ports: Mapping[str, Port], passed: tuple[Node, ...] = ()
    ) -> Iterator[tuple[Node, LinearTransformation]]:
        """Yields each connector that gives a connector its value, through others, and the change of it."""
        edges = self.into.get(target, [])
        if (target.path[:-1] in self.components and passed) or not edges or target in passed:
            yield target, LinearTransformation()
            return
        for edge in edges:
            own = self._change(edge, target, ports)
            for source, earlier in self.sources(edge.source, ports, (*passed, target)):
                yield source, LinearTransformation(earlier.factor * own.factor, own(earlier.offset))

    def _change(self, edge: Edge, target: Node, ports: Mapping[str, Port]) -> LinearTransformation:
        """Returns the conversion of units of a connection, and the transformation behind it."""
        names = f"{''.join(edge.source)} -> {''.join(target)}"
        for kind in ("Boolean", "Integer", "Enumeration"):
            if edge.element.find(tag(f"ssc:{kind}MappingTransformation")) is not None:
                hint = "not supported; expected a linear one"
                raise self.package.error(f"connection {names}: a {kind}MappingTransformation: {hint}")
        given = linear_transformation(edge.element, self.package, f"connection {names}")
        given = given or LinearTransformation()
        if is_suppressed(edge.element):
            return given
        (unit, of_source), (expected, own) = self._unit(edge.source, ports), self._unit(target, ports)
        try:
            change = conversion(unit, expected, own, of_source) if unit and expected else conversion("", "")
        except SystemDefinitionError as error:
            raise self.package.error(f"connection {names}: {error}") from None
        return LinearTransformation(given.factor * change.factor / change.divisor, given(change.offset))

    def _unit(self, node: Node, ports: Mapping[str, Port]) -> tuple[str, Units]:
        """Returns the unit of a connector, or of its variable, and the definitions of units for it."""
        connector, port = self.connectors.get(node), ports.get("".join(node))
        children = [] if connector is None else list(connector)
        unit = next((child.get("unit", "") for child in children if child.get("unit")), "")
        if port is None:
            return unit, self.units
        of_file = of_differences(self.units) if port.variable.is_relative else self.units
        of_fmu, own = port.variable.units, port.variable.unit or ""
        if not are_equal(unit, own, of_fmu, {**of_fmu, **of_file}):
            message = f"connector {port.name} is in {unit}: expected {own}, the unit in the FMU"
            raise self.package.error(message)
        return (unit, {**of_fmu, **of_file}) if unit else (own, of_fmu)

    def check_units(self, ports: Mapping[str, Port]) -> None:
        """Refuses a connector in another unit than its variable's."""
        for node in self.connectors:
            self._unit(node, ports)

    def of_components(self, values: Values, ports: Mapping[str, Port]) -> Values:
        """Returns the values of components: also those that the connectors of systems pass on."""
        of_systems = {"".join(n) for n in self.connectors if n.path[:-1] not in self.components}
        own = {name: value for name, value in values.items() if name in ports or name not in of_systems}
        for target in self.into:
            for source, change in self.sources(target, ports):
                name = "".join(target)
                if (bound := values.get("".join(source))) and name in ports and "".join(source) in of_systems:
                    own[name] = _passed_on(bound, change)
        return own


def _passed_on(bound: BoundValue, change: LinearTransformation) -> BoundValue:
    if change == LinearTransformation():
        return bound
    return bound._replace(transformations=(*bound.transformations, change))


def _of_elements(
    source: str, target: str, change: LinearTransformation, ports: Mapping[str, Port]
) -> Iterator[tuple[Any, ...]]:
    """Yields the connections of the elements of two arrays, in order, or of two scalars."""
    ones, others = ([n for n in ports if n.startswith(f"{end}[")] for end in (source, target))
    # names that fit no variable, and arrays of different sizes, are refused with the system
    is_array = 0 < len(ones) == len(others) and source not in ports and target not in ports
    given = () if change == LinearTransformation() else (change,)
    for one, other in zip(ones, others, strict=True) if is_array else [(source, target)]:
        yield one, other, *given

"""Reader of an SSP package, 1.0 or 2.0, as a scenario that our master runs.

It reads the components and connections of one system, parameter values inline or in .ssv files at components
or at the system, and the default experiment. Values are converted to the units of the FMUs. Elements that are
not understood are refused rather than ignored; so is a name that fits no variable, which SSP permits.
"""

import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote
from xml.etree import ElementTree
from xml.etree.ElementTree import Element
from xml.parsers import expat

from fmus.errors import nearest
from fmus.files import extract_archive
from fmus.fmi.description import describe
from fmus.fmi.model_description import ModelDescription, base_unit
from fmus.fmi.variable_types import FmiValue
from fmus.units import of_differences
from orchestration.errors import ScenarioError, SystemDefinitionError
from orchestration.exchange.ssp_xml import STRUCTURE, read_value, tag
from orchestration.scenarios.scenario import Scenario
from orchestration.system.experiment import Experiment
from orchestration.system.quantities import Units, are_equal, stated
from orchestration.system.system import CheckedSystem, Port, System
from orchestration.system.values import fmi_value


@dataclass(frozen=True)
class OpenedPackage:
    """A package and the folder that it is extracted to."""

    path: Path
    folder: Path

    def error(self, message: str) -> ScenarioError:
        return ScenarioError(f"{self.path}: {message}")

    def file(self, source: str, purpose: str) -> Path:
        """Returns a file of the package; ScenarioError for one outside it.

        source: a URI (RFC 3986) relative to the structure, or a path that some tools write in its place
        """
        for text in (source if set(source) & set("?#") else unquote(source), source):
            path = PurePosixPath(text)
            is_relative = not path.is_absolute() and ".." not in path.parts and not {"\\", ":"} & set(text)
            if is_relative and (self.folder / path).is_file():
                return self.folder / path
        expected = "a file in the package, as a relative URI without a query and a fragment"
        raise self.error(f"{purpose}: source {source!r}: expected {expected}")

    def root(self, file: Path) -> Element:
        """Returns the root element of an XML file of the package."""
        try:
            if b"<!DOCTYPE" in (content := file.read_bytes()):
                raise self.error(f"{file.name}: expected XML without a document type")
            return _with_places(content, f"{self.path}: {file.relative_to(self.folder).as_posix()}")
        except FileNotFoundError:
            beside = (path.name for path in file.parent.glob("*"))
            raise self.error(f"no {file.name} in it; {nearest(file.name, beside)}") from None
        except (ElementTree.ParseError, LookupError, ValueError) as error:
            raise self.error(f"{file.name}: expected XML: {error}") from error

    def check_attribute(self, element: Element, attribute: str, expected: str, purpose: str) -> None:
        """Raises ScenarioError if an attribute is given and is not the expected one."""
        value = element.get(attribute, expected)
        if value != expected:
            raise self.error(f"{purpose}: {attribute} {value!r}: expected {expected!r}")


def _with_places(content: bytes, file: str) -> Element:
    """Returns the root element of an XML file, in which each parameter has the attribute "place"."""
    root, lines, parser = ElementTree.fromstring(content), list[int](), expat.ParserCreate()
    parser.StartElementHandler = lambda *_: lines.append(parser.CurrentLineNumber)
    parser.Parse(content, True)
    for element, line in zip(root.iter(), lines, strict=True):
        if element.tag == tag("ssv:Parameter"):
            element.set("place", f"{file}:{line}: ")
    return root


Settings = dict[str, FmiValue]
Values = dict[str, tuple[FmiValue, str]]
"""Name -> value, and its place before messages."""


def bound_values(root: Element, package: OpenedPackage) -> Values:
    """Returns "component.variable" -> value; the system's bindings go over the components'.

    Source: SSP 1.0, 5.3.2.
    """
    values: Values = {}
    for component in root.iter(tag("ssd:Component")):
        own = _bindings(component, root, package)
        values |= {f"{component.get('name')}.{name}": value for name, value in own.items()}
    for system in root.findall(tag("ssd:System")):
        values |= _bindings(system, root, package)
    return values


def chosen_values(name: str, package: OpenedPackage) -> Values:
    """Returns the values of the .ssv file whose parameter set has that name."""
    roots = {}
    for file in sorted(package.folder.rglob("*.ssv")):
        root = package.root(file)
        roots[root.get("name", "")] = root
    if name not in roots:
        raise ScenarioError(f"no parameter set {name!r} in the package; {nearest(name, roots)}")
    return _values(roots[name], roots[name], package)


def _bindings(element: Element, root: Element, package: OpenedPackage) -> Values:
    values: Values = {}
    purpose = "a parameter binding"
    for binding in element.findall(f"{tag('ssd:ParameterBindings')}/{tag('ssd:ParameterBinding')}"):
        if binding.find(tag("ssd:ParameterMapping")) is not None:
            raise package.error("a parameter mapping: not supported; expected names of variables")
        package.check_attribute(binding, "type", "application/x-ssp-parameter-set", purpose)
        package.check_attribute(binding, "sourceBase", "SSD", purpose)
        source, prefix = binding.get("source"), binding.get("prefix", "")
        inline = binding.iter(tag("ssv:ParameterSet"))
        parameter_sets = [package.root(package.file(source, purpose))] if source else inline
        for parameter_set in parameter_sets:
            own = _values(parameter_set, parameter_set if source else root, package)
            values |= {prefix + name: value for name, value in own.items()}
    return values


def _values(parameter_set: Element, root: Element, package: OpenedPackage) -> Values:
    """Returns the values of a parameter set, texts where they have units; root: of its file."""
    values, units = Values(), _units(root, package)
    for parameter in parameter_set.iter(tag("ssv:Parameter")):
        place = parameter.get("place", "")
        try:
            value = read_value(parameter)
        except ValueError as error:
            raise ScenarioError(f"{place}{error}") from error
        if unit := next((element.get("unit") for element in parameter if element.get("unit")), ""):
            value = stated(f"{value!r} {unit}", "", str(package.path), units)
        values[parameter.get("name", "")] = value, place
    return values


def _units(root: Element, package: OpenedPackage) -> Units:
    """Returns the units that a file of the package defines."""
    bases = {unit.get("name", ""): unit.find(tag("ssc:BaseUnit")) for unit in root.iter(tag("ssc:Unit"))}
    try:
        defined = {name: base_unit(base) for name, base in bases.items() if base is not None}
    except ValueError as error:
        raise package.error(f"a unit: {error}") from error
    return {name: unit for name, unit in defined.items() if unit.factor}


_REFUSED = (
    ("ssd:System/ssd:Connectors", "connectors of the system itself"),
    ("ssd:System/ssd:Elements/ssd:System", "a system inside the system"),
    ("ssd:System/ssd:Elements/ssd:SignalDictionaryReference", "a signal dictionary"),
    ("ssd:System/ssd:Connections/ssd:Connection/ssd:ConnectionGeometry", "the geometry of a connection"),
    *(
        (f"ssd:System/ssd:Connections/ssd:Connection/ssc:{kind}", f"a {kind} of a connection")
        for kind in (f"{name}MappingTransformation" for name in ("Boolean", "Integer", "Enumeration"))
    ),
)


@contextmanager
def opened(path: Path, parameter_set: str = "") -> Iterator[Scenario]:
    """Reads the scenario in a package; its FMUs are extracted until the context ends.

    parameter_set: name of an .ssv in the package, whose values replace those bound in it.
    Raises ScenarioError for a package that cannot be read.
    """
    if not path.is_file():
        beside = [package.name for package in path.parent.glob("*.ssp")]
        raise ScenarioError(f"no package {path}; beside it, {nearest(path.name, beside)}")
    with tempfile.TemporaryDirectory(prefix="l1-depth-ssp-") as folder:
        try:
            extract_archive(path, Path(folder))
        except (zipfile.BadZipFile, EOFError, zlib.error, RuntimeError, ValueError) as error:
            raise ScenarioError(f"{path}: expected an SSP package, a zip: {error}") from error
        yield _scenario(OpenedPackage(path, Path(folder)), parameter_set)


def _scenario(package: OpenedPackage, parameter_set: str) -> Scenario:
    if set(parameter_set) & set("/\\:") or not parameter_set.isprintable():
        raise package.error(
            f"parameter set {parameter_set!r}: expected a name of a file, without / and \\ and :"
        )
    root = _checked_root(package)
    components = _components(root, package)
    _turn_connections(root, package)
    connections = tuple(_connection(element, package) for element in root.iter(tag("ssd:Connection")))
    descriptions = {name: describe(path) for name, path in components.items()}
    ports = {f"{name}.{v.name}": Port(name, v) for name, d in descriptions.items() for v in d.modelVariables}
    _check_conversions(root, connections, ports, package)
    values = chosen_values(parameter_set, package) if parameter_set else bound_values(root, package)
    known = CheckedSystem(components, descriptions, ports, ())
    parameters, inputs = _by_causality(values, known, {target for _, target, *_ in connections})
    settings: dict[str, Any] = {**_times(root, descriptions, package), "open_inputs": "start"}
    outputs = (
        f"{component.get('name')}.{connector.get('name')}"
        for component in root.iter(tag("ssd:Component"))
        for connector in component.iter(tag("ssd:Connector"))
        if connector.get("kind") == "output"
    )
    system = root.find(tag("ssd:System"))
    stem = package.path.stem
    return Scenario(
        name=parameter_set or stem,
        title=parameter_set or (system is not None and system.get("description")) or stem,
        system=System(components, connections),
        experiment=Experiment(**settings, parameters=parameters, inputs=inputs, record=tuple(outputs)),
        metrics={},
        resolved={
            "components": {name: path.name for name, path in components.items()},
            "connections": [list(connection) for connection in connections],
            "experiment": settings,
            "parameters": parameters,
            "inputs": inputs,
        },
    )


def _checked_root(package: OpenedPackage) -> Element:
    """Returns the root of the structure; raises ScenarioError for an element that is not supported."""
    root = package.root(package.folder / STRUCTURE)
    if root.tag != tag("ssd:SystemStructureDescription"):
        raise package.error(f"{STRUCTURE}: expected a SystemStructureDescription of SSP")
    version = root.get("version", "")
    if not version.startswith(("1.", "2.")):
        raise package.error(f"{STRUCTURE}: version {version!r}: expected 1.0 or 2.0")
    for path, name in _REFUSED:
        if root.find("/".join(step if step == "*" else tag(step) for step in path.split("/"))) is not None:
            raise package.error(f"{name}: not supported; expected components and plain connections")
    return root


def _components(root: Element, package: OpenedPackage) -> dict[str, Path]:
    components = {}
    for component in root.iter(tag("ssd:Component")):
        name = component.get("name", "")
        package.check_attribute(component, "type", "application/x-fmu-sharedlibrary", name)
        components[name] = package.file(component.get("source", ""), name)
    return components


def _turn_connections(root: Element, package: OpenedPackage) -> None:
    """Turns connections from an input to an output: data flow as the kinds of the connectors have it.

    Source: SSP 2.0, 5.3 (Connections): start and end do not denote the direction.
    """
    kinds = {
        (component.get("name"), connector.get("name")): connector.get("kind")
        for component in root.iter(tag("ssd:Component"))
        for connector in component.iter(tag("ssd:Connector"))
    }
    for element in root.iter(tag("ssd:Connection")):
        ends = [element.get(f"{e}{part}", "") for e in ("start", "end") for part in ("Element", "Connector")]
        first, last = kinds.get((ends[0], ends[1])), kinds.get((ends[2], ends[3]))
        if first == last and first in ("input", "output"):
            names = f"{ends[0]}.{ends[1]} and {ends[2]}.{ends[3]}"
            raise package.error(f"connection of {names}, both {first}s: expected one output")
        if first == "input" or last == "output":
            keys = ("endElement", "endConnector", "startElement", "startConnector")
            element.attrib.update(zip(keys, ends, strict=True))


def _connection(element: Element, package: OpenedPackage) -> tuple[Any, ...]:
    for attribute in ("startIndices", "endIndices"):
        if attribute in element.attrib:
            raise package.error(f"{attribute} of a connection: not supported; expected scalar connectors")
    source, target = (
        f"{element.get(f'{end}Element', '')}.{element.get(f'{end}Connector', '')}" for end in ("start", "end")
    )
    transformation = element.find(tag("ssc:LinearTransformation"))
    if transformation is None:
        return source, target
    try:
        given = {name: float(value) for name, value in transformation.attrib.items()}
    except ValueError as error:
        raise package.error(f"connection {source} -> {target}: {error}; expected numbers") from error
    return source, target, given


def _check_conversions(
    root: Element, connections: Sequence[tuple[Any, ...]], ports: Mapping[str, Port], package: OpenedPackage
) -> None:
    """Refuses what SSP converts: units of connectors, and of a connector and its variable."""
    defined = _units(root, package)
    relative = {name for name, port in ports.items() if port.variable.is_relative}
    units = {name: (port.variable.unit or "", port.variable.units) for name, port in ports.items()}
    for component in root.iter(tag("ssd:Component")):
        for connector in component.iter(tag("ssd:Connector")):
            name = f"{component.get('name')}.{connector.get('name')}"
            own, of_fmu = units.get(name, ("", {}))
            unit = next((real.get("unit", "") for real in connector.iter(tag("ssc:Real"))), "")
            of_file = of_differences(defined) if name in relative else defined
            if not are_equal(unit, own, of_fmu, {**of_fmu, **of_file}):
                raise package.error(f"connector {name} is in {unit}: expected {own}, the unit in the FMU")
            if unit:
                units[name] = unit, {**of_fmu, **of_file}
    for element, (source, target, *given) in zip(root.iter(tag("ssd:Connection")), connections, strict=True):
        (start, of_start), (end, of_end) = units.get(source, ("", {})), units.get(target, ("", {}))
        converts = element.get("suppressUnitConversion", "false") not in ("true", "1")
        if converts and not are_equal(start, end, of_end, of_start):
            what, hint = f"a conversion of {start} to {end}", "equal units"
            if given:
                what = f"a transformation beside {what}"
                hint = 'suppressUnitConversion="true", or equal units'
            raise package.error(f"connection {source} -> {target}: {what}: not supported; expected {hint}")


def _by_causality(values: Values, known: CheckedSystem, connected: set[str]) -> tuple[Settings, Settings]:
    """Returns (parameters, inputs); SystemDefinitionError names file and line of what does not fit."""
    parameters, inputs = Settings(), Settings()
    for name, (value, place) in values.items():
        if name in connected:
            continue
        try:
            port = known.port(name, "parameter")
            settings = inputs if port.variable.causality == "input" else parameters
            settings[name] = fmi_value(port, value)
        except SystemDefinitionError as error:
            raise SystemDefinitionError(f"{place}{error}") from None
    return parameters, inputs


def _times(
    root: Element, descriptions: Mapping[str, ModelDescription], package: OpenedPackage
) -> dict[str, float]:
    """Returns the times of an experiment [s]; without a step size, the smallest that an FMU suggests."""
    default = root.find(tag("ssd:DefaultExperiment"))
    stop = None if default is None else default.get("stopTime")
    if default is None or stop is None:
        raise package.error("expected a default experiment with a stop time")
    given = [algorithm.get("baseStepSize") for algorithm in default.iter(tag("osp:FixedStepAlgorithm"))]
    suggested = [d.defaultExperiment.stepSize for d in descriptions.values() if d.defaultExperiment]
    try:
        steps = [float(step) for step in given or suggested if step]
        start_time, stop_time = float(default.get("startTime", "0")), float(stop)
    except ValueError as error:
        raise package.error(f"default experiment: {error}; expected numbers of seconds") from error
    if not steps:
        raise package.error("expected a communication step size, from it or from an FMU")
    return {"start_time": start_time, "stop_time": stop_time, "step_size": min(steps)}

"""An SSP package, 1.0 or 2.0 -> a scenario that our master runs.

Read are the components and connections of one system, parameter values inline or in .ssv files at components
or at the system, and the default experiment. Values are taken in the units of the FMUs. Elements that are not
understood are refused rather than ignored; so is a name that fits no variable, which SSP permits.
"""

import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from fmus.errors import nearest
from fmus.files import extract_archive
from fmus.fmi.description import describe, of_causality, start_value
from fmus.fmi.model_description import ModelDescription
from orchestration.errors import ScenarioError
from orchestration.exchange.ssp_package import OpenedPackage
from orchestration.exchange.ssp_parameters import Values, bound_values, chosen_values
from orchestration.exchange.ssp_xml import STRUCTURE, tag
from orchestration.scenarios.scenario import Scenario
from orchestration.system.experiment import Experiment
from orchestration.system.system import System

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
    """The scenario in a package, its FMUs extracted until the context ends.

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
    connections = tuple(_connection(element, package) for element in root.iter(tag("ssd:Connection")))
    _check_conversions(root, package)
    descriptions = {name: describe(path) for name, path in components.items()}
    values = chosen_values(parameter_set, package) if parameter_set else bound_values(root, package)
    parameters, inputs = _by_causality(values, descriptions, {target for _, target, *_ in connections})
    start, stop, step = _times(root, descriptions, package)
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
        experiment=Experiment(stop, step, start, parameters=parameters, inputs=inputs, record=tuple(outputs)),
        metrics={},
        resolved={
            "components": {name: path.name for name, path in components.items()},
            "connections": [list(connection) for connection in connections],
            "experiment": {"start_time": start, "stop_time": stop, "step_size": step},
            "parameters": parameters,
            "inputs": inputs,
        },
    )


def _checked_root(package: OpenedPackage) -> Element:
    """The root of the structure, if it holds nothing that is refused."""
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


def _check_conversions(root: Element, package: OpenedPackage) -> None:
    """Refuse a transformation that SSP makes in addition to a conversion of units, which we do not make."""
    units = {
        (component.get("name"), connector.get("name")): real.get("unit")
        for component in root.iter(tag("ssd:Component"))
        for connector in component.iter(tag("ssd:Connector"))
        for real in connector.iter(tag("ssc:Real"))
    }
    for element in root.iter(tag("ssd:Connection")):
        start, end = (
            units.get((element.get(f"{e}Element"), element.get(f"{e}Connector"))) for e in ("start", "end")
        )
        converts = element.get("suppressUnitConversion", "false") not in ("true", "1")
        is_transformed = element.find(tag("ssc:LinearTransformation")) is not None
        if is_transformed and converts and start and end and start != end:
            source, target = _connection(element, package)[:2]
            raise package.error(
                f"connection {source} -> {target}: a transformation beside a conversion of {start} to {end}: "
                'not supported; expected suppressUnitConversion="true", or equal units'
            )


def _by_causality(
    values: Values, descriptions: Mapping[str, ModelDescription], connected: set[str]
) -> tuple[Values, Values]:
    """(parameters, inputs): an input that nothing drives keeps the start value of its FMU."""
    inputs = {
        f"{component}.{variable.name}": start_value(variable)
        for component, description in descriptions.items()
        for variable in of_causality(description, "input")
        if f"{component}.{variable.name}" not in connected
    }
    settable = {name: value for name, value in values.items() if name not in connected}
    parameters = {name: value for name, value in settable.items() if name not in inputs}
    return parameters, inputs | {name: settable[name] for name in settable if name in inputs}


def _times(
    root: Element, descriptions: Mapping[str, ModelDescription], package: OpenedPackage
) -> tuple[float, ...]:
    """Start, stop and step [s]; a step size that is not given is the smallest that an FMU suggests."""
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
    return start_time, stop_time, min(steps)

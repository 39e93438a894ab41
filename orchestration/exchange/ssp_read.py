"""An SSP 1.0 package -> a scenario that our master runs.

Read are the components and connections of one system, parameter values inline or in .ssv files at components
or at the system, and the default experiment. Values are taken in the units of the FMUs. What is not
understood is refused rather than ignored; a name that fits no variable, too, though SSP lets it pass.
"""

import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from fmpy.model_description import ModelDescription

from fmus.errors import nearest
from orchestration.errors import ScenarioError
from orchestration.exchange.arrays import start_value
from orchestration.exchange.ssp_xml import STRUCTURE, read_value, tag
from orchestration.fmi.description import describe
from orchestration.scenarios.scenario import Scenario
from orchestration.system.experiment import Experiment
from orchestration.system.system import System

_REFUSED = (
    ("ssd:System/ssd:Connectors", "connectors of the system itself"),
    ("ssd:System/ssd:Elements/ssd:System", "a system inside the system"),
    ("ssd:System/ssd:Elements/ssd:SignalDictionaryReference", "a signal dictionary"),
    ("ssd:System/ssd:Connections/ssd:Connection/*", "a transformation or geometry of a connection"),
)


@contextmanager
def opened(package: Path, parameter_set: str = "") -> Iterator[Scenario]:
    """The scenario in a package, its FMUs extracted until the context ends.

    parameter_set: name of an .ssv in the package, whose values replace those bound in it.
    Raises ScenarioError for what cannot be read.
    """
    if not package.is_file():
        beside = [each.name for each in package.parent.glob("*.ssp")]
        raise ScenarioError(f"no package {package}; beside it, {nearest(package.name, beside)}")
    with tempfile.TemporaryDirectory(prefix="l1-depth-ssp-") as folder:
        try:
            with zipfile.ZipFile(package) as archive:
                archive.extractall(folder)
        except (zipfile.BadZipFile, EOFError, zlib.error, RuntimeError, NotImplementedError) as error:
            raise ScenarioError(f"{package}: expected an SSP package, a zip: {error}") from error
        yield _scenario(Path(folder), package, parameter_set)


def _scenario(folder: Path, package: Path, parameter_set: str) -> Scenario:
    root = _parsed(folder / STRUCTURE, package)
    if root.tag != tag("ssd:SystemStructureDescription"):
        raise ScenarioError(f"{package}: {STRUCTURE}: expected a SystemStructureDescription of SSP 1.0")
    for path, what in _REFUSED:
        if root.find("/".join(step if step == "*" else tag(step) for step in path.split("/"))) is not None:
            raise ScenarioError(
                f"{package}: {what}: not supported; expected components and plain connections"
            )
    components = _components(root, folder, package)
    connections = tuple(_connection(each) for each in root.iter(tag("ssd:Connection")))
    descriptions = {name: describe(path) for name, path in components.items()}
    bound = _chosen_set(folder, parameter_set) if parameter_set else _bound_values(root, folder, package)
    parameters, inputs = _by_causality(bound, descriptions, {target for _, target in connections})
    times = _times(root, descriptions, package)
    record = tuple(_outputs(root))
    experiment = Experiment(**times, parameters=parameters, inputs=inputs, record=record)
    system = root.find(tag("ssd:System"))
    resolved = {
        "components": {name: path.name for name, path in components.items()},
        "connections": [list(pair) for pair in connections],
        "experiment": times,
        "parameters": parameters,
        "inputs": inputs,
    }
    return Scenario(
        name=parameter_set or package.stem,
        title=parameter_set or (system is not None and system.get("description")) or package.stem,
        system=System(components, connections),
        experiment=experiment,
        metrics={},
        resolved=resolved,
    )


def _inside(folder: Path, source: str, what: str, package: Path) -> Path:
    """A file of the package, and nothing outside it."""
    path = PurePosixPath(source)
    plain = not path.is_absolute() and ".." not in path.parts and not {"\\", ":"} & set(source)
    if not (plain and (folder / path).is_file()):
        raise ScenarioError(f"{package}: {what}: source {source!r}: expected a file in the package")
    return folder / path


def _only(element: Element, attribute: str, expected: str, what: str, package: Path) -> None:
    """Refuse what an attribute says otherwise; unstated is as expected."""
    if element.get(attribute, expected) != expected:
        said = element.get(attribute)
        raise ScenarioError(f"{package}: {what}: {attribute} {said!r}: expected {expected!r}")


def _parsed(path: Path, package: Path) -> Element:
    try:
        if b"<!DOCTYPE" in path.read_bytes():
            raise ScenarioError(f"{package}: {path.name}: expected XML without a document type")
        return ElementTree.parse(path).getroot()
    except FileNotFoundError:
        beside = [each.name for each in path.parent.glob("*")] if path.parent.is_dir() else []
        raise ScenarioError(f"{package}: no {path.name} in it; {nearest(path.name, beside)}") from None
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise ScenarioError(f"{package}: {path.name}: expected XML: {error}") from error


def _components(root: Element, folder: Path, package: Path) -> dict[str, Path]:
    found = {}
    for component in root.iter(tag("ssd:Component")):
        name = component.get("name", "")
        _only(component, "type", "application/x-fmu-sharedlibrary", name, package)
        found[name] = _inside(folder, component.get("source", ""), name, package)
    return found


def _outputs(root: Element) -> Iterator[str]:
    """What the package shows of its components is what a run records."""
    for component in root.iter(tag("ssd:Component")):
        for connector in component.iter(tag("ssd:Connector")):
            if connector.get("kind") == "output":
                yield f"{component.get('name')}.{connector.get('name')}"


def _connection(element: Element) -> tuple[str, str]:
    ends = [
        (element.get(f"{end}Element", ""), element.get(f"{end}Connector", "")) for end in ("start", "end")
    ]
    return f"{ends[0][0]}.{ends[0][1]}", f"{ends[1][0]}.{ends[1][1]}"


def _bound_values(root: Element, folder: Path, package: Path) -> dict[str, Any]:
    """ "component.variable" -> value; the system's bindings go over the components' (SSP 1.0, 5.3.2)."""
    found = {}
    for component in root.iter(tag("ssd:Component")):
        values = _bindings(component, folder, package)
        found |= {f"{component.get('name')}.{name}": value for name, value in values.items()}
    for system in root.findall(tag("ssd:System")):
        found |= _bindings(system, folder, package)
    return found


def _bindings(element: Element, folder: Path, package: Path) -> dict[str, Any]:
    found = {}
    for binding in element.findall(f"{tag('ssd:ParameterBindings')}/{tag('ssd:ParameterBinding')}"):
        if binding.find(tag("ssd:ParameterMapping")) is not None:
            raise ScenarioError(f"{package}: a parameter mapping: not supported; expected names of variables")
        _only(binding, "type", "application/x-ssp-parameter-set", "a parameter binding", package)
        _only(binding, "sourceBase", "SSD", "a parameter binding", package)
        source, prefix = binding.get("source"), binding.get("prefix", "")
        inline = binding.iter(tag("ssv:ParameterSet"))
        path = _inside(folder, source, "a parameter binding", package) if source else None
        sets = [_parsed(path, package)] if path else inline
        for each in sets:
            found |= {prefix + name: value for name, value in _values(each, package).items()}
    return found


def _chosen_set(folder: Path, name: str) -> dict[str, Any]:
    """The values of the .ssv file whose parameter set has that name."""
    known = {}
    for path in sorted(folder.rglob("*.ssv")):
        root = _parsed(path, path)
        known[root.get("name", "")] = root
    if name not in known:
        raise ScenarioError(f"no parameter set {name!r} in the package; {nearest(name, known)}")
    return _values(known[name], name)


def _values(parameter_set: Element, where: object) -> dict[str, Any]:
    try:
        return {p.get("name", ""): read_value(p) for p in parameter_set.iter(tag("ssv:Parameter"))}
    except ValueError as error:
        raise ScenarioError(f"{where}: {error}") from error


def _by_causality(
    values: Mapping[str, Any], descriptions: Mapping[str, ModelDescription], connected: set[str]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """(parameters, inputs): an input that nothing drives keeps the start value that its FMU states."""
    inputs = {
        f"{component}.{v.name}": start_value(v)
        for component, description in descriptions.items()
        for v in description.modelVariables
        if v.causality == "input" and f"{component}.{v.name}" not in connected
    }
    given = {name: value for name, value in values.items() if name not in connected}
    parameters = {name: value for name, value in given.items() if name not in inputs}
    return parameters, inputs | {name: given[name] for name in given if name in inputs}


def _times(root: Element, descriptions: Mapping[str, ModelDescription], package: Path) -> dict[str, Any]:
    """Times [s]; a step size that is not stated is the smallest that an FMU suggests."""
    default = root.find(tag("ssd:DefaultExperiment"))
    stop = None if default is None else default.get("stopTime")
    if default is None or stop is None:
        raise ScenarioError(f"{package}: expected a default experiment with a stop time")
    stated = [each.get("baseStepSize") for each in default.iter(tag("osp:FixedStepAlgorithm"))]
    suggested = [d.defaultExperiment.stepSize for d in descriptions.values() if d.defaultExperiment]
    try:
        steps = [float(step) for step in stated or suggested if step]
        start_time, stop_time = float(default.get("startTime", "0")), float(stop)
    except ValueError as error:
        raise ScenarioError(f"{package}: default experiment: {error}; expected numbers of seconds") from error
    if not steps:
        raise ScenarioError(f"{package}: expected a communication step size, from it or from an FMU")
    return {"start_time": start_time, "stop_time": stop_time, "step_size": min(steps)}

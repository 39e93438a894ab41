"""Writer of a scenario as an SSP package: FMUs, connections, units, default experiment, parameter sets.

    SystemStructure.ssd     the scenario that was packaged
    NAME.ssd                the same system as each other scenario of its family has it
    parameters/NAME.ssv     the values of each, named "component.variable"
    resources/*.fmu         with the values of the packaged scenario as start values, where they can be built

Only what OMSimulator, libcosim, Ecos, fmucontainer and FMPy all understand, but for systems in systems,
which components "system.component" need: no connector of the outermost system, no two structures of one
name, values inline at each component, enumeration items as integers. Ecos and FMPy apply no values without
the name of a set, fmucontainer none at all: therefore FMUs start with them.
What SSP 1.0 has for FMI 2.0 is in 2.0 as well, with the same namespaces: the versions differ in their number.
"""

import itertools
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from fmus.files import write_archive, xml_document
from fmus.fmi.description import start_value
from fmus.fmi.integer_enumerations import without_enumerations
from fmus.fmi.variable_types import FmiValue
from orchestration.exchange import ssp_xml
from orchestration.exchange.limits import (
    BuildSource,
    RampSource,
    check_plain_exchange,
    check_scalars,
    ramp_sources,
    with_sources,
)
from orchestration.exchange.ssp_xml import STRUCTURE, SspVersion, add, add_value
from orchestration.scenarios.fmu_files import fmu_file
from orchestration.scenarios.layers import components_of, file_layers
from orchestration.scenarios.scenario import Scenario, load, shipped
from orchestration.system.experiment import Experiment
from orchestration.system.prepared_run import PreparedRun, prepare
from orchestration.system.system import CheckedSystem, Port


@dataclass(frozen=True)
class _Variant:
    """A variant in the package: one scenario, its signals replaced by components."""

    name: str
    title: str
    version: SspVersion
    prepared: PreparedRun
    settings: Mapping[str, FmiValue]  # "component.variable" -> value, of every variable that a scenario sets

    @property
    def heading(self) -> dict[str, str]:
        """Attributes of the root of each of its files."""
        return {"version": self.version, "name": self.name}

    @property
    def connectors(self) -> list[Port]:
        """Every port that is connected or recorded."""
        system = self.prepared.system
        ports = [port for pair in system.connections for port in pair]
        ports += [system.ports[name] for name in self.prepared.recorded]
        return list({port.name: port for port in ports}.values())

    @property
    def values(self) -> list[tuple[Port, FmiValue]]:
        """Parameters and constant inputs; the value of a Real is a float."""
        ports = self.prepared.system.ports
        return [
            (ports[name], float(value) if ports[name].variable.type == "Real" else value)
            for name, value in self.settings.items()
        ]

    def values_of(self, component: str) -> dict[str, FmiValue]:
        """Returns variable -> value."""
        return {port.variable.name: value for port, value in self.values if port.component == component}


BuildStarted = Callable[[Path, Mapping[str, FmiValue], Path], Path]
"""(FMU, variable -> start value, folder) -> the FMU that starts with them; as it is if none can be built."""


def package(
    scenario: Scenario,
    path: Path,
    build_source: BuildSource,
    build_started: BuildStarted = lambda fmu, starts, folder: fmu,
    version: SspVersion = SspVersion.V1,
) -> Path:
    """Writes the scenario, and every shipped one of the same system as a variant, to `path`.

    build_source: makes the FMU that gives a signal; called once for every driven input
    build_started: makes the FMU of a component that starts with the values of the scenario
    Raises ScenarioError for a scenario with more than `check_plain_exchange` allows, another signal than
    ramps, or an array of FMI 3.0.
    """
    scenarios = family(scenario)
    for variant in scenarios:
        check_plain_exchange(variant.experiment, f"an SSP package of {variant.name}")
    sources = ramp_sources(scenarios)
    with tempfile.TemporaryDirectory(prefix="l1-depth-sources-") as folder:
        fmus = {target: build_source(source, Path(folder)) for target, source in sources.items()}
        variants = _with_all_settings([_variant(chosen, version, sources, fmus) for chosen in scenarios])
        for variant in variants:
            named = [*variant.connectors, *(port for port, _ in variant.values)]
            check_scalars(named, variant.prepared.system, f"an SSP package of {variant.name}")
        packed = {
            name: build_started(fmu, variants[0].values_of(name), Path(folder, name))
            for name, fmu in variants[0].prepared.system.components.items()
        }
        return write_archive(path, _members(variants, packed))


def _members(variants: Sequence[_Variant], fmus: Mapping[str, Path]) -> dict[str, bytes]:
    """Returns path inside the package -> content; importers open the first scenario.

    fmus: of each component
    """
    members: dict[str, bytes] = {}
    resources: dict[str, str] = {}
    for component, fmu in fmus.items():
        content = without_enumerations(fmu.read_bytes())
        path = next(path for path in _resource_paths(component, fmu) if members.get(path, content) == content)
        members[path], resources[component] = content, path
    structures = {f"{variant.name}.ssd": _structure(variant, resources) for variant in variants}
    parameters = {f"parameters/{v.name}.ssv": xml_document(_parameter_set(v)) for v in variants}
    members[STRUCTURE] = structures.pop(f"{variants[0].name}.ssd")
    return members | structures | parameters


def _resource_paths(component: str, fmu: Path) -> Iterator[str]:
    """Yields the paths that the FMU of a component may have, the preferred one first; endless.

    They are URIs (RFC 3986) without escapes, which of the importers libcosim alone decodes.
    """
    numbered = (f"{component}_{number}.fmu" for number in itertools.count(2))
    names = itertools.chain((fmu.name, f"{component}.fmu"), numbered)
    return (f"resources/{re.sub(r'[^A-Za-z0-9._~-]', '_', name)}" for name in names)


def _with_all_settings(variants: Sequence[_Variant]) -> list[_Variant]:
    """Returns variants that set the same variables: the FMU's start value where one has no value."""
    ports = {name: variant.prepared.system.ports[name] for variant in variants for name in variant.settings}
    starts = {name: start_value(port.variable) for name, port in ports.items()}
    return [replace(variant, settings={**starts, **variant.settings}) for variant in variants]


def family(scenario: Scenario) -> list[Scenario]:
    """Returns the scenario and the shipped ones with equal components, connections and driven inputs."""
    components = dict(scenario.system.components)
    # a scenario of other FMUs is not loaded: those that it replaces would have to be built
    paths = [path for path in shipped().values() if _components_of(path) == components]
    others = [load(path) for path in paths if path.stem != scenario.name]
    return [scenario, *(other for other in others if _structure_of(other) == _structure_of(scenario))]


def _components_of(path: Path) -> dict[str, Path]:
    return {name: fmu_file(fmu) for name, fmu in components_of(file_layers(path)).items()}


def _structure_of(scenario: Scenario) -> tuple[dict[str, Path], tuple[Any, ...], set[str]]:
    system = scenario.system
    return dict(system.components), system.connections, set(scenario.experiment.signals)


def _variant(
    scenario: Scenario, version: SspVersion, sources: Mapping[str, RampSource], fmus: Mapping[str, Path]
) -> _Variant:
    system, experiment = with_sources(scenario, sources, fmus)
    prepared = prepare(system, experiment)
    settings = {port.name: value for port, value in prepared.settings}
    return _Variant(scenario.name, scenario.title, version, prepared, settings)


def _structure(variant: _Variant, resources: Mapping[str, str]) -> bytes:
    root = ssp_xml.root("ssd:SystemStructureDescription", **variant.heading)
    root.set("generationTool", "l1-depth")
    system = add(root, "ssd:System", name="system", description=variant.title)
    _fill(system, "", variant, resources)
    _master(system, variant.prepared.experiment)
    _units(root, "ssd:Units", variant.prepared.system, variant.connectors)
    _default_experiment(root, variant.prepared.experiment)
    return xml_document(root)


def _fill(system: Element, path: str, variant: _Variant, resources: Mapping[str, str]) -> None:
    """Adds the elements and connections of a system; path: its name with a dot, "" for the outermost."""
    elements = add(system, "ssd:Elements")
    own = [name.removeprefix(path).partition(".")[0] for name in resources if name.startswith(path)]
    for name in dict.fromkeys(own):
        if path + name in resources:
            _component(elements, path + name, resources[path + name], variant)
            continue
        inner, within = add(elements, "ssd:System", name=name), f"{path}{name}."
        pairs = variant.prepared.system.connections
        crossing = [p for p in pairs if len({end.component.startswith(within) for end in p}) == 2]
        ports = {port.name: port for p in crossing for port in p if port.component.startswith(within)}
        if ports:
            _connectors(inner, {port.name.removeprefix(within): port for port in ports.values()})
        _fill(inner, within, variant, resources)
    connections, given = add(system, "ssd:Connections"), list[dict[str, str]]()
    for source, target in variant.prepared.system.connections:
        (start, output), (end, into) = _end(source, target, path), _end(target, source, path)
        named = {"startElement": start, "startConnector": output, "endElement": end, "endConnector": into}
        ends = {name: text for name, text in named.items() if text}
        # outside of the system, or inside one of its systems
        is_elsewhere = start == end and path + start not in resources
        if is_elsewhere or ends in given:
            continue
        given.append(ends)
        connection = add(connections, "ssd:Connection", **ends)
        transformation = variant.prepared.system.transformations.get(target.name)
        if transformation and start and end:
            # the factor acts on unconverted values: an importer must not convert units as well
            connection.set("suppressUnitConversion", "true")
            values = {"factor": repr(transformation.factor), "offset": repr(transformation.offset)}
            add(connection, "ssc:LinearTransformation", **values)
    if not given:
        system.remove(connections)  # the schema has no empty one


def _end(port: Port, other: Port, path: str) -> tuple[str, str]:
    """Returns element and connector of a connection's end; "" and the system's connector if it is outside."""
    if not port.component.startswith(path):
        return "", other.name.removeprefix(path)
    element = port.component.removeprefix(path).partition(".")[0]
    return element, port.name.removeprefix(f"{path}{element}.")


def _connectors(parent: Element, ports: Mapping[str, Port]) -> None:
    connectors = add(parent, "ssd:Connectors")
    for name, variable in ((name, port.variable) for name, port in ports.items()):
        connector = add(connectors, "ssd:Connector", name=name, kind=variable.causality or "")
        unit = {"unit": variable.unit} if variable.type == "Real" and variable.unit else {}
        add(connector, f"ssc:{variable.type}", **unit)


def _component(parent: Element, name: str, source: str, variant: _Variant) -> None:
    exchange = variant.prepared.system.descriptions[name].is_model_exchange
    kind = {"type": "application/x-fmu-sharedlibrary"}
    kind |= {"implementation": "ModelExchange" if exchange else "CoSimulation"}
    component = add(parent, "ssd:Component", name=name.rpartition(".")[2], source=source, **kind)
    own_ports = [port for port in variant.connectors if port.component == name]
    _connectors(component, {port.variable.name: port for port in own_ports})
    own = variant.values_of(name).items()
    if own:
        binding = add(add(component, "ssd:ParameterBindings"), "ssd:ParameterBinding")
        values = add(add(binding, "ssd:ParameterValues"), "ssv:ParameterSet", **variant.heading)
        _parameters(values, own)


def _parameters(
    parent: Element, values: Iterable[tuple[str, FmiValue]], units: Mapping[str, str] = {}
) -> None:
    parameters = add(parent, "ssv:Parameters")
    for name, value in values:
        add_value(add(parameters, "ssv:Parameter", name=name), value, units.get(name))


def _parameter_set(variant: _Variant) -> Element:
    """Returns all values of the system, with units."""
    root = ssp_xml.root("ssv:ParameterSet", **variant.heading, description=variant.title)
    units = {port.name: port.variable.unit or "" for port, _ in variant.values}
    _parameters(root, [(port.name, value) for port, value in variant.values], units)
    _units(root, "ssv:Units", variant.prepared.system, [port for port, _ in variant.values])
    return root


def _units(parent: Element, name: str, checked: CheckedSystem, ports: Iterable[Port]) -> None:
    """Adds the units of these variables as their FMUs define them."""
    used = {(port.component, port.variable.unit) for port in ports}
    base_units = {}
    for component, description in checked.descriptions.items():
        for unit in description.unitDefinitions:
            if (component, unit.name) in used and unit.baseUnit is not None:
                base_units[unit.name] = unit.baseUnit
    if not base_units:
        return
    units = add(parent, name)
    for unit, base in sorted(base_units.items()):
        stated = {name: str(exponent) for name, exponent in base.exponents.items()}
        scale = {
            k: repr(v) for k, v in (("factor", base.factor), ("offset", base.offset)) if v != (k == "factor")
        }
        add(add(units, "ssc:Unit", name=unit), "ssc:BaseUnit", **stated, **scale)


def _master(system: Element, experiment: Experiment) -> None:
    """Adds the step size as OMSimulator looks for it: version 3 in attributes, version 2 in a child."""
    annotation = add(add(system, "ssd:Annotations"), "ssc:Annotation", type=ssp_xml.OMS)
    step = repr(experiment.step_size)
    # the solver of this name is the one of components that name none
    solver = {"name": "oms_ma_default", "method": "oms_ma", "fixedStepSize": step}
    information = add(add(annotation, "oms:Annotations"), "oms:SimulationInformation", **solver)
    master = {"description": "oms-ma", "stepSize": step, "relativeTolerance": "0.0001"}
    add(information, "oms:FixedStepMaster", **master)


def _default_experiment(parent: Element, experiment: Experiment) -> None:
    """Adds times and, as libcosim and our reader look for it, the step size: SSP has no place for it."""
    times = {"startTime": repr(experiment.start_time), "stopTime": repr(experiment.stop_time)}
    default = add(parent, "ssd:DefaultExperiment", **times)
    annotation = add(add(default, "ssd:Annotations"), "ssc:Annotation", type=ssp_xml.OSP)
    algorithm = add(annotation, "osp:Algorithm")
    add(algorithm, "osp:FixedStepAlgorithm", baseStepSize=repr(experiment.step_size))

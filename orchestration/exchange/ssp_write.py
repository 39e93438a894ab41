"""A scenario -> an SSP 1.0 package: FMUs, connections, units, default experiment, parameter sets.

    SystemStructure.ssd     the scenario that was packaged
    NAME.ssd                the same system as each scenario of its family has it
    parameters/NAME.ssv     the values of each, named "component.variable"
    resources/*.fmu

Only what libcosim, Ecos, fmucontainer and FMPy all understand: no connector of the system itself, values
inline at each component, enumeration items as integers.
"""

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from fmus.files import write_archive
from fmus.fmi_types import FmiValue
from orchestration.errors import SystemDefinitionError
from orchestration.exchange import ssp_xml
from orchestration.exchange.integer_enumerations import without_enumerations
from orchestration.exchange.limits import check_plain_exchange
from orchestration.exchange.signal_sources import BuildSource, RampSource, ramp_sources, with_sources
from orchestration.exchange.ssp_xml import STRUCTURE, add, add_value
from orchestration.scenarios.scenario import Scenario, load, shipped
from orchestration.system.experiment import Experiment
from orchestration.system.prepared_run import PreparedRun, prepare
from orchestration.system.system import CheckedSystem, Port


@dataclass(frozen=True)
class _Variant:
    """One scenario of the package, its signals replaced by components."""

    name: str
    title: str
    prepared: PreparedRun

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
        return [
            (port, float(value) if port.variable.type == "Real" else value)
            for port, value in self.prepared.settings
        ]


def package(scenario: Scenario, path: Path, build_source: BuildSource) -> Path:
    """Write the scenario, and every shipped one of the same system as a variant, to `path`.

    build_source: makes the FMU that gives a signal; called once for every driven input
    Raises ScenarioError for a scenario with more than `check_plain_exchange` allows, or another signal than
    ramps.
    """
    scenarios = family(scenario)
    for variant in scenarios:
        check_plain_exchange(variant.experiment, f"an SSP package of {variant.name}")
    sources = ramp_sources(scenarios)
    with tempfile.TemporaryDirectory(prefix="l1-depth-sources-") as folder:
        fmus = {target: build_source(source, Path(folder)) for target, source in sources.items()}
        return write_archive(path, _members(scenarios, sources, fmus))


def _members(
    scenarios: Sequence[Scenario], sources: Mapping[str, RampSource], fmus: Mapping[str, Path]
) -> dict[str, bytes]:
    """Path inside the package -> content; the first scenario is the one that importers open."""
    variants = [_variant(scenario, sources, fmus) for scenario in scenarios]
    members = {STRUCTURE: _structure(variants[0])}
    for variant in variants:
        members[f"{variant.name}.ssd"] = _structure(variant)
        members[f"parameters/{variant.name}.ssv"] = ssp_xml.document(_parameter_set(variant))
    for component, fmu in variants[0].prepared.system.components.items():
        content = without_enumerations(fmu.read_bytes())
        if members.setdefault(f"resources/{fmu.name}", content) != content:
            raise SystemDefinitionError(f"{component}: {fmu}: expected different names of different FMUs")
    return members


def family(scenario: Scenario) -> list[Scenario]:
    """The scenario and the shipped ones with the same components, connections and driven inputs."""
    others = [load(path) for name, path in shipped().items() if name != scenario.name]
    return [scenario, *(other for other in others if _structure_of(other) == _structure_of(scenario))]


def _structure_of(scenario: Scenario) -> tuple[dict[str, Path], tuple[Any, ...], set[str]]:
    system = scenario.system
    return dict(system.components), system.connections, set(scenario.experiment.signals)


def _variant(scenario: Scenario, sources: Mapping[str, RampSource], fmus: Mapping[str, Path]) -> _Variant:
    system, experiment = with_sources(scenario, sources, fmus)
    return _Variant(scenario.name, scenario.title, prepare(system, experiment))


def _structure(variant: _Variant) -> bytes:
    root = ssp_xml.root("ssd:SystemStructureDescription", version="1.0", name=variant.name)
    root.set("generationTool", "l1-depth")
    system = add(root, "ssd:System", name="system", description=variant.title)
    elements = add(system, "ssd:Elements")
    for name, fmu in variant.prepared.system.components.items():
        _component(elements, name, fmu, variant)
    connections = add(system, "ssd:Connections")
    for source, target in variant.prepared.system.connections:
        ends = {"startElement": source.component, "startConnector": source.variable.name}
        ends |= {"endElement": target.component, "endConnector": target.variable.name}
        connection = add(connections, "ssd:Connection", **ends)
        transformation = variant.prepared.system.transformations.get(target.name)
        if transformation:
            connection.set("suppressUnitConversion", "true")  # the factor is between the values as they are
            values = {"factor": repr(transformation.factor), "offset": repr(transformation.offset)}
            add(connection, "ssc:LinearTransformation", **values)
    _units(root, "ssd:Units", variant.prepared.system, variant.connectors)
    _default_experiment(root, variant.prepared.experiment)
    return ssp_xml.document(root)


def _component(parent: Element, name: str, fmu: Path, variant: _Variant) -> None:
    kind = {"type": "application/x-fmu-sharedlibrary", "source": f"resources/{fmu.name}"}
    component = add(parent, "ssd:Component", name=name, **kind)
    connectors = add(component, "ssd:Connectors")
    for variable in (port.variable for port in variant.connectors if port.component == name):
        connector = add(connectors, "ssd:Connector", name=variable.name, kind=variable.causality or "")
        unit = {"unit": variable.unit} if variable.type == "Real" and variable.unit else {}
        add(connector, f"ssc:{variable.type}", **unit)
    own = [(port.variable.name, value) for port, value in variant.values if port.component == name]
    if own:
        binding = add(add(component, "ssd:ParameterBindings"), "ssd:ParameterBinding")
        values = add(
            add(binding, "ssd:ParameterValues"), "ssv:ParameterSet", version="1.0", name=variant.name
        )
        _parameters(values, own)


def _parameters(
    parent: Element, values: Iterable[tuple[str, FmiValue]], units: Mapping[str, str] = {}
) -> None:
    parameters = add(parent, "ssv:Parameters")
    for name, value in values:
        add_value(add(parameters, "ssv:Parameter", name=name), value, units.get(name))


def _parameter_set(variant: _Variant) -> Element:
    """All values of the system, with units."""
    root = ssp_xml.root("ssv:ParameterSet", version="1.0", name=variant.name, description=variant.title)
    units = {port.name: port.variable.unit or "" for port, _ in variant.values}
    _parameters(root, [(port.name, value) for port, value in variant.values], units)
    _units(root, "ssv:Units", variant.prepared.system, [port for port, _ in variant.values])
    return root


def _units(parent: Element, name: str, checked: CheckedSystem, ports: Iterable[Port]) -> None:
    """The units of these variables as their FMUs define them."""
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
        exponents = {b: str(getattr(base, b)) for b in ("kg", "m", "s", "A", "K", "mol", "cd", "rad")}
        stated = {b: exponent for b, exponent in exponents.items() if exponent != "0"}
        scale = {
            k: repr(v) for k, v in (("factor", base.factor), ("offset", base.offset)) if v != (k == "factor")
        }
        add(add(units, "ssc:Unit", name=unit), "ssc:BaseUnit", **stated, **scale)


def _default_experiment(parent: Element, experiment: Experiment) -> None:
    """Times; the step size, for which SSP has no place, as libcosim and our reader look for it."""
    times = {"startTime": repr(experiment.start_time), "stopTime": repr(experiment.stop_time)}
    default = add(parent, "ssd:DefaultExperiment", **times)
    annotation = add(add(default, "ssd:Annotations"), "ssc:Annotation", type=ssp_xml.OSP)
    algorithm = add(annotation, "osp:Algorithm")
    add(algorithm, "osp:FixedStepAlgorithm", baseStepSize=repr(experiment.step_size))

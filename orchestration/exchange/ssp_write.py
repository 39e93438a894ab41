"""A scenario -> an SSP 1.0 package: FMUs, connections, units, default experiment, parameter sets.

    SystemStructure.ssd     the scenario that was packaged
    NAME.ssd                the same system as each scenario of its family has it
    parameters/NAME.ssv     the values of each, named "component.variable"
    resources/*.fmu

Only what libcosim, Ecos, fmucontainer and FMPy all understand: no connector of the system itself, values
inline at each component, enumeration items as integers.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from fmus.files import write_archive
from orchestration.errors import ScenarioError, SystemDefinitionError
from orchestration.exchange import ssp_xml
from orchestration.exchange.integer_enumerations import without_enumerations
from orchestration.exchange.signal_sources import with_sources
from orchestration.exchange.ssp_xml import STRUCTURE, add, add_value
from orchestration.scenarios import scenario
from orchestration.scenarios.scenario import Scenario
from orchestration.system.experiment import Experiment
from orchestration.system.prepared_run import prepare
from orchestration.system.system import CheckedSystem, Port


@dataclass(frozen=True)
class _Variant:
    """One scenario as it goes into the package."""

    name: str
    title: str
    checked: CheckedSystem
    experiment: Experiment
    values: list[tuple[Port, Any]]

    @property
    def connected(self) -> dict[str, Port]:
        """Every port that is connected or recorded, by name."""
        ports = [port for pair in self.checked.connections for port in pair]
        ports += [self.checked.port(name, "record") for name in self.experiment.record]
        return {port.name: port for port in ports}


def package(chosen: Scenario, path: Path) -> Path:
    """Write the scenario, and every shipped one of the same system as a variant, to `path`.

    Raises ScenarioError for what SSP cannot carry: events, faults, and signals other than ramps.
    """
    variants = {each.name: _variant(each) for each in family(chosen)}
    members = {STRUCTURE: _structure(variants[chosen.name])}
    for name, variant in variants.items():
        members[f"{name}.ssd"] = _structure(variant)
        members[f"parameters/{name}.ssv"] = ssp_xml.document(_parameter_set(variant))
    for component, fmu in variants[chosen.name].checked.components.items():
        content = without_enumerations(fmu.read_bytes())
        if members.setdefault(f"resources/{fmu.name}", content) != content:
            raise SystemDefinitionError(f"{component}: {fmu}: expected different names of different FMUs")
    return write_archive(path, members)


def family(chosen: Scenario) -> list[Scenario]:
    """The scenario and the shipped ones with the same components, connections and driven inputs."""
    shipped = [scenario.load(path) for name, path in scenario.shipped().items() if name != chosen.name]
    return [chosen, *(each for each in shipped if _kind(each) == _kind(chosen))]


def _kind(of: Scenario) -> tuple:
    return dict(of.system.components), of.system.connections, set(of.experiment.signals)


def _variant(chosen: Scenario) -> _Variant:
    special = chosen.experiment.beyond_the_plain_loop()
    if special:
        raise ScenarioError(f"{chosen.name} with {special}: expected none, an SSP package cannot carry them")
    system, experiment = with_sources(chosen)
    prepared = prepare(system, experiment)
    settings = [(port, _typed(port, value)) for port, value in prepared.settings]
    return _Variant(chosen.name, chosen.title, prepared.system, experiment, settings)


def _typed(port: Port, value: Any) -> Any:
    return float(value) if port.variable.type == "Real" else value


def _structure(variant: _Variant) -> bytes:
    root = ssp_xml.root("ssd:SystemStructureDescription", version="1.0", name=variant.name)
    root.set("generationTool", "l1-depth")
    system = add(root, "ssd:System", name="system", description=variant.title)
    elements = add(system, "ssd:Elements")
    for name in variant.checked.components:
        _component(elements, name, variant)
    connections = add(system, "ssd:Connections")
    for source, target in variant.checked.connections:
        ends = {"startElement": source.component, "startConnector": source.variable.name}
        ends |= {"endElement": target.component, "endConnector": target.variable.name}
        add(connections, "ssd:Connection", **ends)
    _units(root, "ssd:Units", variant.checked, variant.connected.values())
    _default_experiment(root, variant.experiment)
    return ssp_xml.document(root)


def _component(parent: Element, name: str, variant: _Variant) -> None:
    fmu = variant.checked.components[name]
    kind = {"type": "application/x-fmu-sharedlibrary", "source": f"resources/{fmu.name}"}
    component = add(parent, "ssd:Component", name=name, **kind)
    connectors = add(component, "ssd:Connectors")
    for port in variant.connected.values():
        if port.component == name:
            variable = port.variable
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


def _parameters(parent: Element, values: Iterable[tuple[str, Any]], units: Mapping[str, str] = {}) -> None:
    parameters = add(parent, "ssv:Parameters")
    for name, value in values:
        add_value(add(parameters, "ssv:Parameter", name=name), value, units.get(name))


def _parameter_set(variant: _Variant) -> Element:
    """All values of the system, with units."""
    root = ssp_xml.root("ssv:ParameterSet", version="1.0", name=variant.name, description=variant.title)
    units = {port.name: port.variable.unit or "" for port, _ in variant.values}
    _parameters(root, [(port.name, value) for port, value in variant.values], units)
    _units(root, "ssv:Units", variant.checked, [port for port, _ in variant.values])
    return root


def _units(parent: Element, name: str, checked: CheckedSystem, ports: Iterable[Port]) -> None:
    """The units of these variables as their FMUs define them."""
    used = {(port.component, port.variable.unit) for port in ports}
    found = {}
    for component, description in checked.descriptions.items():
        for unit in description.unitDefinitions:
            if (component, unit.name) in used and unit.baseUnit is not None:
                found[unit.name] = unit.baseUnit
    if not found:
        return
    units = add(parent, name)
    for unit, base in sorted(found.items()):
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

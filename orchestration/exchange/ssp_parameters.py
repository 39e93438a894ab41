"""The parameter values of an SSP package: bound inline, by .ssv files, or of one chosen .ssv file."""

from xml.etree.ElementTree import Element

from fmus.errors import nearest
from fmus.fmi.variable_types import FmiValue
from orchestration.errors import ScenarioError
from orchestration.exchange.ssp_package import OpenedPackage
from orchestration.exchange.ssp_xml import read_value, tag

Values = dict[str, FmiValue]


def bound_values(root: Element, package: OpenedPackage) -> Values:
    """ "component.variable" -> value; the system's bindings go over the components' (SSP 1.0, 5.3.2)."""
    values: Values = {}
    for component in root.iter(tag("ssd:Component")):
        own = _bindings(component, package)
        values |= {f"{component.get('name')}.{name}": value for name, value in own.items()}
    for system in root.findall(tag("ssd:System")):
        values |= _bindings(system, package)
    return values


def chosen_values(name: str, package: OpenedPackage) -> Values:
    """The values of the .ssv file whose parameter set has that name."""
    roots = {}
    for file in sorted(package.folder.rglob("*.ssv")):
        root = package.root(file)
        roots[root.get("name", "")] = root
    if name not in roots:
        raise ScenarioError(f"no parameter set {name!r} in the package; {nearest(name, roots)}")
    return _values(roots[name], package)


def _bindings(element: Element, package: OpenedPackage) -> Values:
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
            own = _values(parameter_set, package)
            values |= {prefix + name: value for name, value in own.items()}
    return values


def _values(parameter_set: Element, package: OpenedPackage) -> Values:
    try:
        return {p.get("name", ""): read_value(p) for p in parameter_set.iter(tag("ssv:Parameter"))}
    except ValueError as error:
        raise package.error(str(error)) from error

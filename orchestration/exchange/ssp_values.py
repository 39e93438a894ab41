"""Parameter values of an SSP package: bindings at every level, their order, prefixes and mappings."""

from collections.abc import Iterator
from typing import NamedTuple
from xml.etree.ElementTree import Element

from fmus.errors import nearest
from fmus.fmi.variable_types import FmiValue
from orchestration.errors import ScenarioError
from orchestration.exchange.ssp_package import OpenedPackage
from orchestration.exchange.ssp_xml import read_value, tag
from orchestration.system.quantities import StatedValue, stated
from orchestration.system.quantities import read_value as in_unit_of_variable
from orchestration.system.system import LinearTransformation, Port
from orchestration.system.values import fmi_value


class BoundValue(NamedTuple):
    """A value of a parameter set, in the unit of the set, and its place before messages.

    transformations: of mappings and connections, which act after the unit is converted
    """

    value: FmiValue
    place: str
    transformations: tuple[LinearTransformation, ...] = ()

    def of(self, port: Port) -> FmiValue:
        """Returns the value of a variable; raises SystemDefinitionError for one that does not fit."""
        value = self.value
        if self.transformations and isinstance(value, StatedValue):
            value = in_unit_of_variable(value, port.variable)
        for transformation in self.transformations:
            if isinstance(value, str):
                raise ScenarioError(f"{self.place}{value!r} with a linear transformation: expected a number")
            value = transformation(value)
        return fmi_value(port, value)


Values = dict[str, BoundValue]


def bound_values(system: Element, root: Element, package: OpenedPackage, path: str = "") -> Values:
    """Returns "system.component.variable", or "system.connector", -> value.

    The last binding at a level goes over those before it, a higher level over a lower one.
    Source: SSP 2.0, 5.3.2 (ParameterBindings).
    """
    values = Values()
    for element in system.iterfind(f"{tag('ssd:Elements')}/*"):
        values |= bound_values(element, root, package, f"{path}{element.get('name')}.")
    for binding in system.iterfind(f"{tag('ssd:ParameterBindings')}/{tag('ssd:ParameterBinding')}"):
        values |= {path + name: value for name, value in _of_binding(binding, root, package)}
    return values


def chosen_values(name: str, package: OpenedPackage) -> Values:
    """Returns the values of the .ssv file whose parameter set has that name."""
    roots = {}
    for file in sorted(package.folder.rglob("*.ssv")):
        root = package.root(file)
        roots[root.get("name", "")] = root
    if name not in roots:
        raise ScenarioError(f"no parameter set {name!r} in the package; {nearest(name, roots)}")
    return _of_set(roots[name], roots[name], package)


def _of_binding(binding: Element, root: Element, package: OpenedPackage) -> Iterator[tuple[str, BoundValue]]:
    """Yields the values of a binding, whose prefix stands before the names that a mapping maps."""
    external = package.sourced(binding, "parameter-set", "a parameter binding")
    inline = binding.iterfind(f"{tag('ssd:ParameterValues')}/*")
    mapping = binding.find(tag("ssd:ParameterMapping"))
    entries = None
    if mapping is not None:
        sourced = package.sourced(mapping, "parameter-mapping", "a parameter mapping")
        entries = list((mapping if sourced is None else sourced).iter(tag("ssm:MappingEntry")))
    for parameter_set in [external] if external is not None else inline:
        own = _of_set(parameter_set, root if external is None else external, package)
        values = {binding.get("prefix", "") + name: value for name, value in own.items()}
        if entries is None:
            yield from values.items()
            continue
        for entry in entries:
            if (value := values.get(entry.get("source", ""))) is not None:
                target = entry.get("target", "")
                yield target, _mapped(value, entry, package, f"mapping of {target}")


def _of_set(parameter_set: Element, root: Element, package: OpenedPackage) -> Values:
    """Returns the values of a parameter set, texts where they have units; root: of its file."""
    values, units = Values(), package.units(root)
    for parameter in parameter_set.iter(tag("ssv:Parameter")):
        place = parameter.get("place", "")
        try:
            value = read_value(parameter)
        except ValueError as error:
            raise ScenarioError(f"{place}{error}") from error
        if unit := next((element.get("unit") for element in parameter if element.get("unit")), ""):
            # some tools write [m]
            unit = unit if unit in units else unit.strip("[]")
            value = stated(f"{value!r} {unit}", "", str(package.path), units)
        values[parameter.get("name", "")] = BoundValue(value, place)
    return values


def _mapped(bound: BoundValue, entry: Element, package: OpenedPackage, purpose: str) -> BoundValue:
    """Returns the value as an entry of a mapping transforms it."""
    value = bound.value
    if is_suppressed(entry) and isinstance(value, StatedValue):
        value = float(value.partition(" ")[0])
    table = [item for kind in entry for item in kind.iter(tag("ssc:MapEntry"))]
    for item in table:
        # a text of XML against a value: true and 1 are one Boolean
        texts = {str(value).lower(), str(int(value))} if isinstance(value, bool) else {str(value)}
        if item.get("source") in texts:
            target = item.get("target", "")
            try:
                given = target in ("true", "1") if isinstance(value, bool) else type(bound.value)(target)
            except ValueError as error:
                raise package.error(f"{purpose}: target {target!r}: {error}") from None
            return bound._replace(value=given)
    linear = linear_transformation(entry, package, purpose)
    return bound._replace(value=value, transformations=(linear,) if linear else ())


def is_suppressed(element: Element) -> bool:
    """Whether a connection or a mapping switches the conversion of units off."""
    return element.get("suppressUnitConversion", "false") in ("true", "1")


def linear_transformation(
    element: Element, package: OpenedPackage, purpose: str
) -> LinearTransformation | None:
    """Returns the linear transformation of a connection or a mapping; None without one."""
    given = element.find(tag("ssc:LinearTransformation"))
    if given is None:
        return None
    try:
        return LinearTransformation(**{name: float(value) for name, value in given.attrib.items()})
    except (TypeError, ValueError) as error:
        raise package.error(f"{purpose}: {error}; expected numbers, factor and offset") from error

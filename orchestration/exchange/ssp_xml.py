"""The XML of SSP: its namespaces, and elements with values of the types that FMI 2.0 has."""

from collections.abc import Callable
from contextlib import suppress
from enum import StrEnum
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from fmus.fmi.variable_types import FmiValue


class SspVersion(StrEnum):
    """The versions of SSP that packages are written in."""

    V1 = "1.0"
    V2 = "2.0"


_STANDARD = "http://ssp-standard.org/SSP1/SystemStructure"
NAMESPACES = {
    "ssd": f"{_STANDARD}Description",
    "ssc": f"{_STANDARD}Common",
    "ssv": f"{_STANDARD}ParameterValues",
    "ssm": f"{_STANDARD}ParameterMapping",
    "osp": "http://opensimulationplatform.com/SSP/OSPAnnotations",
    "oms": "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd",
}
STRUCTURE = "SystemStructure.ssd"  # the file that every importer opens
OSP, OMS = "com.opensimulationplatform", "org.openmodelica"  # types of annotations

for _prefix, _uri in NAMESPACES.items():
    # some importers search for these prefixes as text, whatever the namespace
    ElementTree.register_namespace(_prefix, _uri)


def tag(name: str) -> str:
    """Returns the name that ElementTree uses for "prefix:name"."""
    prefix, _, local = name.partition(":")
    return f"{{{NAMESPACES[prefix]}}}{local}"


def add(parent: Element, name: str, /, **attributes: str) -> Element:
    """Adds a child called "prefix:name" and returns it."""
    return ElementTree.SubElement(parent, tag(name), attributes)


def root(name: str, /, **attributes: str) -> Element:
    return Element(tag(name), attributes)


def add_value(parent: Element, value: FmiValue, unit: str | None = None) -> None:
    """Adds the value of an ssv:Parameter. An enumeration item is an Integer: few importers read another."""
    kind = {bool: "Boolean", int: "Integer", float: "Real"}.get(type(value), "String")
    text = str(value).lower() if kind == "Boolean" else str(value)
    add(parent, f"ssv:{kind}", value=text, **({"unit": unit} if unit and kind == "Real" else {}))


def read_value(parameter: Element) -> FmiValue:
    """Returns the value of an ssv:Parameter.

    Raises ValueError for a type that FMI does not have, or a value of another type.
    """
    read: dict[str, Callable[[str], FmiValue]] = {"Real": float, "String": str, "Enumeration": str}
    read |= {"Integer": int, **dict.fromkeys(("Float32", "Float64"), float)}
    read |= {f"{sign}Int{bits}": int for sign in ("", "U") for bits in (8, 16, 32, 64)}
    read["Boolean"] = {"true": True, "1": True, "false": False, "0": False}.__getitem__
    for element in parameter:
        kind, text = element.tag.rpartition("}")[2], element.get("value", "")
        with suppress(KeyError, ValueError):
            value = read[kind](text)
            # Python, not XML, groups digits of a number by underscores
            if isinstance(value, str) or "_" not in text:
                return value
    expected = "a value of type Real, Integer, Boolean or String"
    raise ValueError(f"parameter {parameter.get('name')!r}: expected {expected}")

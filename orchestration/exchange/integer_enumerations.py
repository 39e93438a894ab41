"""An FMU whose enumerations are integers, for importers that know none.

libcosim and Ecos (libcosimpy 0.0.6, ecospy 0.7.2) leave variables of type Enumeration out: what they cannot
set keeps its start value, with no more than a line in the log. FMI 2.0 passes items of an enumeration as
integers, so that a description which says Integer fits the same library. Nothing else of the FMU changes.
"""

import io
import zipfile
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

_DESCRIPTION = "modelDescription.xml"


def without_enumerations(fmu: bytes) -> bytes:
    """The FMU with each Enumeration described as Integer, its items named in the variable's description."""
    written = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(fmu)) as source, zipfile.ZipFile(written, "w") as target:
        for info in source.infolist():
            content = source.read(info)
            if info.filename == _DESCRIPTION:
                content = _rewritten(content)
            target.writestr(info, content)
    return written.getvalue()


def _rewritten(description: bytes) -> bytes:
    root = ElementTree.fromstring(description)
    definitions = root.find("TypeDefinitions")
    items = {}
    for simple in root.findall("TypeDefinitions/SimpleType"):
        declared = simple.find("Enumeration")
        if definitions is not None and declared is not None:
            items[simple.get("name")] = {int(i.get("value", "0")): i.get("name") for i in declared}
            definitions.remove(simple)
    if definitions is not None and not len(definitions):
        root.remove(definitions)
    for variable in root.iter("ScalarVariable"):
        enumeration = variable.find("Enumeration")
        if enumeration is not None:
            _become_integer(variable, enumeration, items[enumeration.get("declaredType")])
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)


def _become_integer(variable: Element, enumeration: Element, items: dict[int, str | None]) -> None:
    named = ", ".join(f"{number} {name}" for number, name in sorted(items.items()))
    variable.set("description", f"{variable.get('description', '')}: {named}".lstrip(": "))
    start = enumeration.get("start")
    enumeration.tag, enumeration.attrib = "Integer", {"min": str(min(items)), "max": str(max(items))}
    if start is not None:
        enumeration.set("start", start)

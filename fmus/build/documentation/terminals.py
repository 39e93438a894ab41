"""Terminals: which ports belong together, in the file format of FMI 3.0 (2.4.9, terminalsAndIcons.xml).

FMI 2.0.4 took the file over as it is, at the same place (2.3, Terminals and Icons). It is written on request
alone: FMI Library 3.0.4 reads it as a file of FMI 3.0 and prints FATAL lines. Two terminals are enough: what
goes in and what comes out. Both match as a bus, that is, members of equal name are connected, so the
outputs of a block plug into those inputs of the next that bear their names. `GraphicalRepresentation` is left
out: the icon is model.png, and some readers take the first child of the root for the terminals.
"""

from xml.etree import ElementTree

from fmus.block import Block
from fmus.files import xml_document

PATH = "terminalsAndIcons/terminalsAndIcons.xml"
_TERMINALS = (("inputs", "input", "Every input"), ("outputs", "output", "Every output"))


def terminals(block: Block) -> dict[str, bytes]:
    """Path inside the FMU -> content; nothing for a block without ports."""
    root = ElementTree.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    listed = ElementTree.SubElement(root, "Terminals")
    for name, causality, description in _TERMINALS:
        if variables := block.of_causality(causality):
            attributes = {"name": name, "matchingRule": "bus", "description": description}
            terminal = ElementTree.SubElement(listed, "Terminal", attributes)
            for v in variables:
                member = {"variableName": v.name, "memberName": v.name, "variableKind": "signal"}
                ElementTree.SubElement(terminal, "TerminalMemberVariable", member)
    return {PATH: xml_document(root)} if len(listed) else {}

"""Block -> FMU of compiled C that needs nothing on the host.

The GUID is derived from everything that decides what the libraries do: model description, C sources,
compiler and its flags. It does not depend on which platforms were built.
"""

from collections.abc import Sequence
from xml.etree import ElementTree

from fmus.block import Block
from fmus.documentation.page import documentation
from fmus.documentation.terminals import terminals
from fmus.export.archive import NO_GUID, guid_of, licenses, with_entry_point
from fmus.export.c_source import COMPILED, c_sources, header_license
from fmus.export.model_description import model_description
from fmus.export.toolchain import COMPILER, FLAGS, compile_library, runtime_licenses
from fmus.platforms import check_platforms, host_platform, library_name

_CAPABILITIES = {
    "needsExecutionTool": "false",
    "canHandleVariableCommunicationStepSize": "true",
    "canInterpolateInputs": "true",
    "maxOutputDerivativeOrder": "1",
    "canRunAsynchronuously": "false",
    "canBeInstantiatedOnlyOncePerProcess": "false",
    "canNotUseMemoryManagementFunctions": "false",
    "canGetAndSetFMUstate": "true",
    "canSerializeFMUstate": "true",
    "providesDirectionalDerivative": "true",
}


def content(block: Block) -> tuple[str, dict[str, bytes]]:
    """(GUID, path -> content) of the FMU without its libraries."""
    recipe = {"compiler": " ".join((*COMPILER, *FLAGS)).encode()}
    guid = guid_of(_members(block, NO_GUID) | recipe)
    return guid, _members(block, guid)


def _members(block: Block, guid: str) -> dict[str, bytes]:
    sources = {f"sources/{name}": text.encode() for name, text in c_sources(block, guid).items()}
    return {
        **sources,
        **documentation(block),
        **terminals(block),
        **with_entry_point(licenses("l1-depth") | header_license() | runtime_licenses()),
        "sources/buildDescription.xml": _build_description(block.name),
        "modelDescription.xml": model_description(block, guid, _CAPABILITIES, COMPILED),
    }


def _build_description(name: str) -> bytes:
    root = ElementTree.Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    configuration = ElementTree.SubElement(root, "BuildConfiguration", {"modelIdentifier": name})
    files = ElementTree.SubElement(configuration, "SourceFileSet", {"language": "C99"})
    for file in COMPILED:
        ElementTree.SubElement(files, "SourceFile", {"name": file})
    ElementTree.indent(root)
    return ElementTree.tostring(root, xml_declaration=True, encoding="UTF-8")


def libraries(name: str, members: dict[str, bytes], platforms: Sequence[str]) -> dict[str, bytes]:
    """Path inside the FMU -> library, from the sources among the members; by default for this platform.

    Raises ExportError for an unknown platform.
    """
    chosen = check_platforms(platforms) or (host_platform(),)
    prefix = "sources/"
    sources = {
        path.removeprefix(prefix): text.decode() for path, text in members.items() if path.startswith(prefix)
    }
    return {
        library_name(name, platform): compile_library(name, sources, COMPILED, platform)
        for platform in chosen
    }

"""Block -> FMU of compiled C that needs nothing on the host.

The GUID is derived from everything that decides what the libraries do: model description, C sources,
compiler and its flags. It does not depend on which platforms were built.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from xml.etree import ElementTree

from fmus.block import Block
from fmus.build.c_source import COMPILED, c_sources
from fmus.build.documentation.page import documentation, licenses
from fmus.build.model_description import GUID, model_description, with_guid
from fmus.files import xml_document
from fmus.fmi.integer_enumerations import REALS_ONLY, with_other_types
from fmus.native.toolchain import COMPILER, FLAGS, compiling
from fmus.platforms import check_platforms, host_platform, library_name

_CAPABILITIES = {
    "canInterpolateInputs": "true",
    "maxOutputDerivativeOrder": "1",
    "canNotUseMemoryManagementFunctions": "true",
    "providesDirectionalDerivative": "true",
}


def content(block: Block, reals_only: bool = False) -> tuple[str, dict[str, bytes]]:
    """Returns (GUID, path -> content) of the FMU without its libraries.

    reals_only: whether every variable is a Real, for importers that know no other type
    """
    description = model_description(block, GUID, _CAPABILITIES, COMPILED)
    members = {
        **{f"sources/{name}": text.encode() for name, text in c_sources(block, GUID, reals_only).items()},
        **documentation(block, *COMPILED, reals_only=reals_only),
        **licenses("l1-depth", "fmi-headers", "zig", "mingw-w64"),
        "sources/buildDescription.xml": _build_description(block.name),
        "modelDescription.xml": with_other_types(description, REALS_ONLY) if reals_only else description,
    }
    return with_guid(members, recipe=" ".join((*COMPILER, *FLAGS)))


def _build_description(name: str) -> bytes:
    root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ElementTree.SubElement(root, "BuildConfiguration", modelIdentifier=name)
    files = ElementTree.SubElement(configuration, "SourceFileSet", language="C99")
    for file in COMPILED:
        ElementTree.SubElement(files, "SourceFile", name=file)
    unprefixed = {"name": "FMI2_OVERRIDE_FUNCTION_PREFIX", "optional": "true"}
    unprefixed["description"] = "for a shared library: functions without the prefix of a static one"
    ElementTree.SubElement(files, "PreprocessorDefinition", unprefixed)
    return xml_document(root)


def libraries(name: str, members: dict[str, bytes], platforms: Sequence[str]) -> dict[str, bytes]:
    """Returns path inside the FMU -> library, made from its sources; by default for this platform.

    Raises ExportError for an unknown platform.
    """
    with compiled_libraries(name, members, platforms) as compiled:
        return compiled()


@contextmanager
def compiled_libraries(
    name: str, members: dict[str, bytes], platforms: Sequence[str]
) -> Iterator[Callable[[], dict[str, bytes]]]:
    """Starts compiling `libraries` beside this process; the returned function waits for them."""
    sources = {Path(path).name: members[path].decode() for path in members if path.startswith("sources/")}
    with ExitStack() as stack:
        ends = {
            library_name(name, platform): stack.enter_context(compiling(name, sources, COMPILED, platform))
            for platform in check_platforms(platforms) or (host_platform(),)
        }
        yield lambda: {path: end() for path, end in ends.items()}

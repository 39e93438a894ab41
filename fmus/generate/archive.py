"""Traced block -> members of its FMU: path inside it -> content.

The GUID of a native FMU follows from the compiler with its flags and from all members except the libraries
and the members whose digests stand in the bill of materials, such as the icon. It does not depend on which
platforms were built. The GUID of an FMU of the python flavour follows from everything inside. Its binary is
PythonFMU's; docs/fidelity.md lists the limits that follow from this.
"""

from collections.abc import Iterable, Mapping
from importlib import resources
from importlib.metadata import version
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from fmus.block import Block
from fmus.files import xml_document
from fmus.fmi.integer_enumerations import REALS_ONLY, with_other_types
from fmus.generate.describe import ModelExchange, fmi3_description, model_description
from fmus.generate.documentation.page import documentation, licenses
from fmus.generate.python import python_modules
from fmus.guid import GUID, with_guid
from fmus.native import sbom
from fmus.platforms import PLATFORMS, library_name

if TYPE_CHECKING:
    from fmus.generate.trace import Traced  # it loads CasADi, which the FMU of a class does without

OF_PYTHON = {
    "canInterpolateInputs": "false",
    "maxOutputDerivativeOrder": "0",
    "canNotUseMemoryManagementFunctions": "true",
    "providesDirectionalDerivative": "false",
}
_OF_BOTH = {"canNotUseMemoryManagementFunctions": "true", "providesDirectionalDerivative": "true"}
_OF_EXCHANGE = {"completedIntegratorStepNotNeeded": "true", **_OF_BOTH}
_OF_CO_SIMULATION = {"canInterpolateInputs": "true", "maxOutputDerivativeOrder": "0", **_OF_BOTH}
# both write parts of the C sources
_WRITERS = ("l1-depth", "casadi")


def native_members(
    traced: "Traced", reals_only: bool = False, fmi: int = 2, scalars: bool = False
) -> tuple[str, dict[str, bytes]]:
    """Returns (GUID, path -> content) of a native FMU without its libraries.

    reals_only: whether every variable is a Real, for importers that support no other type
    fmi: the version of the standard, 2 or 3
    scalars: whether the elements of arrays are variables, of FMI 3.0; they always are of FMI 2.0
    """
    from fmus.generate.derivatives import Sensitivities
    from fmus.generate.native import COMPILED, c_sources

    block, files, modes = traced.block, COMPILED[fmi], Sensitivities(traced)
    sources = c_sources(traced, modes, GUID, reals_only, fmi, scalars)
    if fmi == 3:
        description = fmi3_description(traced, modes, GUID, scalars)
    else:
        known = (*block.of_causality("input"), *block.states)
        present = modes.exchange.dependencies(known)
        exchange = ModelExchange(_OF_EXCHANGE, traced.indicators, traced.restarted, present)
        initial = modes.of_settable()
        description = model_description(block, GUID, _OF_CO_SIMULATION, initial, exchange, files)
    members = {
        **{f"sources/{name}": text.encode() for name, text in sources.items()},
        **documentation(block, *files, reals_only=reals_only, fmi=fmi, scalars=scalars),
        **licenses("l1-depth", "fmi-headers", "zig", "mingw-w64", fmi=fmi),
        "sources/buildDescription.xml": _build_description(block.name, files, fmi),
        **bill_of_materials(block, {}, fmi),
        "modelDescription.xml": with_other_types(description, REALS_ONLY) if reals_only else description,
    }
    return with_guid(members, recipe=sbom.RECIPE)


def python_members(traced: "Traced") -> tuple[str, dict[str, bytes]]:
    """Returns (GUID, path -> content) of an FMU that runs the block's own Python source."""
    from fmus.generate.derivatives import Sensitivities

    block, initial = traced.block, Sensitivities(traced).of_settable()
    files = {path: text.encode() for path, text in python_modules(block).items()}
    return with_resources(block, files, model_description(block, GUID, OF_PYTHON, initial))


def with_resources(
    block: Block, files: Mapping[str, bytes], description: bytes
) -> tuple[str, dict[str, bytes]]:
    """Returns (GUID, path -> content) of an FMU of PythonFMU's binary with these files in its resources."""
    dependencies = resources.files("fmus.generate.documentation") / "externalDependencies.txt"
    members = {
        **{f"resources/{path}": content for path, content in files.items()},
        **_binaries(block.name),
        **licenses("l1-depth", "pythonfmu"),
        **documentation(block),
        "documentation/externalDependencies.txt": dependencies.read_bytes(),
        "modelDescription.xml": description,
    }
    return with_guid(members)


def _binaries(name: str) -> dict[str, bytes]:
    folder = resources.files("pythonfmu") / "resources" / "binaries"
    return {
        f"binaries/{platform.name}/{name}{library.name[library.name.rindex('.') :]}": library.read_bytes()
        for platform in folder.iterdir()
        for library in platform.iterdir()
        if library.name.endswith((".so", ".dll", ".dylib"))
    }


def _build_description(name: str, compiled: Iterable[str], fmi: int) -> bytes:
    root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ElementTree.SubElement(root, "BuildConfiguration", modelIdentifier=name)
    files = ElementTree.SubElement(configuration, "SourceFileSet", language="C99")
    for file in compiled:
        ElementTree.SubElement(files, "SourceFile", name=file)
    unprefixed = {"name": f"FMI{fmi}_OVERRIDE_FUNCTION_PREFIX", "optional": "true"}
    unprefixed["description"] = "for a shared library: functions without the prefix of a static one"
    ElementTree.SubElement(files, "PreprocessorDefinition", unprefixed)
    return xml_document(root)


def bill_of_materials(block: Block, files: Mapping[str, bytes], fmi: int = 2) -> dict[str, bytes]:
    """Returns path inside the FMU -> bill of materials of its libraries, with digests of other files.

    files: path inside the FMU -> content
    fmi: the version of the standard
    """
    module = {"name": "l1-depth:module", "value": block.output.__module__}
    subject = sbom.component(
        block.name, block.version, block.license, description=block.description, properties=[module]
    )
    own, casadi = (sbom.component(name, version(name), None, type="application") for name in _WRITERS)
    layer = sbom.component("l1-depth", version("l1-depth"), "MIT", description="sources, but for model*.h")
    headers = sbom.component("fmi-headers", f"{fmi}.0", "BSD-2-Clause")
    platforms = {library_name(block.name, platform, fmi): platform for platform in PLATFORMS}
    known = {path: (platforms.get(path, ""), content) for path, content in files.items()}
    return {sbom.MEMBER: sbom.bill_of_materials(subject, [layer, headers], [own, casadi], known)}

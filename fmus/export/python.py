"""Block -> FMU that runs the block's own Python source, standard library only, through PythonFMU.

PythonFMU gives the binary and the interface of the slave. Model description, GUID, state and module
names are our own; what its binary makes impossible is listed in docs/fidelity.md.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import resources

from fmus.block import Block
from fmus.documentation.page import documentation
from fmus.errors import ExportError
from fmus.export.archive import GUID, GUID_IN_NAMES, licenses, with_guid
from fmus.export.model_description import model_description
from fmus.export.sources import defined_as, in_package, source_closure

_CAPABILITIES = {
    "canInterpolateInputs": "false",
    "maxOutputDerivativeOrder": "0",
    "canNotUseMemoryManagementFunctions": "true",
    "providesDirectionalDerivative": "false",
}

_ENTRY = '''"""Entry point of the FMU {name}: the class that PythonFMU's binary instantiates."""

import ctypes

from {package}.{module} import {attribute}
from {package}.fmus.export.slave import BlockSlave

# PythonFMU 0.7 drops one reference to this dictionary too many whenever it has run this file
ctypes.pythonapi.Py_IncRef(ctypes.py_object(globals()))


class {name}(BlockSlave):
    block = {attribute}
    fingerprint = "{guid}"
'''


def content(block: Block) -> tuple[str, dict[str, bytes]]:
    """(GUID, path -> content) of the FMU; the GUID is derived from everything inside."""
    dependencies = resources.files("fmus.documentation") / "externalDependencies.txt"
    module, attribute = defined_as(block)
    entry = f"{block.name.lower()}_{GUID_IN_NAMES}"
    package = f"{entry}_sources"
    text = in_package(source_closure(module), package) | {
        f"{entry}.py": _ENTRY.format(
            name=block.name, package=package, module=module, attribute=attribute, guid=GUID
        ),
        "slavemodule.txt": entry,
    }
    members = {
        **{f"resources/{path}": source.encode() for path, source in text.items()},
        **_binaries(block.name),
        **licenses("l1-depth", "pythonfmu"),
        **documentation(block),
        "documentation/externalDependencies.txt": dependencies.read_bytes(),
        "modelDescription.xml": model_description(block, GUID, _CAPABILITIES),
    }
    return with_guid(members)


@contextmanager
def compiled_libraries(
    name: str, members: dict[str, bytes], platforms: Sequence[str]
) -> Iterator[Callable[[], dict[str, bytes]]]:
    """Nothing to compile: PythonFMU's binaries are among the members. Raises ExportError for any platform."""
    if platforms:
        raise ExportError("platforms of the python flavour: expected none, its libraries are PythonFMU's")
    yield dict


def _binaries(name: str) -> dict[str, bytes]:
    folder = resources.files("pythonfmu") / "resources" / "binaries"
    return {
        f"binaries/{platform.name}/{name}{library.name[library.name.rindex('.') :]}": library.read_bytes()
        for platform in folder.iterdir()
        for library in platform.iterdir()
        if library.name.endswith((".so", ".dll", ".dylib"))
    }

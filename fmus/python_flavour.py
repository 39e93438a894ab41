"""Block -> FMU that runs the block's own Python source, standard library only, through PythonFMU.

PythonFMU gives the binary and the interface of the slave. Model description, GUID, state and module
names are our own; what its binary makes impossible is listed in docs/fidelity.md.
"""

import hashlib
import uuid
from importlib import resources
from importlib.metadata import distribution
from pathlib import Path

from fmus.archive import write_archive
from fmus.block import Block
from fmus.model_description import model_description
from fmus.sources import in_package, source_closure

FLAVOUR = "python"

_CAPABILITIES = {
    "needsExecutionTool": "false",
    "canHandleVariableCommunicationStepSize": "true",
    "canInterpolateInputs": "false",
    "maxOutputDerivativeOrder": "0",
    "canRunAsynchronuously": "false",
    "canBeInstantiatedOnlyOncePerProcess": "false",
    "canNotUseMemoryManagementFunctions": "true",
    "canGetAndSetFMUstate": "true",
    "canSerializeFMUstate": "true",
    "providesDirectionalDerivative": "false",
}

_ENTRY = '''"""Entry point of the FMU {name}: the class that PythonFMU's binary instantiates."""

import ctypes

from {package}.{module} import BLOCK
from {package}.fmus.slave import BlockSlave

# PythonFMU 0.7 drops one reference to this dictionary too many whenever it has run this file
ctypes.pythonapi.Py_IncRef(ctypes.py_object(globals()))


class {name}(BlockSlave):
    block = BLOCK
    fingerprint = "{guid}"
'''


def content(block: Block) -> tuple[str, dict[str, bytes]]:
    """(GUID, path -> content) of the FMU; the GUID is derived from everything inside."""
    guid = _guid(_members(block, str(uuid.UUID(int=0))))
    return guid, _members(block, guid)


def _members(block: Block, guid: str) -> dict[str, bytes]:
    module = block.step.__module__
    entry = f"{block.name.lower()}_{guid.replace('-', '')[:16]}"
    package = f"{entry}_sources"
    text = in_package(source_closure(module), package)
    text[f"{entry}.py"] = _ENTRY.format(name=block.name, package=package, module=module, guid=guid)
    text["slavemodule.txt"] = entry
    members = {f"resources/{path}": source.encode() for path, source in text.items()}
    members |= _binaries(block.name) | _licenses()
    members["modelDescription.xml"] = model_description(block, guid, _CAPABILITIES)
    return members


def build(block: Block, path: Path) -> Path:
    """Write the FMU of a block to `path`."""
    _, members = content(block)
    return write_archive(path, members)


def _guid(members: dict[str, bytes]) -> str:
    digest = hashlib.sha256()
    for name, data in sorted(members.items()):
        digest.update(hashlib.sha256(name.encode()).digest() + hashlib.sha256(data).digest())
    return str(uuid.uuid5(uuid.NAMESPACE_OID, digest.hexdigest()))


def _binaries(name: str) -> dict[str, bytes]:
    folder = resources.files("pythonfmu") / "resources" / "binaries"
    return {
        f"binaries/{platform.name}/{name}{Path(library.name).suffix}": library.read_bytes()
        for platform in folder.iterdir()
        for library in platform.iterdir()
        if library.name.endswith((".so", ".dll", ".dylib"))
    }


def _licenses() -> dict[str, bytes]:
    found = {}
    for project in ("l1-depth", "pythonfmu"):
        for file in distribution(project).files or ():
            if file.name == "LICENSE":
                text = Path(str(file.locate())).read_bytes()
                found[f"documentation/licenses/{project}.txt"] = text
    return found

"""Block -> FMU that runs the block's own Python source, standard library only, through PythonFMU.

PythonFMU gives the binary and the interface of the slave. Model description, GUID, state and module
names are our own; what its binary makes impossible is listed in docs/fidelity.md.
"""

import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping
from importlib import resources
from pathlib import Path

from fmus.block import Block
from fmus.errors import ExportError
from fmus.generate.documentation.page import documentation, licenses
from fmus.generate.model_description import model_description
from fmus.generate.sources import defined_as, in_package, source_closure
from fmus.guid import GUID, GUID_IN_NAMES, with_guid

CAPABILITIES = {
    "canInterpolateInputs": "false",
    "maxOutputDerivativeOrder": "0",
    "canNotUseMemoryManagementFunctions": "true",
    "providesDirectionalDerivative": "false",
}

_PATIENCE_S = 60  # for an import, which takes less than 1 s
_OURS = {"controller_fmu", "plant_fmu", "fmus"}  # need nothing but their modules, as the tests show

_ENTRY = '''"""Entry point of the FMU {name}: the class that PythonFMU's binary instantiates."""

import ctypes

{imports}

# PythonFMU 0.7 drops one reference to this dictionary too many whenever it has run this file
ctypes.pythonapi.Py_IncRef(ctypes.py_object(globals()))


class {name}({base}):
    {member}
    fingerprint = "{guid}"
'''


def content(block: Block) -> tuple[str, dict[str, bytes]]:
    """Returns (GUID, path -> content) of the FMU; the GUID is derived from everything inside."""
    module, attribute = defined_as(block)
    package = package_of(block.name)
    imports = (
        f"from {package}.{module} import {attribute}",
        f"from {package}.fmus.generate.slave import BlockSlave",
    )
    entry = entry_point(block.name, "BlockSlave", imports, f"block = {attribute}")
    text = in_package(source_closure(module), package) | entry
    if module.partition(".")[0] not in _OURS:
        _check_import(block, text, entry["slavemodule.txt"])
    resource_files = {path: source.encode() for path, source in text.items()}
    return with_guid(archive(block, resource_files, model_description(block, GUID, CAPABILITIES)))


def package_of(name: str) -> str:
    """Returns the package that holds the sources of an FMU, which no other FMU shares."""
    return f"{name.lower()}_{GUID_IN_NAMES}_sources"


def entry_point(name: str, base: str, imports: Iterable[str], member: str) -> dict[str, str]:
    """Returns path -> text of what PythonFMU's binary loads: a class of this name and base, with a member."""
    entry = package_of(name).removesuffix("_sources")
    text = _ENTRY.format(name=name, base=base, imports="\n".join(imports), member=member, guid=GUID)
    return {f"{entry}.py": text, "slavemodule.txt": entry}


def archive(block: Block, resource_files: Mapping[str, bytes], description: bytes) -> dict[str, bytes]:
    """Returns path -> content of an FMU with these files in its resources and this model description."""
    dependencies = resources.files("fmus.generate.documentation") / "externalDependencies.txt"
    return {
        **{f"resources/{path}": content for path, content in resource_files.items()},
        **_binaries(block.name),
        **licenses("l1-depth", "pythonfmu"),
        **documentation(block),
        "documentation/externalDependencies.txt": dependencies.read_bytes(),
        "modelDescription.xml": description,
    }


def _check_import(block: Block, text: dict[str, str], entry: str) -> None:
    """Raises ExportError for sources that need what the FMU does not carry, such as a file with a table.

    The packages that are installed here can be imported: a block that needs one passes.
    """
    with tempfile.TemporaryDirectory() as folder:
        for path, source in text.items():
            (Path(folder) / path).parent.mkdir(parents=True, exist_ok=True)
            (Path(folder) / path).write_text(source, encoding="utf-8")
        code = f"import sys; sys.path.insert(0, {folder!r}); import {entry}"
        command = [sys.executable, "-I", "-c", code]
        try:
            run = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, check=False, timeout=_PATIENCE_S
            )
        except subprocess.TimeoutExpired:
            raise ExportError(
                f"block {block.name!r}: its modules were not imported within {_PATIENCE_S} s: "
                "expected modules that only define it"
            ) from None
    if run.returncode:
        reason = (run.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise ExportError(
            f"block {block.name!r}: an FMU of the python flavour carries Python modules alone, which cannot "
            f"be imported: {reason}; write what they need into them, or build the native flavour"
        )


def _binaries(name: str) -> dict[str, bytes]:
    folder = resources.files("pythonfmu") / "resources" / "binaries"
    return {
        f"binaries/{platform.name}/{name}{library.name[library.name.rindex('.') :]}": library.read_bytes()
        for platform in folder.iterdir()
        for library in platform.iterdir()
        if library.name.endswith((".so", ".dll", ".dylib"))
    }

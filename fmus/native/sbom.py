"""The bill of materials of compiled libraries, in CycloneDX 1.6 (ECMA-424): their parts and tools.

It has no date and no random number: equal libraries have the same, byte for byte.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from typing import Any

from fmus.native.toolchain import COMPILER, FLAGS
from fmus.platforms import TARGETS

Component = dict[str, Any]
RECIPE = " ".join((*COMPILER, *FLAGS))
"""The compiler, its version and its options."""
MEMBER = "documentation/sbom.cdx.json"
"""The path of the bill inside an FMU."""
# parts of the libraries in an FMU: the written C, and the headers of FMI
_PARTS = 2
_RECIPE_NAME = "l1-depth:recipe"
_LIBC = {"linux": "glibc", "windows": "Universal C Runtime", "macos": "libSystem of macOS"}
_SPDX = {"BSD-2-Clause", "MIT", "ZPL-2.1"}


def component(name: str, version: str | None, licence: str | None, **more: Any) -> Component:
    """Returns a component of a bill; licence: an identifier of SPDX, or a text."""
    licences = [{"license": {"id" if licence in _SPDX else "name": licence}}] if licence else []
    entries = {"type": "library", "name": name, "version": version, "licenses": licences, **more}
    return {key: value for key, value in entries.items() if value}


def bill_of_materials(
    subject: Component,
    parts: Iterable[Component],
    tools: Iterable[Component],
    libraries: Mapping[str, tuple[str, bytes]],
) -> bytes:
    """Returns the bill as JSON.

    subject: the component that holds the libraries
    parts: components of the libraries, without those that the compiler adds
    tools: the programs that wrote their C
    libraries: path in the subject -> (platform, content); "" is the platform of another file
    """
    compiler = component(*COMPILER, "MIT", type="application")
    added = [component("compiler-rt of zig", COMPILER[1], "MIT")]
    if any(platform.startswith("win") for platform, _ in libraries.values()):
        added.append(component("mingw-w64 of zig", COMPILER[1], "ZPL-2.1"))
    files = [_file(path, *libraries[path]) for path in sorted(libraries)]
    bill = {
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {
            "tools": {"components": [*tools, compiler]},
            "component": subject,
            "properties": [{"name": _RECIPE_NAME, "value": RECIPE}],
        },
        "components": [*parts, *added, *files],
    }
    return (json.dumps(bill, indent=1) + "\n").encode()


def with_files(bill: bytes, files: Mapping[str, tuple[str, bytes]]) -> bytes:
    """Returns a bill of an FMU, as `bill_of_materials` gives it, with these libraries and other files."""
    document = json.loads(bill)
    subject, tools = document["metadata"]["component"], document["metadata"]["tools"]["components"]
    return bill_of_materials(subject, document["components"][:_PARTS], tools[:-1], files)


def _file(path: str, platform: str, content: bytes) -> Component:
    """Returns the component of a file: its digest; of a library its targets of zig and its C library, too."""
    digest = hashlib.sha256(content).hexdigest()
    file: Component = {"type": "file", "name": path, "hashes": [{"alg": "SHA-256", "content": digest}]}
    if not platform:
        return file
    targets = TARGETS[platform][0]
    _, system, *abi = targets[0].split("-")
    version = ".".join((abi[0] if abi else system).split(".")[1:])
    libc = f"{_LIBC[system.split('.')[0]]} {version}".rstrip()
    properties = {"platform": platform, "target": " ".join(targets), "libc": libc}
    return file | {
        "properties": [{"name": f"l1-depth:{name}", "value": value} for name, value in properties.items()]
    }


def recipe_of(bill: bytes) -> str:
    """Returns the recipe that a bill of `bill_of_materials` states, or ""."""
    properties = json.loads(bill).get("metadata", {}).get("properties", [])
    return next((p["value"] for p in properties if p["name"] == _RECIPE_NAME), "")

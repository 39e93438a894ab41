"""What every .fmu holds besides its model: a GUID that follows from the content, and licences."""

import hashlib
import re
import uuid
from importlib.metadata import distributions

from fmus.errors import ExportError
from fmus.native.toolchain import COMPILER, FMI_HEADERS

# They stand for the GUID, and for a part of it in Python names, until it is known.
GUID, GUID_IN_NAMES = "GUID-of-this-FMU", "GUID_of_this_FMU"

# name -> (installed project, file of its metadata, what the licence is for)
_LICENSES = {
    "l1-depth": (
        "l1-depth",
        "LICENSE",
        "what makes an FMU of the model and its documentation, and models that come with l1-depth",
    ),
    "fmi-headers": ("fmpy", "", "headers that the libraries are compiled with, of the Modelica Association"),
    "zig": (COMPILER[0], "ziglang/LICENSE", "what its compiler adds to the libraries"),
    "mingw-w64": (COMPILER[0], "ziglang/lib/libc/mingw/COPYING", "what it adds to the library for Windows"),
    "pythonfmu": ("pythonfmu", "LICENSE", "the libraries, and the package of that name in resources"),
}


def with_guid(members: dict[str, bytes], recipe: str = "") -> tuple[str, dict[str, bytes]]:
    """A GUID that follows from members and recipe, and the members with it in names and contents."""
    digest = hashlib.sha256(recipe.encode())
    for name, data in sorted(members.items()):
        digest.update(hashlib.sha256(name.encode()).digest() + hashlib.sha256(data).digest())
    guid = str(uuid.uuid5(uuid.NAMESPACE_OID, digest.hexdigest()))
    for placeholder, text in ((GUID, guid), (GUID_IN_NAMES, guid.replace("-", "")[:16])):
        members = {
            name.replace(placeholder, text): data.replace(placeholder.encode(), text.encode())
            for name, data in members.items()
        }
    return guid, members


def licenses(*names: str) -> dict[str, bytes]:
    """Path inside the FMU -> licence, and the file that FMI 2.0 wants before them: what each is for."""
    entry_point = "".join(f"{name}.txt: {_LICENSES[name][2]}\n" for name in names)
    texts = {"license": entry_point} | {name: _license(*_LICENSES[name][:2]) for name in names}
    return {f"documentation/licenses/{name}.txt": text.encode() for name, text in texts.items()}


def _license(project: str, file: str) -> str:
    if file:  # a clone's own .egg-info, found first where it is the working directory, has no licence
        texts = (distribution.read_text(f"licenses/{file}") for distribution in distributions(name=project))
        text = next(filter(None, texts), "")
        if not text:
            raise ExportError(
                f"the installed {project} has no {file} among its licences, which an FMU must carry: "
                f"expected it as pip installs it (pip install --force-reinstall {project})"
            )
        return text
    header = (FMI_HEADERS / "fmi2Functions.h").read_text("utf-8")
    return "".join(re.findall(r"Copyright.*?(?=\*/)", header, re.DOTALL)[:1])

"""What every .fmu holds besides its model: a GUID that follows from the content, and licences."""

import hashlib
import uuid
from importlib.metadata import distribution
from pathlib import Path

NO_GUID = str(uuid.UUID(int=0))  # stands for the GUID while it is being derived
_LICENSES = "documentation/licenses/"
_COVERED = {
    "l1-depth": "the FMU: its model, its documentation and what makes an FMU of the model",
    "fmi-headers": "sources/fmi2*.h, of the Modelica Association",
    "zig": "what its compiler adds to the libraries",
    "mingw-w64": "what it adds to the library for Windows",
    "pythonfmu": "the libraries, and the package of that name in resources",
}


def guid_of(members: dict[str, bytes]) -> str:
    """A GUID that follows from the content: equal members have the same, others another one."""
    digest = hashlib.sha256()
    for name, data in sorted(members.items()):
        digest.update(hashlib.sha256(name.encode()).digest() + hashlib.sha256(data).digest())
    return str(uuid.uuid5(uuid.NAMESPACE_OID, digest.hexdigest()))


def licenses(*projects: str) -> dict[str, bytes]:
    """Path inside the FMU -> licence of each of these installed projects."""
    found = {}
    for project in projects:
        for file in distribution(project).files or ():
            if file.name == "LICENSE":
                found[f"{_LICENSES}{project}.txt"] = Path(str(file.locate())).read_bytes()
    return found


def with_entry_point(found: dict[str, bytes]) -> dict[str, bytes]:
    """These licences and the file that FMI 2.0 wants before them: what each of them is for."""
    names = [path.removeprefix(_LICENSES).removesuffix(".txt") for path in found]
    lines = "".join(f"{name}.txt: {_COVERED[name]}\n" for name in names)
    return found | {f"{_LICENSES}license.txt": lines.encode()}

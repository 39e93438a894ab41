"""FMUs as their members, and the rules that they break."""

import zipfile
from pathlib import Path

from fmus.compliance.examine import examine

Members = dict[str, bytes]
PYTHONFMU_ERRORS = {  # its binary looks at no GUID, and fmi2FreeFMUstate leaves the address
    "refuses-a-wrong-guid": ("fmi2Instantiate gave an instance for a wrong GUID: expected NULL",),
    "state-restores": ("fmi2FreeFMUstate left the state's address: expected NULL",),
}


def members(path: Path) -> Members:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def write(content: Members, path: Path) -> Path:
    """An archive as it is told to be, also with members that no tool should write."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            archive.writestr(name, data)
    return path


def broken_rules(path: Path, timeout: float = 100) -> dict[str, tuple[str, ...]]:
    """Rule -> its messages, of the rules that the FMU breaks."""
    return {r.rule.name: r.messages for r in examine(path, timeout) if r.messages}

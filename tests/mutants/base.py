"""Legal FMUs of sources that use most of what a model description can hold, and changed copies of them."""

import zipfile
from collections.abc import Mapping
from pathlib import Path

Members = dict[str, bytes]
XML = "modelDescription.xml"
_DESCRIPTION = (Path(__file__).parent / "base.xml").read_text(encoding="utf-8")
_MODEL_EXCHANGE = _DESCRIPTION[_DESCRIPTION.index("  <ModelExchange") : _DESCRIPTION.index("  <CoSimulation")]
_SOURCE = b'#define FMI2_FUNCTION_PREFIX Base_\n#include "fmi2Functions.h"\n'
BASE: Members = {XML: _DESCRIPTION.encode(), "sources/base.c": _SOURCE, "sources/exchange.c": _SOURCE}
_BUILD = """<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0"><BuildConfiguration modelIdentifier="Fmi3"><SourceFileSet>
<SourceFile name="fmi3.c"/></SourceFileSet></BuildConfiguration></fmiBuildDescription>
"""
BASE_3: Members = {
    XML: (Path(__file__).parent / "fmi3.xml").read_bytes(),
    "sources/fmi3.c": b"",
    "sources/buildDescription.xml": _BUILD.encode(),
}


def replaced(text: str, old: str, new: str) -> str:
    """The text with its one occurrence of `old` as `new`."""
    if text.count(old) != 1:
        raise ValueError(f"{old!r} occurs {text.count(old)} times: expected once")
    return text.replace(old, new)


def changed(*replacements: tuple[str, str], base: Members = BASE) -> Members:
    """A base with replacements in its model description, one after the other."""
    text = base[XML].decode()
    for old, new in replacements:
        text = replaced(text, old, new)
    return base | {XML: text.encode()}


# what makes the base an FMU for co-simulation alone
CO_SIMULATION_ONLY = (
    (_MODEL_EXCHANGE, ""),
    (' canHandleMultipleSetPerTimeInstant="true"', ""),
    (' reinit="true"', ""),
)


def written(members: Mapping[str, bytes], folder: Path, name: str = "Base.fmu") -> Path:
    """An archive of these members, in their order."""
    with zipfile.ZipFile(folder / name, "w", zipfile.ZIP_DEFLATED) as archive:
        for path, data in members.items():
            archive.writestr(path, data)
    return folder / name

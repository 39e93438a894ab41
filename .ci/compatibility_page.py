"""Page reference/compatibility.md: which importer runs which FMUs, and what runs in Windows, by tests."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fmus.registry import block_names
from orchestration.cli.explain import markdown_table

_TESTS = Path(__file__).parent.parent / "tests"
DATA = _TESTS / "importers" / "interfaces.toml"
WINDOWS = _TESTS / "windows" / "runs.toml"
INTERFACES = ("CS 2.0", "ME 2.0", "CS 3.0", "ME 3.0", "CS 2.0, python")
_HEAD = """\
# Importers and interfaces

Every native FMU has co-simulation (CS) and model exchange (ME), of FMI 2.0 or, with `l1-depth build --fmi 3`,
of FMI 3.0. FMUs of [the python flavour](../how-to/importing/README.md#the-python-flavour) have co-simulation
of FMI 2.0."""
_WORDS = """\
- *run*: by the test below, in this project's CI. *`--scalars`*: built with this option.
- *by hand*: once, as stated below; no test repeats it.
- *no*: the importer has no such interface, or cannot load these FMUs. *not run*: nobody tried it.
- *listed*: by [fmi-standard.org](https://fmi-standard.org/tools/) in June 2026, and not run.
- CasADi, Ecos and OMSimulator do not support arrays (FMI 3.0.2, 2.2.7.1).
- OMSimulator takes value references in `dependencies` and `derivative` (2.4.7, 2.4.8) for places of
  variables, from 1. In these FMUs both are equal. With references from 0 it refused 13 of the 15.
- libcosim has an open request for [FMI 3.0](https://github.com/open-simulation-platform/libcosim/issues/741)."""
_AGREEMENT = """\
## How well they agree

The depth in `nominal-extended` and `nominal-l1`, beside that of this master. `python -m tests.importers`
measures it again for the importers that are installed."""
_DID_NOT_RUN = """\
fmi4c stepped `RovDepthPlant`: its depth was this master's to the last bit. PyFMI 2.5, OMSimulator 3.0.0,
FMI++, CoFMPy 1.0.0, energysim 2.1.9.1, syssimx 0.4.3 and PyCosimLibrary 0.0.5 did not run the two
FMUs of the loop (November 2026)."""
_SYSTEMS = """\
## Operating systems

Everything runs on 64-bit Linux. CPython 3.11 for Windows ran under Debian's Wine 8 as below (November 2026,
`tests/windows/test_windows.py`), not on Windows itself, whose C library is another. macOS: not run.

In PowerShell, `;` stands for `&&`, `.venv\\Scripts\\activate` for `source .venv/bin/activate`, `$null` for
`/dev/null`, and `Select-String` for `grep -E`. The text between `<<'END'` and `END` goes into the file named
before it."""
_RUNS = "## What was run\n\nVersions of November 2026. `Drift` is a block of the test."

Table = Mapping[str, Mapping[str, Any]]


def table() -> Table:
    """Importer -> what it does with each interface, and the names of its page and distribution."""
    return tomllib.loads(DATA.read_text(encoding="utf-8"))


def windows() -> list[dict[str, str]]:
    """What ran on a Python for Windows, what was seen, and the test."""
    ran = tomllib.loads(WINDOWS.read_text(encoding="utf-8"))
    passed = f"{ran['passed']:,}"
    return [run | {"seen": run["seen"].replace("PASSED", passed)} for run in ran["runs"]]


def page() -> str:
    """The page with its line end."""
    tools = table()
    matrix = [(_linked(name, tool), *(_word(tool[i]) for i in INTERFACES)) for name, tool in tools.items()]
    runs = [
        (name, interface, _names(run["fmus"]), _how(tool, run))
        for name, tool in tools.items()
        for interface in INTERFACES
        if isinstance(run := tool[interface], dict)
    ]
    heads = ("Importer", "Interface", "FMUs", "How")
    agreement = [tool["agreement"] for tool in tools.values() if "agreement" in tool]
    agreed = ("Importer", "Exchanges", "Times", "Depth differs by at most")
    parts = [
        _HEAD,
        markdown_table(("Importer", *INTERFACES), matrix),
        _WORDS,
        _RUNS,
        markdown_table(heads, runs),
    ]
    parts += [_DID_NOT_RUN, _AGREEMENT, markdown_table(agreed, agreement)]
    under_wine = [(run["what"], run["seen"], f"`{run['test']}`") for run in windows()]
    parts += [_SYSTEMS, markdown_table(("Under Wine", "Seen", "Test"), under_wine)]
    return "\n\n".join(parts) + "\n"


def _linked(name: str, tool: Mapping[str, Any]) -> str:
    return f"[{name}](../how-to/importing/{tool['page']})" if "page" in tool else name


def _word(entry: Any) -> str:
    """What the matrix has of an interface."""
    if isinstance(entry, str):
        return entry
    return ", ".join(["by hand" if "by_hand" in entry else "run", *filter(None, [entry.get("limit")])])


def _names(fmus: Any) -> str:
    if isinstance(fmus, int):
        return f"{fmus} of {len(block_names())}"
    return f"all {len(block_names())}" if fmus == "all" else ", ".join(f"`{name}`" for name in fmus)


def _how(tool: Mapping[str, Any], run: Mapping[str, Any]) -> str:
    if "by_hand" in run:
        return f"by hand: {run['by_hand']}"
    test = run["test"].replace("::", "`<br>`")
    return f"{tool['distribution']} {tool['version']}: `{test}`"

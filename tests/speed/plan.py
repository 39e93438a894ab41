"""A checked system and its experiment as a plan for programs that are not Python: c/host.c and c/monolith.c.

The host only passes numbers on: every number that it gives to an FMU stands in the plan or its table,
written so that it is read back exactly.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from fmus.fmi.variable_types import TRANSFER_TYPE
from orchestration.exchange.limits import check_plain_exchange
from orchestration.system.prepared_run import PreparedRun
from orchestration.system.system import Port
from tests.speed.programs import extracted


def write_plan(prepared: PreparedRun, folder: Path, platform: str) -> Path:
    """Extract the FMUs to a folder, and write there the plan, its table, and plan.h for c/monolith.c.

    Returns the plan. All is of type Real, but what is set. Raises ScenarioError for more than
    `check_plain_exchange` allows.
    """
    check_plain_exchange(prepared.experiment, "a plan")
    folder = folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    plan, table = folder / "plan.txt", folder / "table.bin"
    rows = np.column_stack([prepared.points, *prepared.signal_values])
    rows.tofile(table)
    lines = [*_statements(prepared, folder, platform), f"table {len(rows)} {table}"]
    plan.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8", newline="\n")
    macros = _macros([line.split(maxsplit=4) for line in lines], len(prepared.system.components), len(rows))
    header = "".join(f"#define {name} {value}\n" for name, value in macros.items())
    (folder / "plan.h").write_text(header, encoding="utf-8")
    return plan


def _statements(prepared: PreparedRun, folder: Path, platform: str) -> Iterator[str]:
    components, ports = list(prepared.system.components), prepared.system.ports

    def address(port: Port) -> str:
        return f"{components.index(port.component)} {port.variable.valueReference}"

    for name, path in prepared.system.components.items():
        guid, library = extracted(path, folder / name, platform)
        yield f"component {name} {guid} {library}"
    for port, value in prepared.settings:
        kind = TRANSFER_TYPE[port.variable.type].lower()
        number = repr(float(value)) if kind == "real" else int(value)  # the shortest that is read back
        component, reference = address(port).split()
        yield f"set {component} {kind} {reference} {number}"
    yield from (f"connect {address(a)} {address(b)}" for a, b in prepared.system.connections)
    yield from (f"signal {address(ports[name])}" for name in prepared.experiment.signals)
    yield from (f"record {address(ports[name])}" for name in prepared.recorded)


def _macros(statements: list[list[str]], count: int, rows: int) -> dict[str, object]:
    """What c/monolith.c takes from a plan."""

    def numbered(verb: str) -> Iterable[tuple[int, list[str]]]:
        return enumerate(words for first, *words in statements if first == verb)

    components = range(count)
    return {
        "COMPONENTS(X)": " ".join(f"X({i})" for i in components),
        "N_COMPONENTS": count,
        "ROWS": rows,
        "COLUMNS": len(list(numbered("signal"))) + 1,
        "RECORDS": len(list(numbered("record"))),
        "POINTERS": ", ".join(f"double *v{i}" for i in components),
        "ARGUMENTS": ", ".join(f"v{i}" for i in components),
        "SETTINGS": " ".join(f"v{a}[{r}] = {value};" for _, (a, _, r, value) in numbered("set")),
        "SIGNALS": " ".join(f"v{a}[{r}] = row[{i + 1}];" for i, (a, r) in numbered("signal")),
        "RECORDINGS": " ".join(f"result[i][{i}] = v{a}[{r}];" for i, (a, r) in numbered("record")),
        "LINKS": " ".join(f"v{b}[{s}] = v{a}[{r}];" for _, (a, r, b, s) in numbered("connect")),
    }


def read_result(result: Path, plan: Path) -> np.ndarray:
    """What the host recorded: a row for each communication point, a column for each record of the plan."""
    columns = sum(line.startswith("record ") for line in plan.read_text(encoding="utf-8").splitlines())
    return np.fromfile(result).reshape(-1, columns)

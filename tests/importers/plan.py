"""A checked system and its experiment as a plan for a program that is not Python: c/host.c.

The host only passes numbers on: every number that it gives to an FMU stands in the plan or its table,
written so that it is read back exactly.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fmpy
import numpy as np

from fmus.fmi.description import describe
from fmus.fmi.variable_types import TRANSFER_TYPE
from fmus.platforms import library_name
from orchestration.exchange.limits import check_plain_exchange
from orchestration.system.prepared_run import PreparedRun
from orchestration.system.system import Port

HOST = Path("tests/importers/c/host.c")


def write_plan(prepared: PreparedRun, folder: Path, platform: str) -> Path:
    """Extracts the FMUs to a folder, and writes there the plan and its table.

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
    return plan


def _statements(prepared: PreparedRun, folder: Path, platform: str) -> Iterator[str]:
    components, ports = list(prepared.system.components), prepared.system.ports

    def address(port: Port) -> str:
        return f"{components.index(port.component)} {port.variable.valueReference}"

    for name, path in prepared.system.components.items():
        description: Any = describe(path)
        fmpy.extract(str(path), str(folder / name))
        library = folder / name / library_name(description.coSimulation.modelIdentifier, platform)
        yield f"component {name} {description.guid} {library}"
    for port, value in prepared.settings:
        kind = TRANSFER_TYPE[port.variable.type].lower()
        number = repr(float(value)) if kind == "real" else int(value)  # the shortest that is read back
        component, reference = address(port).split()
        yield f"set {component} {kind} {reference} {number}"
    yield from (f"connect {address(a)} {address(b)}" for a, b in prepared.system.connections)
    yield from (f"signal {address(ports[name])}" for name in prepared.experiment.signals)
    yield from (f"record {address(ports[name])}" for name in prepared.recorded)


def read_result(result: Path, plan: Path) -> np.ndarray:
    """What the host recorded: a row for each communication point, a column for each record of the plan."""
    columns = sum(line.startswith("record ") for line in plan.read_text(encoding="utf-8").splitlines())
    return np.fromfile(result).reshape(-1, columns)

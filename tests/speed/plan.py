"""A checked system and its experiment as a plan for the host that is not Python (c/host.c).

The host only passes numbers on: every number that it gives to an FMU stands in the plan or its table,
written so that it is read back exactly.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fmpy
import numpy as np

from fmus.fmi_types import NUMBERS, TRANSFER_TYPE
from fmus.platforms import library_name
from orchestration.errors import OrchestrationError
from orchestration.exchange.limits import check_plain_exchange, check_types
from orchestration.system.prepared_run import PreparedRun
from orchestration.system.system import CheckedSystem, Port

_TARGET = "a plan"


def write_plan(prepared: PreparedRun, folder: Path, platform: str) -> Path:
    """Extract the FMUs to a folder and write the plan and its table there.

    Returns the plan. Raises ScenarioError for more than `check_plain_exchange` allows, and for connections,
    signals and records of another type than Real.
    """
    checked, experiment = prepared.system, prepared.experiment
    check_plain_exchange(experiment, _TARGET)
    recorded = _recorded(prepared)
    driven = [checked.ports[name] for name in experiment.signals]
    connected = [port for pair in checked.connections for port in pair]
    check_types([*connected, *driven, *recorded], ("Real",), _TARGET)
    check_types([port for port, _ in prepared.settings], NUMBERS, _TARGET)
    folder.mkdir(parents=True, exist_ok=True)
    folder = folder.absolute()
    plan, table = folder / "plan.txt", folder / "table.bin"
    rows = _table(prepared)
    rows.tofile(table)
    statements = [
        *_components(checked, folder, platform),
        *_settings(prepared),
        *(f"connect {_address(checked, a)} {_address(checked, b)}" for a, b in checked.connections),
        *(f"signal {_address(checked, port)}" for port in driven),
        *(f"record {_address(checked, port)}" for port in recorded),
        f"table {len(rows)} {table}",
    ]
    plan.write_text("".join(f"{line}\n" for line in statements), encoding="utf-8", newline="\n")
    return plan


def read_result(result: Path, plan: Path) -> np.ndarray:
    """What the host recorded: a row for each communication point, a column for each record of the plan."""
    columns = sum(line.startswith("record ") for line in plan.read_text(encoding="utf-8").splitlines())
    return np.fromfile(result).reshape(-1, columns)


def _table(prepared: PreparedRun) -> np.ndarray:
    """The communication points and the signals at each, as the master takes them."""
    return np.column_stack([prepared.points, *prepared.signal_values])


def _components(checked: CheckedSystem, folder: Path, platform: str) -> Iterator[str]:
    for name, path in checked.components.items():
        description: Any = checked.descriptions[name]
        extracted = folder / name
        fmpy.extract(str(path), extracted)
        library = extracted / library_name(description.coSimulation.modelIdentifier, platform)
        if not library.is_file():
            raise OrchestrationError(
                f"{path} has no binary for {platform}; `l1-depth build --cache` writes it"
            )
        yield f"component {name} {description.guid} {library}"


def _settings(prepared: PreparedRun) -> Iterator[str]:
    """Parameters, then constant inputs; the shortest decimal of a double is read back exactly."""
    for port, value in prepared.settings:
        kind = TRANSFER_TYPE[port.variable.type].lower()
        number = repr(float(value)) if kind == "real" else int(value)
        component, reference = _address(prepared.system, port).split()
        yield f"set {component} {kind} {reference} {number}"


def _recorded(prepared: PreparedRun) -> list[Port]:
    ports = [prepared.system.ports[name] for name in prepared.recorded]
    for port in ports:
        if port.name not in prepared.experiment.signals and port.variable.causality != "output":
            raise OrchestrationError(f"record {port.name} in a plan: expected an output or a signal")
    return ports


def _address(checked: CheckedSystem, port: Port) -> str:
    return f"{list(checked.components).index(port.component)} {port.variable.valueReference}"

"""A sweep's table as a page shows it."""

import shlex
from pathlib import Path

import numpy as np

from fmus.extras import imports_of
from orchestration.errors import OrchestrationError
from orchestration.report.result import SweepResult
from orchestration.scenarios import scenario

with imports_of("report", "a report"):
    import pyarrow as pa

    from orchestration.sweep import table  # which needs no more of the extra sweep

_SHOWN_ELSEWHERE = {"name", "title", "scenario", "varied"}


def read(file: Path) -> SweepResult:
    """The sweep that a file holds, named after the file; OrchestrationError if it has no sample."""
    rows, provenance = table.read(file)
    if not rows.num_rows:
        raise OrchestrationError(f"{file}: expected at least one sample, got none")
    varied, metrics = table.names(rows.schema, "varied"), table.names(rows.schema, "metric")
    return SweepResult(
        name=file.stem,
        samples=rows[table.SAMPLE].to_numpy(),
        varied={name: _values(rows[name]) for name in varied},
        metrics={name: rows[name].to_numpy().astype(float) for name in metrics},
        errors=tuple(error or "" for error in rows[table.ERROR].to_pylist()),
        units={name: rows.schema.field(name).metadata[b"unit"].decode() for name in [*varied, *metrics]},
        scenario=provenance["scenario"],
        provenance={key: value for key, value in provenance.items() if key not in _SHOWN_ELSEWHERE},
        command=f"l1-depth sweep {_scenario_argument(provenance['name'])} --sample {{sample}}",
    )


def _scenario_argument(name: str) -> str:
    """What the command line calls a scenario: a shipped one by name, another by its file."""
    return shlex.quote(name if name in scenario.shipped() else f"{name}.toml")


def _values(column: pa.ChunkedArray) -> np.ndarray:
    """Numbers as they are, truth values and names as text."""
    if pa.types.is_floating(column.type) or pa.types.is_integer(column.type):
        return column.to_numpy()
    return np.array([str(value) for value in column.to_pylist()])

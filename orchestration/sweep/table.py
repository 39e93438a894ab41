"""The result of a sweep as one tidy table: a row a sample.

columns: `sample` (its number), varied values (named "component.variable"), the metrics, `warned` (null, or
         the components whose FMUs returned warnings), `error` (null, or why the sample failed: its metrics
         are then null). A metric that is not a number did not happen
column metadata: `role` is sample, varied, metric, warned or error; `unit` is "" for a column without one
table metadata: `l1_depth.kind` is sweep; `l1_depth.provenance` is JSON with the resolved scenario, the
         arguments of the command, the FMUs with their GUIDs, the seed, the number of samples, the varied
         values and the recorded signals
"""

import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fmus.extras import imports_of
from fmus.files import open_atomically
from orchestration.errors import SweepError
from orchestration.results.metric_units import metric_units, shown
from orchestration.sweep.plan import Plan

with imports_of("sweep", "a sweep"):
    import pyarrow as pa
    import pyarrow.parquet as pq
    from pyarrow.json import ParseOptions, ReadOptions, read_json

if TYPE_CHECKING:
    from rich.table import Table

SAMPLE, WARNED, ERROR = "sample", "warned", "error"
ROWS_OF_A_GROUP = 10_000
_KIND, _PROVENANCE, _SWEEP = b"l1_depth.kind", b"l1_depth.provenance", b"sweep"
_TYPES = {"Real": pa.float64(), "Integer": pa.int64(), "Boolean": pa.bool_(), "String": pa.string()}


def schema(plan: Plan, recorded: tuple[str, ...] | None) -> pa.Schema:
    """Returns the columns with role and unit, and what is run: sweeps with the same have the same rows.

    recorded: names of the signals of each sample; empty for all, None for no recordings
    """
    signal_units = {name: port.variable.unit or "" for name, port in plan.checked.ports.items()}
    columns = [
        (SAMPLE, pa.int64(), SAMPLE, ""),
        *(
            (entry.target.name, _TYPES[entry.target.type], "varied", entry.target.unit)
            for entry in plan.varied
        ),
        *(
            (name, pa.float64(), "metric", unit)
            for name, unit in metric_units(plan.scenario.metrics, signal_units).items()
        ),
        (WARNED, pa.string(), WARNED, ""),
        (ERROR, pa.string(), ERROR, ""),
    ]
    return pa.schema(
        [pa.field(name, kind, metadata={"role": role, "unit": unit}) for name, kind, role, unit in columns],
        {_KIND: _SWEEP, _PROVENANCE: json.dumps(_provenance(plan, recorded))},
    )


def _provenance(plan: Plan, recorded: tuple[str, ...] | None) -> dict[str, Any]:
    fmus = {
        name: {
            "guid": description.guid,
            "model": description.modelName,
            "tool": description.generationTool,
            "sha256": hashlib.sha256(plan.checked.components[name].read_bytes()).hexdigest(),
        }
        for name, description in plan.checked.descriptions.items()
    }
    return {
        "name": plan.scenario.name,
        "title": plan.scenario.title,
        "arguments": plan.scenario.arguments,
        "scenario": plan.scenario.resolved,
        "fmus": fmus,
        "seed": plan.seed,
        "samples": plan.count,
        "varied": [entry.target.name for entry in plan.varied],
        "recorded": recorded,
    }


def provenance_of(columns: pa.Schema) -> dict[str, Any]:
    """Returns what is run, as plain data."""
    return json.loads(columns.metadata[_PROVENANCE])


def write(rows: Iterable[bytes], columns: pa.Schema, path: Path) -> None:
    """Writes rows of JSON in the order given, some in memory at a time; equal rows give equal bytes.

    Raises ArrowInvalid for a value that is not of the type of its column.
    """
    remaining = iter(rows)
    options = ParseOptions(explicit_schema=columns, unexpected_field_behavior="ignore")
    with open_atomically(path) as stream, pq.ParquetWriter(stream, columns) as writer:
        while group := list(islice(remaining, ROWS_OF_A_GROUP)):
            # not by `pa.array`, which imports pandas if it is installed: as long as hundreds of samples take
            lines = b"\n".join(group)
            block = ReadOptions(use_threads=False, block_size=len(lines) + 1)
            read = read_json(pa.BufferReader(lines), block, options)
            writer.write_table(pa.Table.from_arrays(read.columns, schema=columns))


def is_sweep(path: Path) -> bool:
    """Whether a file is the table of a sweep."""
    try:
        return (pq.read_schema(path).metadata or {}).get(_KIND) == _SWEEP
    except (OSError, pa.ArrowInvalid):
        return False


def read(path: Path) -> tuple[pa.Table, dict[str, Any]]:
    """Returns (the table, its provenance); SweepError for a file that is no table of a sweep."""
    if not is_sweep(path):
        raise SweepError(f"{path}: expected the table of a sweep, as l1-depth sweep writes it")
    # `pq.read_table` imports pandas
    with pq.ParquetFile(path) as file:
        table = file.read()
    return table, provenance_of(table.schema)


def names(columns: pa.Schema, role: str) -> list[str]:
    """Returns the names of the columns with that role."""
    return [field.name for field in columns if (field.metadata or {}).get(b"role") == role.encode()]


def unit(columns: pa.Schema, name: str) -> str:
    """Returns the unit of a column, or "" if it has none."""
    return columns.field(name).metadata[b"unit"].decode()


_PERCENT = {"least": 0, "5 %": 5, "50 %": 50, "95 %": 95, "largest": 100}
HEADINGS = ("samples", "mean", "std", *_PERCENT)
_MOST_ACROSS = 10  # columns of a grid that a terminal shows
_PRINTED = ("samples", "mean", "std", "5 %", "50 %", "95 %")


def statistics(values: np.ndarray) -> dict[str, float]:
    """Returns the number of numbers, their mean, std (n - 1) and percentiles, by HEADINGS; {} of none."""
    numbers = values[np.isfinite(values)]
    if not len(numbers):
        return {}
    spread = numbers.std(ddof=1) if len(numbers) > 1 else 0.0
    percentiles = np.percentile(numbers, list(_PERCENT.values()))
    return dict(zip(HEADINGS, (len(numbers), numbers.mean(), spread, *percentiles), strict=True))


def groups(varied: Mapping[str, Sequence[Any]], samples: Iterable[int]) -> dict[tuple[str, ...], np.ndarray]:
    """Returns the combinations of varied values that are not numbers -> the samples that have each.

    varied: name -> a value a sample. All samples are under () if only numbers are varied.
    """
    categories = categorical(varied)
    members: dict[tuple[str, ...], list[int]] = {}
    for i in samples:
        members.setdefault(tuple(str(varied[name][i]) for name in categories), []).append(i)
    return {values: np.array(indices) for values, indices in members.items()}


def categorical(varied: Mapping[str, Sequence[Any]]) -> list[str]:
    """Returns the names of what is varied and no number."""
    return [
        name for name, values in varied.items() if any(isinstance(v, (str, bool, np.bool_)) for v in values)
    ]


def grid(varied: Mapping[str, Sequence[Any]]) -> tuple[str, str] | None:
    """Returns the two variables of a grid, in which each group has each pair of values once.

    varied: name -> a value for each sample. Returns None for any other sweep.
    """
    categories = categorical(varied)
    numbers = [name for name in varied if name not in categories]
    if len(numbers) != 2:
        return None
    first, second = (varied[name] for name in numbers)
    pairs = len({*first}) * len({*second})
    cells = {*zip(first, second, *(varied[name] for name in categories), strict=True)}
    is_grid = min(len({*first}), len({*second})) > 1 and len(cells) == len(first)
    return (numbers[0], numbers[1]) if is_grid and len(cells) % pairs == 0 else None


def failed(results: pa.Table) -> int:
    """Returns the number of samples with an error."""
    return len(results) - results[ERROR].null_count


def terminal_tables(results: pa.Table, provenance: dict[str, Any]) -> list["Table"]:
    """Returns each metric over a grid of two numbers, else the summary: a grid is no sample of anything."""
    return [*grid_tables(results, provenance)] or [summary_table(results, provenance)]


def summary_table(results: pa.Table, provenance: dict[str, Any]) -> "Table":
    """Returns the summary as a table for a terminal."""
    from rich.markup import escape
    from rich.table import Table  # of the command alone: a worker does without it

    printed = Table()
    varied_names = names(results.schema, "varied")
    is_text = {name: not pa.types.is_floating(results[name].type) for name in varied_names}
    varied = {name: results[name].to_pylist() for name in varied_names if is_text[name]}
    for heading in (*categorical(varied), "Metric", "Unit"):
        printed.add_column(escape(heading), no_wrap=heading == "Metric")
    for heading in _PRINTED:
        printed.add_column(heading.capitalize(), justify="right")
    good = np.flatnonzero(results[ERROR].is_null().to_pylist())
    metrics = {  # `to_numpy` imports pandas
        name: np.array(results[name].to_pylist(), float) for name in provenance["scenario"]["metrics"]
    }
    for values, indices in groups(varied, good).items():
        printed.add_section()
        for name, call in provenance["scenario"]["metrics"].items():
            numbers = statistics(metrics[name][indices])
            cells = [f"{numbers[heading]:.4g}" for heading in _PRINTED if numbers] or [
                "0",
                shown(math.nan, call),
            ]
            printed.add_row(*map(escape, (*values, name, unit(results.schema, name))), *cells)
    return printed


def grid_tables(results: pa.Table, provenance: dict[str, Any]) -> Iterator["Table"]:
    """Yields, for a sweep over a grid of two numbers alone, each metric as a table for a terminal.

    The variable with fewer values is across. A grid that is wider than a page has no tables.
    """
    from rich.markup import escape
    from rich.table import Table

    varied = {name: results[name].to_pylist() for name in names(results.schema, "varied")}
    if len(varied) != 2 or not grid(varied):
        return
    across, down = sorted(varied, key=lambda name: len({*varied[name]}))
    values = {name: sorted({*varied[name]}) for name in varied}
    if len(values[across]) > _MOST_ACROSS:
        return
    labels = {name: f"{name} [{unit(results.schema, name) or '1'}]" for name in varied}
    for name, call in provenance["scenario"]["metrics"].items():
        numbers = [math.nan if value is None else value for value in results[name].to_pylist()]
        cells = dict(zip(zip(varied[down], varied[across], strict=True), numbers, strict=True))
        title = f"{name} [{unit(results.schema, name) or '1'}], across: {labels[across]}"
        printed = Table(escape(labels[down]), title=escape(title))
        for value in values[across]:
            printed.add_column(f"{value:.4g}", justify="right")
        for row in values[down]:
            numbers = [cells[row, column] for column in values[across]]
            texts = [f"{number:.4g}" if math.isfinite(number) else shown(number, call) for number in numbers]
            printed.add_row(f"{row:.4g}", *map(escape, texts))
        yield printed

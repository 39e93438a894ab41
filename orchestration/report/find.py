"""The results at the paths of a user, each with a name that no other has."""

import hashlib
import json
import math
from collections import Counter
from collections.abc import Collection, Iterable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from fmus.errors import nearest
from orchestration.errors import OrchestrationError, ScenarioError
from orchestration.report.result import RunResult, SweepResult, read_sweep, toml
from orchestration.results.files import is_recording
from orchestration.results.formats import RecordingFormat
from orchestration.results.recording import Recording
from orchestration.scenarios.data_file import read_data_file
from orchestration.scenarios.file_tables import Table, checked
from orchestration.sweep import table

# The ending of the most complete file comes first: of copies of a result, it is read.
_ENDINGS = (".json", *(f".{ending}" for ending in reversed(RecordingFormat)))


class _MetricValue(Table):
    value: float | None  # None for an event that did not happen, such as settling
    unit: str


class _Document(Table, extra="allow"):
    """The .json of a run."""

    recording: str
    sha256: str = ""  # of the file with the recording; a document without it fits no recording
    scenario: dict[str, Any]
    run: dict[str, Any]
    metrics: dict[str, _MetricValue]


_DOCUMENT = TypeAdapter(_Document)


def found_results(paths: Iterable[Path]) -> list[RunResult | SweepResult]:
    """Returns the results in files and folders, each once, in the order given; a folder's results are sorted.

    Raises OrchestrationError for a path that does not exist or has no result.
    """
    files = dict.fromkeys(file for path in paths for file in _files(path))
    measured = [file for file in files if file.suffix == ".csv" and not is_recording(file)]
    read = {file: _read(file) for file in files if file not in measured}
    units = {
        unit for result in read.values() if isinstance(result, RunResult) for unit in result.recording.units
    }
    read |= {file: _measured(file, units) for file in measured}
    results = _without_copies({file: read[file] for file in files})
    names = _names(list(results))
    return [replace(result, name=names[file]) for file, result in results.items()]


def _files(path: Path) -> list[Path]:
    """Returns one file for each result at a path; for a run its .json, if there is one."""
    if path.is_dir():
        return _of_folder(path.resolve())
    if not path.is_file():
        neighbours = path.parent.iterdir() if path.parent.is_dir() else []
        known = [file.name for file in neighbours if file.is_dir() or file.suffix in _ENDINGS]
        raise OrchestrationError(f"no file or folder {path}; beside it, {nearest(path.name, known)}")
    if path.suffix not in _ENDINGS:
        raise OrchestrationError(
            f"{path}: expected a result: a .json, .csv or .parquet file as l1-depth writes them, or a folder"
        )
    file = path.resolve()
    document = file.with_suffix(".json")
    return [document] if _recording_of(document) == file else [file]


def _of_folder(folder: Path) -> list[Path]:
    files = sorted(file for file in folder.iterdir() if file.suffix in _ENDINGS)
    runs = {file: recording for file in files if (recording := _recording_of(file))}
    others = [file for file in files if file.suffix != ".json" and file not in runs.values()]
    alone = [file for file in others if is_recording(file) or table.is_sweep(file)]
    results = sorted([*runs, *alone])
    if not results:
        raise OrchestrationError(
            f"{folder}: no result in this folder: expected files of l1-depth run, reproduce or sweep"
        )
    return results


def _recording_of(document: Path) -> Path | None:
    """Returns the file with the recording of a run's .json; None for any other file."""
    if document.suffix == ".json":
        try:
            content = json.loads(document.read_text(encoding="utf-8"))
        except OSError:
            return None
        except ValueError as error:
            expected = "expected the .json that l1-depth run writes; without it, its recording stands alone"
            raise OrchestrationError(f"{document}: {error}: {expected}") from error
        if isinstance(content, dict) and content.keys() >= _Document.model_fields.keys() - {"sha256"}:
            return document.with_name(str(content["recording"]))
    return None


def _read(file: Path) -> RunResult | SweepResult:
    if file.suffix == ".json":
        return _run(file)
    if table.is_sweep(file):
        return read_sweep(file)
    recording = _with_times(file, Recording.read(file))
    return RunResult(file.stem, recording, provenance=recording.provenance)


def _run(document: Path) -> RunResult:
    recording = _recording_of(document)
    if recording is None:
        raise OrchestrationError(f"{document}: expected the .json that l1-depth run writes, with its keys")
    content = checked(_DOCUMENT, json.loads(document.read_text(encoding="utf-8")), str(document))
    signals = _with_times(recording, Recording.read(recording))
    with recording.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    if digest != content.sha256:
        raise OrchestrationError(
            f"{document}: sha256 = {content.sha256[:12]!r}: expected {digest[:12]!r}, of {recording.name}: it"
            " is of another run, or of an earlier version; run again, or remove the .json to show it alone"
        )
    try:
        toml(content.scenario)
    except TypeError as error:
        raise OrchestrationError(f"{document}: scenario: expected values of TOML: {error}") from error
    return RunResult(
        document.stem,
        signals,
        content.scenario,
        content.run,
        {name: math.nan if m.value is None else m.value for name, m in content.metrics.items()},
        {name: metric.unit for name, metric in content.metrics.items()},
    )


def _measured(file: Path, units: Collection[str]) -> RunResult:
    """Returns the columns of numbers of a CSV file of another program; its first column is the time.

    The provenance has the reason for each column that is left out.

    units: of the other signals on the page; units of the same dimension are converted to them
    """
    data = read_data_file(file)
    if not data.titles:
        raise OrchestrationError(f"{data.start}: expected a first line of titles, got numbers or nothing")
    time = data.times()
    columns: dict[str, tuple[str, np.ndarray]] = {}
    left_out: dict[str, str] = {}
    for i, (title, own) in enumerate(zip(data.titles[1:], data.units[1:], strict=True), start=1):
        try:
            column = data.numbers(i, gaps=True)[:, 0]
        except ScenarioError as error:
            left_out[title] = str(error)
            continue
        others = sorted({*units} - {""}) if own and own not in units else []
        for unit in (own, *others):
            # a unit of another dimension has no conversion
            with suppress(ScenarioError):
                columns[title] = unit, data.conversion(i, unit)(column)
    values = np.array([column for _, column in columns.values()]).reshape(len(columns), len(time)).T
    recording = Recording(tuple(columns), tuple(unit for unit, _ in columns.values()), time, values)
    provenance = left_out and {"left_out": left_out, "fmus": {}}
    return RunResult(file.stem, _with_times(file, recording, jumps=True), {}, provenance, is_measured=True)


def _with_times(file: Path, recording: Recording, jumps: bool = False) -> Recording:
    """Returns the recording after a check of its times; jumps: whether two rows may have one time."""
    if not len(recording.time):
        raise OrchestrationError(f"{file}: expected at least one communication point, got none")
    if not np.isfinite(recording.time).all():
        raise OrchestrationError(f"{file}: expected finite times")
    if not jumps and not (np.diff(recording.time) > 0.0).all():
        raise OrchestrationError(f"{file}: expected times that increase from row to row")
    return recording


def _without_copies(results: dict[Path, RunResult | SweepResult]) -> dict[Path, RunResult | SweepResult]:
    """Removes files whose recording another format of the same name has too."""
    chosen: set[Path] = set()
    for file in sorted(results, key=lambda file: _ENDINGS.index(file.suffix)):
        beside = [results[other] for other in chosen if other.with_suffix("") == file.with_suffix("")]
        if not any(_same_recording(results[file], other) for other in beside):
            chosen.add(file)
    return {file: result for file, result in results.items() if file in chosen}


def _same_recording(one: RunResult | SweepResult, other: RunResult | SweepResult) -> bool:
    if isinstance(one, SweepResult) or isinstance(other, SweepResult):
        return False
    a, b = one.recording, other.recording
    return (a.names, a.units) == (b.names, b.units) and all(
        np.array_equal(x, y, equal_nan=True) for x, y in ((a.time, b.time), (a.values, b.values))
    )


def _names(files: list[Path]) -> dict[Path, str]:
    """Returns the stem of each file, with its ending or as many folders as make it unique."""
    count_of_stem = Counter(file.with_suffix("") for file in files)
    own = {file: file.stem if count_of_stem[file.with_suffix("")] == 1 else file.name for file in files}
    names = dict(own)
    for depth in range(1, max((len(file.parts) for file in files), default=0)):
        count = Counter(names.values())
        for file in files:
            if count[names[file]] > 1:
                names[file] = "/".join([*file.parent.parts[-depth:], own[file]])
    return names

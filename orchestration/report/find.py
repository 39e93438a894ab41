"""From the paths that a user names to results with names that tell them apart."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fmus.errors import nearest
from orchestration.errors import OrchestrationError
from orchestration.report import sweeps
from orchestration.report.result import RunResult, SweepResult
from orchestration.report.toml import toml
from orchestration.results.files import is_recording
from orchestration.results.formats import RecordingFormat
from orchestration.results.recording import Recording
from orchestration.sweep import table

_RUN_KEYS = {"recording", "scenario", "run", "metrics"}
_RECORDINGS = {f".{ending}" for ending in RecordingFormat}


def found_results(paths: Iterable[Path]) -> list[RunResult | SweepResult]:
    """The results that files and folders hold, each once, in the order given; those of a folder sorted.

    Raises OrchestrationError for a path that does not exist or holds no result.
    """
    results: dict[Path, RunResult | SweepResult] = {}
    for path in paths:
        for file in _files(path):
            if file not in results:
                results[file] = _read(file)
    names = _names(list(results))
    return [replace(result, name=names[file]) for file, result in results.items()]


def _files(path: Path) -> list[Path]:
    """The files that stand for the results at a path: of a run, its .json where there is one."""
    if path.is_dir():
        return _of_folder(path.resolve())
    if not path.is_file():
        neighbours = path.parent.iterdir() if path.parent.is_dir() else []
        known = [file.name for file in neighbours if file.is_dir() or file.suffix in {".json", *_RECORDINGS}]
        raise OrchestrationError(f"no file or folder {path}; beside it, {nearest(path.name, known)}")
    if path.suffix not in {".json", *_RECORDINGS}:
        raise OrchestrationError(
            f"{path}: expected a result: a .json, .csv or .parquet file as l1-depth writes them, or a folder"
        )
    file = path.resolve()
    document = file.with_suffix(".json")
    return [document] if _recording_of(document) == file else [file]


def _of_folder(folder: Path) -> list[Path]:
    documents = {file: _recording_of(file) for file in sorted(folder.glob("*.json"))}
    runs = {file: recording for file, recording in documents.items() if recording}
    recordings_and_sweeps = [
        file
        for file in sorted(folder.iterdir())
        if file.suffix in _RECORDINGS and file not in runs.values() and _is_result(file)
    ]
    if not runs and not recordings_and_sweeps:
        raise OrchestrationError(
            f"{folder}: no result in this folder: expected what l1-depth run, reproduce or sweep writes"
        )
    return sorted([*runs, *recordings_and_sweeps])


def _is_result(file: Path) -> bool:
    return is_recording(file) or table.is_sweep(file)


def _recording_of(document: Path) -> Path | None:
    """The file with the recording of a run's .json; None for anything else."""
    try:
        content = json.loads(document.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(content, dict) or not content.keys() >= _RUN_KEYS:
        return None
    return document.with_name(str(content["recording"]))


def _read(file: Path) -> RunResult | SweepResult:
    if file.suffix == ".json":
        return _run(file)
    if table.is_sweep(file):
        return sweeps.read(file)
    recording = _recording(file)
    return RunResult(file.stem, recording, provenance=recording.provenance)


def _run(document: Path) -> RunResult:
    recording = _recording_of(document)
    if recording is None:
        raise OrchestrationError(
            f"{document}: expected the .json that l1-depth run writes, with {', '.join(sorted(_RUN_KEYS))}"
        )
    content = json.loads(document.read_text(encoding="utf-8"))
    for key in ("scenario", "run", "metrics"):
        if not isinstance(content[key], dict):
            raise OrchestrationError(f"{document}: {key}: expected a table, got {content[key]!r}")
    try:
        toml(content["scenario"])
    except TypeError as error:
        raise OrchestrationError(f"{document}: scenario: expected what TOML can say: {error}") from error
    values, units = _metrics(content["metrics"], document)
    return RunResult(document.stem, _recording(recording), content["scenario"], content["run"], values, units)


def _metrics(content: Mapping[str, Any], document: Path) -> tuple[dict[str, float], dict[str, str]]:
    """The values of the metrics and their units."""
    for name, metric in content.items():
        if not isinstance(metric, dict) or metric.keys() != {"value", "unit"}:
            raise OrchestrationError(
                f"{document}: metric {name}: expected a value and a unit, got {metric!r}"
            )
    return (
        {name: metric["value"] for name, metric in content.items()},
        {name: metric["unit"] for name, metric in content.items()},
    )


def _recording(file: Path) -> Recording:
    recording = Recording.read(file)
    if not len(recording.time):
        raise OrchestrationError(f"{file}: expected at least one communication point, got none")
    if not np.isfinite(recording.time).all():
        raise OrchestrationError(f"{file}: expected finite times")
    if not (np.diff(recording.time) > 0.0).all():
        raise OrchestrationError(f"{file}: expected times that increase from row to row")
    return recording


def _names(files: list[Path]) -> dict[Path, str]:
    """The stem of a file, with the ending or as many folders before it as tell it from the others."""
    count_of_stem = Counter(file.with_suffix("") for file in files)
    own = {file: file.stem if count_of_stem[file.with_suffix("")] == 1 else file.name for file in files}
    names = dict(own)
    for depth in range(1, max((len(file.parts) for file in files), default=0)):
        count = Counter(names.values())
        for file in files:
            if count[names[file]] > 1:
                names[file] = "/".join([*file.parent.parts[-depth:], own[file]])
    return names

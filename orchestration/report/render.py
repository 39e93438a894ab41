"""The page itself: template, style and scripts of `files/` with the results put in.

Text from files is escaped by jinja2, data is JSON without markup, and the content security policy lets
only the scripts run whose hashes it names and nothing be fetched.
"""

import base64
import hashlib
import json
import math
import re
import zlib
from collections.abc import Mapping, Sequence
from importlib import metadata
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from fmus.extras import imports_of
from orchestration.report.result import (
    RunResult,
    SweepResult,
    common_metrics,
    correlations,
    distributions,
    groups_of,
    of_succeeded,
    paired_differences,
    strongest,
    toml,
)
from orchestration.results.files import points_down
from orchestration.results.metric_units import shown
from orchestration.results.metrics import SIGNALS
from orchestration.sweep.table import HEADINGS, categorical

with imports_of("report", "a report"):
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup

_FILES = Path(__file__).with_name("files")
_SCRIPTS = ("points.js", "tables.js", "signals.js", "sweeps.js")


def render(results: Sequence[RunResult | SweepResult], title: str = "") -> str:
    """Returns a self-contained HTML page of these results; by default titled after them."""
    runs = [result for result in results if isinstance(result, RunResult)]
    swept = [result for result in results if isinstance(result, SweepResult)]
    labels = shortened([run.name for run in runs]) | shortened([sweep.name for sweep in swept])
    compared = common_metrics(swept)
    return page(
        "page.html",
        _SCRIPTS,
        title=title or _title(runs, swept),
        runs=runs,
        sweeps=swept,
        metric_groups=_metric_groups(runs),
        labels=labels,
        compared=compared,
        paired=paired_differences(swept) if compared else [],
        statistics=of_succeeded,
        least=least,
        differences=differences(runs),
        shown=shown,
        headings=HEADINGS,
        categorical=categorical,
        distributions=distributions,
        correlations=correlations,
        data={
            "columns": COLUMNS,
            "runs": [{**run_data(run), "label": labels[run.name]} for run in runs],
            "sweeps": [{**sweep_data(sweep), "label": labels[sweep.name]} for sweep in swept],
            "compared": list(compared.items()),
        },
    )


def page(template: str, script_files: Sequence[str], **content: Any) -> str:
    """Returns a self-contained HTML page of a template of `files/`, which extends `base.html`.

    content: what the template shows, with `title`, and `data` for its scripts
    """
    environment = Environment(loader=FileSystemLoader(_FILES), autoescape=True, undefined=StrictUndefined)
    environment.filters |= {"toml": toml, "number": _number, "breakable": _breakable, "facts": _facts}
    scripts = [_file(name) for name in ("uplot.js", "common.js", *script_files)]
    return environment.get_template(template).render(
        **content,
        style=Markup(_file("page.css") + _file("uplot.css")),
        scripts=[Markup(script) for script in scripts],
        hashes=" ".join(f"'sha256-{_sha256(script)}'" for script in scripts),
        made_by=f"l1-depth {metadata.version('l1-depth')}, {_file('uplot.LICENSE').partition(' (')[0]}",
    )


def _file(name: str) -> str:
    return (_FILES / name).read_text(encoding="utf-8")


def _sha256(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")


def _title(runs: Sequence[RunResult], swept: Sequence[SweepResult]) -> str:
    if len(runs) + len(swept) == 1:
        return [*runs, *swept][0].title
    counted = [(len(runs), "run"), (len(swept), "sweep")]
    return " and ".join(f"{count} {what}{'s' * (count > 1)}" for count, what in counted if count)


def _metric_groups(runs: Sequence[RunResult]) -> dict[tuple[tuple[str, str], ...], list[RunResult]]:
    """Returns metrics with their units -> the runs that have them."""
    groups: dict[tuple[tuple[str, str], ...], list[RunResult]] = {}
    for run in runs:
        groups.setdefault(tuple(run.metric_units.items()), []).append(run)
    groups.pop((), None)
    return groups


_NO_BEST = ("mean", "time_below")  # functions of which neither less nor more is better


def least(runs: Sequence[RunResult], metric: str) -> float | None:
    """Returns the least magnitude of a metric, the best; None of one run, or where all are equal."""
    call = runs[0].scenario.get("metrics", {}).get(metric, {})
    sizes = {abs(run.metrics[metric]) for run in runs if math.isfinite(run.metrics[metric])}
    return min(sizes) if len(sizes) > 1 and call.get("function", "mean") not in _NO_BEST else None


def shortened(names: Sequence[str]) -> dict[str, str]:
    """Returns name -> what differs: without the parts that all names begin or end with."""
    start = _common_length(names)
    rest = [name[start:] for name in names]
    end = _common_length([name[::-1] for name in rest])
    return {name: part[: len(part) - end] or name for name, part in zip(names, rest, strict=True)}


def _common_length(names: Sequence[str]) -> int:
    """Returns the length of the parts, each with its separator, that all of several names begin with."""
    parts = [re.split(r"(?<=[-_./ ])", name)[:-1] for name in names] if len(names) > 1 else []
    common = takewhile(lambda same: len(set(same)) == 1, zip(*parts, strict=False))
    return sum(len(part) for part, *_ in common)


def _facts(provenance: Mapping[str, Any]) -> dict[str, str]:
    """Returns the provenance of a result without the FMUs; "step_size_s" is a step size [s]."""
    facts = {key: value for key, value in provenance.items() if key != "fmus" and value is not None}
    return {re.sub(r"_s$", " [s]", key).replace("_", " "): value for key, value in flat(facts).items()}


def _number(value: Any) -> str:
    """Returns five digits of a number; whole numbers and texts as they are."""
    return f"{value:.5g}" if isinstance(value, (float, np.floating)) else str(value)


def _breakable(name: str) -> Markup:
    """Returns a name that breaks after a dot, an underscore or a comma, if three letters follow."""
    return Markup("<wbr>").join(re.split(r"(?<=[._,])(?=\w{3})", name))


_ABSENT = "absent"
_FEW = 3
_NEVER_TELLING = ("title",)  # it always differs, and is shown


def differences(runs: list[RunResult]) -> dict[str, dict[str, str]]:
    """Returns setting -> value as text -> names of its runs, where values differ; rare values first."""
    settings = {run.name: flat({**run.scenario, "run": run.provenance}) for run in runs if run.scenario}
    values_by_setting: dict[str, dict[str, str]] = {}
    for key in sorted({key for values in settings.values() for key in values} - set(_NEVER_TELLING)):
        names: dict[str, list[str]] = {}
        for name, values in settings.items():
            names.setdefault(values.get(key, _ABSENT), []).append(name)
        if len(names) > 1:
            by_rarity = sorted(names.items(), key=lambda item: len(item[1]))
            values_by_setting[key] = {value: ", ".join(members) for value, members in by_rarity}
            most, members = by_rarity[-1]
            if len(members) > _FEW:
                values_by_setting[key][most] = f"the other {len(members)}"
    return values_by_setting


def flat(content: Mapping[str, Any], before: str = "") -> dict[str, str]:
    """Returns nested tables as one: "experiment: step_size" -> its value as text."""
    texts: dict[str, str] = {}
    for key, value in content.items():
        if isinstance(value, Mapping):
            texts |= flat(value, f"{before}{key}: ")
        else:
            texts[f"{before}{key}"] = (
                value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
            )
    return texts


def packed(values: np.ndarray) -> str:
    """Doubles -> base64 of zlib of their bytes, all first bytes before all second ones and so on.

    Neighbours in time share sign and exponent, so that these bytes compress well side by side.
    """
    bytes_of_values = np.ascontiguousarray(values, dtype="<f8").view(np.uint8).reshape(-1, 8)
    return base64.b64encode(zlib.compress(bytes_of_values.T.tobytes())).decode("ascii")


COLUMNS = 2000
"""Columns of pixels of a chart: a screen shows no more of one of them than its least and largest value."""


def drawn_points(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Returns the indices of both ends and, of each column of time, the least and largest value, and a gap.

    Of no more than two points a column they are all indices.
    """
    if len(values) <= 2 * COLUMNS:
        return np.arange(len(values))
    column = ((time - time[0]) * (COLUMNS / (time[-1] - time[0]))).astype(int)
    finite = np.where(np.isfinite(values), values, np.nan)
    order = np.lexsort((finite, column))  # within a column by value, gaps last
    starts = np.flatnonzero(np.diff(column, prepend=-1))
    largest = starts + np.maximum(np.add.reduceat(np.isfinite(finite).astype(int), starts), 1) - 1
    lasts = np.append(starts[1:], len(values)) - 1
    return np.unique(np.concatenate([[0, len(values) - 1], order[starts], order[largest], order[lasts]]))


def tracking_errors(run: RunResult) -> dict[str, tuple[str, str, np.ndarray]]:
    """Returns signal -> name, unit and values of its error, scaled as an RMSE or a peak error of the run."""
    errors: dict[str, tuple[str, str, np.ndarray]] = {}
    for metric, call in run.scenario.get("metrics", {}).items():
        signal, reference = call.get("signal"), call.get("reference")
        is_error = call.get("function") in ("rmse", "peak_error")
        if is_error and {signal, reference} <= set(run.recording.numbers) and signal not in errors:
            values = call.get("scale", 1.0) * (run.recording[signal] - run.recording[reference])
            errors[signal] = f"{signal} - {reference}", run.metric_units.get(metric, ""), values
    return errors


def _signal_data(
    name: str, unit: str, time: np.ndarray, values: np.ndarray, error_of: str = ""
) -> dict[str, Any]:
    """Returns what is drawn of a signal; error_of: the unit of the signal whose tracking error it is."""
    kept = drawn_points(time, values)
    return {
        "name": name,
        "unit": unit or "1",
        "error_of": error_of,
        "down": not error_of and points_down(name, unit),
        "values": packed(values[kept]),
        "steps": packed(np.diff(kept, prepend=0)) if len(kept) < len(time) else "",
    }


def run_data(run: RunResult) -> dict[str, Any]:
    """Returns the data that the page's script draws of a run."""
    recording = run.recording
    signals = [
        _signal_data(name, recording.unit(name), recording.time, recording[name])
        for name in recording.numbers
    ]
    errors = tracking_errors(run)
    for of, (name, unit, values) in errors.items():
        at = recording.numbers.index(of) + 1  # beside what it is the error of
        signals.insert(at, _signal_data(name, unit, recording.time, values, recording.unit(of) or "1"))
    return {
        "name": run.name,
        "time": packed(recording.time),
        "is_measured": run.is_measured,
        "signals": signals,
        "in_metrics": sorted(
            {
                str(call[key])
                for call in run.scenario.get("metrics", {}).values()
                for key in SIGNALS
                if key in call
            }.union((name for name, _, _ in errors.values()), recording.numbers if run.is_measured else ())
        ),
    }


def sweep_data(sweep: SweepResult) -> dict[str, Any]:
    """Returns the data that the page's script draws of a sweep."""
    categories = categorical(sweep.varied)
    return {
        "name": sweep.name,
        "samples": packed(sweep.samples),
        "errors": {int(n): error for n, error in zip(sweep.samples, sweep.errors, strict=True) if error},
        "columns": [
            {
                "name": name,
                "unit": sweep.units.get(name, ""),
                "kind": kind,
                "values": list(map(str, values)) if name in categories else packed(np.asarray(values)),
                "absent": sweep.absent.get(name, ""),
            }
            for kind, columns in (("varied", sweep.varied), ("metric", sweep.metrics))
            for name, values in columns.items()
        ],
        "groups": [
            {"name": ", ".join(group), "members": indices.tolist()}
            for group, indices in groups_of(sweep).items()
        ],
        "first": strongest(correlations(sweep)),
        "command": sweep.command,
    }

"""The page of runs and sweeps."""

import json
import math
import re
from collections.abc import Mapping, Sequence
from itertools import takewhile
from pathlib import Path
from typing import Any

from orchestration.report.embedded import COLUMNS, run_data, sweep_data
from orchestration.report.result import (
    RunResult,
    SweepResult,
    common_metrics,
    correlations,
    distributions,
    of_succeeded,
    paired_differences,
    toml,
)
from orchestration.results.metric_units import shown
from orchestration.results.page import page
from orchestration.results.panels import axis_label
from orchestration.sweep.table import HEADINGS, categorical, grid

_TEMPLATE = Path(__file__).parent / "files" / "page.html"
_SCRIPTS = ("points.js", "tables.js", "signals.js", "sweeps.js")


def render(results: Sequence[RunResult | SweepResult], title: str = "") -> str:
    """Returns a self-contained HTML page of these results; its default title is theirs."""
    runs = [result for result in results if isinstance(result, RunResult)]
    swept = [result for result in results if isinstance(result, SweepResult)]
    labels = shortened([run.name for run in runs]) | shortened([sweep.name for sweep in swept])
    compared = common_metrics(swept)
    return page(
        _TEMPLATE,
        _SCRIPTS,
        {"toml": toml, "facts": _facts},
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
        grid=grid,
        correlations=correlations,
        data={
            "columns": COLUMNS,
            "runs": [{**run_data(run), "label": labels[run.name]} for run in runs],
            "sweeps": [{**sweep_data(sweep), "label": labels[sweep.name]} for sweep in swept],
            "axes": _axes(runs),
            "compared": list(compared.items()),
        },
    )


def _title(runs: Sequence[RunResult], swept: Sequence[SweepResult]) -> str:
    if len(runs) + len(swept) == 1:
        return [*runs, *swept][0].title
    counted = [(len(runs), "run"), (len(swept), "sweep")]
    return " and ".join(f"{count} {what}{'s' * (count > 1)}" for count, what in counted if count)


def _axes(runs: Sequence[RunResult]) -> dict[str, str]:
    """Returns unit, "1" for none -> the label of the axis of the signals that have it in any run."""
    names: dict[str, dict[str, None]] = {}
    for run in runs:
        for name in run.recording.numbers:
            names.setdefault(run.recording.unit(name) or "1", {})[name] = None
    return {unit: axis_label([*signals], unit) for unit, signals in names.items()}


def _metric_groups(runs: Sequence[RunResult]) -> dict[tuple[tuple[str, str], ...], list[RunResult]]:
    """Returns metrics with their units -> the runs that have them."""
    groups: dict[tuple[tuple[str, str], ...], list[RunResult]] = {}
    for run in runs:
        groups.setdefault(tuple(run.metric_units.items()), []).append(run)
    groups.pop((), None)
    return groups


# functions of which neither less nor more is better
_NO_BEST = ("mean", "maximum", "minimum", "time_below", "time_above", "duty_cycle")


def least(runs: Sequence[RunResult], metric: str) -> float | None:
    """Returns the least magnitude of a metric, the best; None for one run, or if all are equal."""
    call = runs[0].scenario.get("metrics", {}).get(metric, {})
    sizes = {abs(run.metrics[metric]) for run in runs if math.isfinite(run.metrics[metric])}
    return min(sizes) if len(sizes) > 1 and call.get("function", "mean") not in _NO_BEST else None


def shortened(names: Sequence[str]) -> dict[str, str]:
    """Returns name -> the name without the parts that all names begin or end with."""
    start = _common_length(names)
    rest = [name[start:] for name in names]
    end = _common_length([name[::-1] for name in rest])
    return {name: part[: len(part) - end] or name for name, part in zip(names, rest, strict=True)}


def _common_length(names: Sequence[str]) -> int:
    """Returns the length of the parts, with separators, that all of several names begin with."""
    parts = [re.split(r"(?<=[-_./ ])", name)[:-1] for name in names] if len(names) > 1 else []
    common = takewhile(lambda same: len(set(same)) == 1, zip(*parts, strict=False))
    return sum(len(part) for part, *_ in common)


def _facts(provenance: Mapping[str, Any]) -> dict[str, str]:
    """Returns the provenance of a result without the FMUs; "step_size_s" is a step size [s]."""
    facts = {key: value for key, value in provenance.items() if key != "fmus" and value is not None}
    return {re.sub(r"_s$", " [s]", key).replace("_", " "): value for key, value in flat(facts).items()}


_ABSENT = "absent"
_FEW = 3
_SHOWN_ABOVE = ("title",)  # it always differs


def differences(runs: list[RunResult]) -> dict[str, dict[str, str]]:
    """Returns each setting that differs -> value as text -> names of its runs; rare values first."""
    settings = {run.name: flat({**run.scenario, "run": run.provenance}) for run in runs if run.scenario}
    values_by_setting: dict[str, dict[str, str]] = {}
    for key in sorted({key for values in settings.values() for key in values} - set(_SHOWN_ABOVE)):
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

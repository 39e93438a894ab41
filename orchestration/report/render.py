"""The page itself: template, style and scripts of `files/` with the results put in.

Text from files is escaped by jinja2, data is JSON without markup, and the content security policy lets
only the scripts run whose hashes it names and nothing be fetched.
"""

import base64
import hashlib
import re
from collections.abc import Sequence
from importlib import metadata
from typing import Any

import numpy as np

from fmus.extras import imports_of
from orchestration.report.differences import differences, flat
from orchestration.report.embedded import run_data, sweep_data
from orchestration.report.result import RunResult, SweepResult
from orchestration.report.statistics import correlations, distributions
from orchestration.report.toml import toml

with imports_of("report", "a report"):
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup
    from plotly.offline import get_plotlyjs, get_plotlyjs_version

_SCRIPTS = ("common.js", "tables.js", "signals.js", "sweeps.js")


def render(results: Sequence[RunResult | SweepResult], title: str = "") -> str:
    """A self-contained HTML page of these results; by default titled after them."""
    runs = [result for result in results if isinstance(result, RunResult)]
    sweeps = [result for result in results if isinstance(result, SweepResult)]
    environment = Environment(
        loader=PackageLoader("orchestration.report", "files"), autoescape=True, undefined=StrictUndefined
    )
    environment.filters |= {"toml": toml, "number": _number, "breakable": _breakable}
    scripts = [get_plotlyjs(), *(_file(environment, name) for name in _SCRIPTS)]
    return environment.get_template("page.html").render(
        title=title or _title(runs, sweeps),
        results=[*runs, *sweeps],
        runs=runs,
        sweeps=sweeps,
        metric_groups=_metric_groups(runs),
        differences=differences(runs),
        facts={result.name: _facts(result) for result in results},
        distributions={sweep.name: distributions(sweep) for sweep in sweeps},
        correlations={sweep.name: correlations(sweep) for sweep in sweeps},
        failures={sweep.name: _failures(sweep) for sweep in sweeps},
        data={"runs": [run_data(run) for run in runs], "sweeps": [sweep_data(sweep) for sweep in sweeps]},
        style=Markup(_file(environment, "page.css")),
        scripts=[Markup(script) for script in scripts],
        hashes=" ".join(f"'sha256-{_sha256(script)}'" for script in scripts),
        made_by=f"l1-depth {metadata.version('l1-depth')}, plotly.js {get_plotlyjs_version()}",
    )


def _file(environment: Environment, name: str) -> str:
    assert environment.loader
    return environment.loader.get_source(environment, name)[0]


def _sha256(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")


def _title(runs: Sequence[RunResult], sweeps: Sequence[SweepResult]) -> str:
    if len(runs) + len(sweeps) == 1:
        return [*runs, *sweeps][0].title
    counted = [(len(runs), "run"), (len(sweeps), "sweep")]
    return " and ".join(f"{count} {what}{'s' * (count > 1)}" for count, what in counted if count)


def _metric_groups(runs: Sequence[RunResult]) -> list[dict[str, Any]]:
    """Runs with the same metrics in the same units side by side."""
    groups: dict[tuple[tuple[str, str], ...], list[RunResult]] = {}
    for run in runs:
        if run.metrics:
            groups.setdefault(tuple(run.metric_units.items()), []).append(run)
    return [
        {"names": list(dict(units)), "units": dict(units), "runs": members}
        for units, members in groups.items()
    ]


def _failures(sweep: SweepResult) -> list[dict[str, Any]]:
    return [
        {
            "sample": int(sweep.samples[i]),
            "varied": {name: values[i] for name, values in sweep.varied.items()},
            "error": error,
        }
        for i, error in enumerate(sweep.errors)
        if error
    ]


def _facts(result: RunResult | SweepResult) -> dict[str, str]:
    """The provenance of a result without the FMUs; "step_size_s" is a step size [s]."""
    facts = {key: value for key, value in result.provenance.items() if key != "fmus" and value is not None}
    return {re.sub(r"_s$", " [s]", key).replace("_", " "): value for key, value in flat(facts).items()}


def _number(value: Any) -> str:
    """Five digits of a number; whole numbers and texts as they are."""
    return f"{value:.5g}" if isinstance(value, (float, np.floating)) else str(value)


def _breakable(name: str) -> Markup:
    """A name that may be broken after a dot, an underscore or a comma, if three letters follow."""
    return Markup("<wbr>").join(re.split(r"(?<=[._,])(?=\w{3})", name))

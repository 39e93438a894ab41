"""A score whose metrics are made up: three controllers, two cases, two plants."""

import math

from orchestration.studies.score.protocol import read_protocol
from orchestration.studies.score.run_metrics import Trace
from orchestration.studies.score.score import ScoreResult
from orchestration.studies.score.score_document import (
    CaseResult,
    ManyRuns,
    MetricOverRuns,
    PairedDifference,
    Row,
    Score,
    protocol_info,
)
from orchestration.studies.score.score_rows import OVER_PLANTS

CASES = ("nominal", "buoyancy")
MEAN_AND_VARIATION = {"mine": (2.0, 300.0), "pid": (1.0, 400.0), "l1": (3.0, 500.0)}


def made_up_score() -> ScoreResult:
    """ "mine" (scored), "pid" and "l1", whose nominal run failed: it breached the surface."""
    info = protocol_info(read_protocol())
    info.cases = {name: info.cases[name] for name in CASES}
    rows = [_row(name, *values) for name, values in MEAN_AND_VARIATION.items()]
    difference = PairedDifference(
        scored="mine",
        other="pid",
        metric="rmse",
        pairs=2,
        median_difference=1.0,
        interval=(0.5, 1.5),
        margin=0.05,
        verdict="higher",
        p=0.5,
        p_holm=1.0,
    )
    document = Score(made_by="test", protocol=info, rows=rows, differences=[difference])
    traces = {row.name: {case: _trace(row.cases[case].metrics["rmse"]) for case in CASES} for row in rows}
    return ScoreResult(document, traces)


def _row(name: str, rmse: float, variation: float) -> Row:
    def case(factor: float) -> CaseResult:
        return CaseResult(metrics={"rmse": factor * rmse, "total_variation": variation, "lag": math.nan})

    cases = {"nominal": case(1.0), "buoyancy": case(1.5)}
    cases["nominal"].failed = ["breach 3 s"] if name == "l1" else []
    over_plants = MetricOverRuns(median=rmse, p95=rmse, cvar=rmse, values=[rmse, 2.0 * rmse])
    plants = ManyRuns(
        count=2,
        failure_rate=0.0,
        failure_interval=(0.0, 0.8),
        metrics=dict.fromkeys(OVER_PLANTS, over_plants),
    )
    return Row(
        name=name,
        title=f"<{name}>",
        connected=["depth_reference"],
        scored=name == "mine",
        fmu={"model": name, "guid": "1", "tool": "", "sha256": ""},
        parameters={f"{gain}_feedback_gain": 16.3 for gain in ("depth", "rate", "integral", "proportional")},
        delay_margin=0.1,
        cases=cases,
        plants=plants,
    )


def _trace(error: float) -> Trace:
    """Late by a constant error [cm]."""
    return {
        "time": [0.0, 1.0, 2.0],
        "reference": [0.0, 0.4, 0.8],
        "depth": [0.0, 0.4 - 0.01 * error, 0.8 - 0.01 * error],
        "u": [0.0, 1.0, 1.2],
    }

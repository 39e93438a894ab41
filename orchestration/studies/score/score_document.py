"""score.json as types, from which its schema is derived. What did not happen, or cannot be said, is null.

`python -m orchestration.studies.score.score_document` writes the schema that ships.
"""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, PlainSerializer, WithJsonSchema

from orchestration.results.statistics import Verdict
from orchestration.studies.score.protocol import Protocol
from orchestration.studies.score.protocol_format import DELAY_MARGIN

SCHEMA = Path(__file__).with_name("score.schema.json")

Number = Annotated[
    float,
    BeforeValidator(lambda value: math.nan if value is None else value),
    PlainSerializer(lambda value: value if math.isfinite(value) else None, when_used="json"),
    WithJsonSchema({"type": ["number", "null"]}),
]


class Part(BaseModel, strict=True, validate_assignment=True):
    """A part of the document; it has no other keys, and no value that the schema refuses."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True, ser_json_inf_nan="null")


class MetricInfo(Part):
    """The description of a metric."""

    title: str
    unit: str
    """Unit of its values and statistics."""
    meaning: str
    """Its definition."""
    greatest_is_best: bool = False
    """Whether the largest value is marked as the best, not the smallest."""

    @property
    def heading(self) -> str:
        """Title and unit."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title


class CaseInfo(Part):
    """The description of a case."""

    title: str
    """Name in tables and figures."""
    tuned_on: bool
    """Built-in controllers are tuned on this case: its metrics are no test of them."""
    repeats_nominal: bool = False
    """It ranks controllers as the nominal case does, and performance profiles leave it out."""


class ProtocolInfo(Part):
    """The protocol that every metric here is of."""

    version: str
    """Version of the protocol."""
    statement: str
    """Claims for which the metrics are evidence, and claims for which they are not."""
    metrics: dict[str, MetricInfo]
    """Metric -> its description."""
    cases: dict[str, CaseInfo]
    """Case -> its description."""
    left_out: dict[str, str] = {}
    """Title of a case that cannot run on the vehicle -> what the vehicle lacks."""
    failure: dict[str, float]
    """Metric -> its limit: a run above it failed, and one that does not settle or ends early."""


class CaseResult(Part):
    """One run."""

    metrics: dict[str, Number] = {}
    """Metric -> value; null if it is not a number."""
    failed: list[str] = []
    """Reasons why it counts as failed; empty if it does not."""


class MetricOverRuns(Part):
    """A metric over the plants or the draws of a case: statistics of its distribution, and its values."""

    median: Number
    """Median of the values."""
    p95: Number
    """95th percentile of the values."""
    cvar: Number
    """Mean of the worst 5 %; null if a run without a value is among them."""
    values: list[Number]
    """Run by run; null where it ended early."""


class ManyRuns(Part):
    """Runs of --full: the plants, or a case with seeds and times that are drawn."""

    count: int
    """Number of the runs."""
    failure_rate: float
    """Share of the runs that failed."""
    failure_interval: tuple[float, float]
    """Its confidence interval of 95 %, by Clopper and Pearson."""
    failed: dict[str, list[str]] = {}
    """Number of a run -> why it counts as failed."""
    metrics: dict[str, MetricOverRuns]
    """Metric -> its statistics over these runs."""


_SYMBOLS = {
    "depth_reference": "r",
    "depth_reference_rate": "r'",
    "depth_reference_acceleration": "r''",
    "measured_depth_rate": "z'",
}


class Row(Part):
    """One controller."""

    name: str
    """Name in the protocol, or of the file."""
    title: str
    """Name in tables and figures."""
    connected: list[str] = []
    """Its connected inputs among reference, its derivatives and depth rate, by names of the interface."""
    scored: bool
    """Whether it was given to the command, not taken from the protocol."""
    fmu: dict[str, Any]
    """Model, GUID, generation tool and SHA-256 of its FMU."""
    parameters: dict[str, Any] = {}
    """Variable -> value of what is not at its start value."""
    unranked: list[str] = []
    """Why its numbers are not marked as the best of a column; empty if they may be."""
    step: Number = math.nan
    """Communication step [s] of its runs."""
    delay_margin: Number = math.nan
    """Median of `delay_margins`; null if the nominal case fails or a draw has none."""
    delay_margins: list[Number] = []
    """Longest additional delay [s] of the nominal case, with --full in each draw; null if unsettled."""
    microseconds: Number = math.nan
    """Time [us] of a communication step of the controller's FMU in the nominal run, on this machine."""
    cases: dict[str, CaseResult] = {}
    """Case -> the result of its one run."""
    draws: dict[str, ManyRuns] = {}
    """Case that does not repeat the nominal one -> its runs with drawn seeds and times, with --full."""
    plants: ManyRuns | None = None
    """Runs of the nominal case on random plants, with --full."""

    @property
    def symbols(self) -> str:
        """Symbols of `connected`."""
        return ", ".join(_SYMBOLS.get(name, name) for name in self.connected) or "-"


class PairedDifference(Part):
    """A metric of one controller minus the metric of another one, over the same plants."""

    scored: str
    """Name of the first controller."""
    other: str
    """Name of the controller whose metric is subtracted."""
    metric: str
    """Name of the metric."""
    pairs: int
    """Plants on which both have a value."""
    median_difference: Number
    """Median over the pairs, in the unit of the metric."""
    interval: tuple[Number, Number]
    """Confidence interval of the median difference; all intervals of a metric hold jointly with 95 %."""
    margin: Number
    """A difference below it counts as none: 5 % of the lesser median."""
    verdict: Verdict
    """Interval beyond the margin ("lower", "higher"), within it ("equal"), or neither ("open")."""
    p: Number
    """p-value of Wilcoxon's signed-rank test."""
    p_holm: Number
    """p-value corrected for the number of pairs of controllers (Holm)."""


class Score(Part):
    """The score that `l1-depth score` writes."""

    made_by: str
    """Program and version that wrote the file."""
    seed: int = 0
    """Seed of noise, times and plants: `--seed` repeats them."""
    seed_is_given: bool | None = None
    """Whether the seed was chosen (its noise may have been known), not drawn; null: not recorded."""
    protocol: ProtocolInfo
    """Description of the protocol: metrics and cases."""
    rows: list[Row]
    """Results, one entry for each controller."""
    differences: list[PairedDifference] = []
    """Paired differences between controllers, with --full."""

    @property
    def seed_text(self) -> str:
        """The seed, marked if it was given."""
        return f"{self.seed}{' (given, not drawn)' if self.seed_is_given else ''}"

    @property
    def nominal(self) -> str:
        """Name of the case of the paper: the first."""
        return next(iter(self.protocol.cases))

    @property
    def scored(self) -> list[Row]:
        return [row for row in self.rows if row.scored]


MICROSECONDS = "microseconds"
OF_A_ROW: Mapping[str, MetricInfo] = {
    DELAY_MARGIN: MetricInfo(
        title="Delay margin",
        unit="s",
        meaning="longest additional delay of the measured depth with which the nominal loop holds quietly: "
        "standard deviation below 3 mm from 100 s to 140 s; the first loss on a scan; of --full the median "
        "over draws of the noise; not a number if the nominal run fails",
        greatest_is_best=True,
    ),
    MICROSECONDS: MetricInfo(
        title="Step",
        unit="us",
        meaning="processor time of a communication step of the controller's FMU, with its inputs of the "
        "nominal run",
    ),
}
"""Metrics that a row has once, not for each case."""


def protocol_info(protocol: Protocol) -> ProtocolInfo:
    """Returns the description of the protocol."""
    metrics = {
        name: MetricInfo.model_validate(table, from_attributes=True)
        for name, table in protocol.metrics.items()
    }
    titles_of_reason: dict[str, list[str]] = {}
    for name, reason in protocol.left_out.items():
        titles_of_reason.setdefault(reason, []).append(protocol.tables.cases[name].title)
    return ProtocolInfo(
        version=protocol.version,
        statement=protocol.statement,
        metrics={**metrics, **OF_A_ROW},
        cases={
            name: CaseInfo.model_validate(case, from_attributes=True) for name, case in protocol.cases.items()
        },
        left_out={"; ".join(titles): reason for reason, titles in titles_of_reason.items()},
        failure=dict(protocol.tables.failure),
    )


def schema() -> str:
    """Returns the JSON schema of score.json, as `SCHEMA` holds it."""
    dialect = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return json.dumps({**dialect, **Score.model_json_schema(mode="serialization")}, indent=1) + "\n"


if __name__ == "__main__":
    SCHEMA.write_text(schema(), encoding="utf-8")

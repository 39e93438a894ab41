"""The content of protocol.toml, as types."""
# ruff: noqa: RUF012  (Pydantic copies defaults)

from typing import Annotated, Any

from pydantic import Field

from orchestration.scenarios.file_format import Pair, Source
from orchestration.scenarios.file_tables import Table, Value
from orchestration.scenarios.vehicle import ChangesTable
from orchestration.studies.vehicle import DISTRIBUTION, DRAWN

SIGNALS = {"depth": "m", "reference": "m", "u": "N", "voltage": "V", "power": "V2", "saturated": "%"}
"""What metrics are computed of -> its unit."""
COMPARED = ("rmse", "peak_error", "total_variation")
"""Metrics that every protocol has: tables show their means, and controllers are compared in them."""
DELAY_MARGIN = "delay_margin"
"""Name of the bound of the cost that is no metric of a run."""


class MetricTable(Table):
    """A number that a score gives of each run."""

    title: str
    unit: str
    meaning: str
    """Its definition, for readers."""
    function: str
    """Name of a function that scenarios have too."""
    arguments: dict[str, Any]
    """Of the function, over the signals of a run."""
    at_target: bool = False
    """The function takes the target of the case, the window until the reference leaves it, and its band."""
    of_motion: bool = False
    """Not a number where the reference does not move."""
    whole_run: bool = False
    """Of the whole run, not of the part of the case that is judged."""


class CaseTable(ChangesTable):
    """A case: its differences from the nominal case, as a scenario gives them."""

    title: str
    tuned_on: bool = False
    """Controllers are tuned on this case: its metrics stand apart."""
    repeats_nominal: bool = False
    """It ranks controllers as the nominal case does: it is run once, and profiles leave it out."""
    hold: float = 0.0
    """The reference is this depth [m] all the time, and the vehicle starts there; 0: the trajectory."""
    judged: Pair = []
    """[start, end] in s of what metrics tell about; by default the run."""
    stop_time: float = 0.0
    """End of the run [s]; by default the end of the trajectory."""
    latest: Annotated[float, Field(ge=0.0)] = 0.0
    """Signals and faults of the case come later than they stand here, by up to this [s]: a score draws it."""
    disturbance: str = ""
    """Name of a disturbance in the description of the vehicle, below these entries."""
    components: dict[str, str] = {}
    """Component -> block, of what stands beside the controller and the vehicle."""
    connections: dict[str, Source] = {}
    """ "component.input" -> "component.output", as in a scenario."""


class GainTable(Table):
    """The range in which a gain may be tuned, searched by its logarithm where both limits have one sign."""

    low: float
    high: float
    inertia: float = 0.0
    """The gain of like motion on another vehicle is in proportion to this power of the inertia."""


class ControllerTable(Table):
    """A controller that stands beside those that are scored."""

    title: str
    fmu: str
    """Name of a block."""
    reference_rates: bool = False
    """Whether the derivatives of the reference are connected."""
    parameters: dict[str, Value] = {}
    """Variable -> value, of what is not at its start value."""
    gains: dict[str, GainTable] = {}
    """Variables that `tune` may change."""


class CostTable(Table):
    """The cost that tuning makes small: the mean of a metric over cases, with bounds on others."""

    metric: str
    cases: Annotated[list[str], Field(min_length=1)]
    bounds: dict[str, Annotated[float, Field(gt=0.0)]] = {}
    """Metric -> its largest value; of the delay margin, its smallest."""
    plants: Annotated[int, Field(ge=0)] = 0
    """If not 0: the cost is of so many practice plants in place of the cases, CVaR over them."""


class TrajectoryTable(Table):
    """The reference of a plant: from the surface to one depth after another."""

    ways: Annotated[Table, DISTRIBUTION]
    """How long the way to a depth takes [s]."""
    holds: Annotated[Table, DISTRIBUTION]
    """How long a depth is held [s]; the last until the run ends."""
    depths: Annotated[list[Annotated[Table, DISTRIBUTION]], Field(min_length=1)]
    """The depths [m]."""


class PlantsTable(Table):
    """Plants that are drawn, with a trajectory each."""

    count: Annotated[int, Field(ge=2)]
    practice_seed: Annotated[int, Field(ge=0)]
    vary: dict[str, Annotated[Table, DRAWN]] = {}
    """Name of a drawn value -> the variables that take it, and its distribution; by default the ranges in the
    description of the vehicle."""
    trajectory: TrajectoryTable


class ProtocolFile(Table):
    """The protocol of the score."""

    version: str
    statement: str
    """Subject of a score, for the top of every one."""
    base: str
    """The shipped base of all cases."""
    time_limit: Annotated[float, Field(gt=0.0)]
    """Longest time [s] that a run may take."""
    practice_seeds: Annotated[list[int], Field(min_length=1)]
    """Seeds of the sensor's noise for whoever tunes."""
    repetitions: Annotated[int, Field(ge=2)]
    """Draws of each case of a full score, but of those that repeat the nominal one."""
    trajectory: Annotated[list[Pair], Field(min_length=3)]
    """[time, depth] of the reference, in s and m; straight lines between them."""
    metrics: dict[str, MetricTable]
    failure: dict[str, float]
    """Metric -> its limit: a run above it failed."""
    cases: dict[str, CaseTable]
    plants: PlantsTable
    cost: CostTable
    controllers: dict[str, ControllerTable]

"""The score of controllers in every case of the protocol, beside its own controllers, and their comparison.

Rows of the comparison: "start/l1" has the start values of its FMU, which for L1 are the gains identified from
the paper; "tuned/l1" has the gains of gains/l1.toml.
"""

import secrets
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import combinations
from typing import Any

from fmus.operating_system import usable_processors
from orchestration.errors import ScenarioError
from orchestration.many.local_runs import LocalRuns
from orchestration.results.statistics import holm, paired
from orchestration.scenarios.fmu_files import fmu_file
from orchestration.studies.score.closed_loop import ClosedLoop, Controller, built_in, tuned
from orchestration.studies.score.draws import LARGEST_SEED
from orchestration.studies.score.protocol import Protocol, read_protocol
from orchestration.studies.score.protocol_format import COMPARED
from orchestration.studies.score.run_metrics import Trace
from orchestration.studies.score.score_document import PairedDifference, Row, Score, protocol_info
from orchestration.studies.score.score_rows import LimitedRuns, Progress, RowTraces, Scoring, repeated
from orchestration.studies.vehicle import built
from orchestration.system.prepared_run import prepare


@dataclass(frozen=True)
class ScoreResult:
    """The document of a score, and the traces that are drawn: row and case -> trace of the run."""

    document: Score
    traces: Mapping[str, Mapping[str, Trace]]


def score_controllers(
    controllers: Sequence[Controller],
    protocol: Protocol | None = None,
    *,
    beside: Sequence[Controller] | None = None,
    full: bool = False,
    seed: int | None = None,
    timeout: float | None = None,
    workers: int = usable_processors(),
    progress: Progress = lambda done: None,
) -> ScoreResult:
    """Runs every case, with `full` every plant too, and compares with the controllers of the protocol.

    Each controller runs in separate processes. One that fails, hangs or crashes has its
    row with the reason.

    Parameters
    ----------
    controllers
        The controllers to score.
    protocol
        Cases, metrics and vehicle; by default the protocol that ships.
    beside
        The other controllers, by default the tuned ones of the protocol, if their gains fit the vehicle.
    full
        Whether to run the plants and the draws of each case.
    seed
        Determines the seeds and times of the cases and the plants; by default random.
    timeout
        Longest time [s] of a run, by default the limit of the protocol.
    workers
        Number of controllers that run side by side.
    progress
        Called with the number of newly finished runs, `run_count` in total.

    Returns
    -------
    ScoreResult
        The document of score.json, and the traces that the page draws.

    Raises
    ------
    OrchestrationError
        For a controller that does not fit the vehicle, before anything runs.

    Examples
    --------
    >>> mine = Controller("mine", "L1DepthController", parameters={"augmentation": "pi"})
    >>> (row,) = score_controllers([mine], beside=[]).document.rows
    >>> rmse = row.cases["nominal"].metrics["rmse"]  # cm
    """
    protocol = protocol or read_protocol()
    if timeout is not None and not timeout > 0.0:
        raise ScenarioError(f"timeout {timeout!r} s: expected more than 0")
    for controller in controllers:
        if controller.fmu.endswith(".py"):
            # refuses a file without a block before the FMUs of others are built
            fmu_file(controller.fmu)
    if beside is None:
        beside = [tuned(protocol, name) for name in protocol.controllers if protocol.scales_gains]
    renamed = _with_other_names(controllers, beside)
    drawn = secrets.randbelow(LARGEST_SEED) if seed is None else seed
    scoring = Scoring(protocol, full, drawn, progress)
    rows = _rows(scoring, renamed, beside, timeout or protocol.tables.time_limit, workers)
    document = Score(
        made_by=f"l1-depth {version('l1-depth')}",
        seed=drawn,
        seed_is_given=seed is not None,
        protocol=protocol_info(protocol),
        rows=[row for row, _ in rows],
    )
    # the rows that are scored come first
    document.differences = differences(pair for pair in combinations(document.rows, 2) if pair[0].scored)
    return ScoreResult(document, {row.name: traces for row, traces in rows})


def run_count(controllers: int, protocol: Protocol, full: bool) -> int:
    """Returns the number of runs of a score with this number of controllers and the protocol's."""
    full_runs = protocol.tables.plants.count + sum(map(len, repeated(protocol, 0).values()))
    beside = len(protocol.controllers) if protocol.scales_gains else 0
    return (controllers + beside) * (len(protocol.cases) + full * full_runs)


def _with_other_names(controllers: Sequence[Controller], beside: Sequence[Controller]) -> list[Controller]:
    """Returns the controllers, renamed if one beside has the name; ScenarioError for two of one name."""
    taken = {controller.name for controller in beside}
    renamed = [replace(c, name=f"{c.name} (scored)") if c.name in taken else c for c in controllers]
    names = [controller.name for controller in (*renamed, *beside)]
    for name in names:
        if names.count(name) > 1:
            raise ScenarioError(f"two controllers are called {name!r}: expected different names")
    return renamed


def _rows(
    scoring: Scoring,
    scored: Sequence[Controller],
    beside: Sequence[Controller],
    timeout: float,
    workers: int,
) -> list[RowTraces]:
    """Returns the rows of the scored controllers, then of those beside them, and their traces."""
    nominal, makers = scoring.protocol.nominal, list[tuple[ClosedLoop, LimitedRuns]]()
    for fmu in (fmu for case in scoring.cases for fmu in case.layer.get("components", {}).values()):
        # before there are threads: only one thread may trace a block
        built(fmu)
    for controller in (*scored, *beside):
        limited = LimitedRuns(LocalRuns(1, isolate=True))
        loop = ClosedLoop(controller, scoring.protocol, limited, timeout)
        prepare(loop.scenario(nominal).system, loop.experiment(nominal))
        makers.append((loop, limited))
    with ExitStack() as stack:
        pool = stack.enter_context(ThreadPoolExecutor(workers))
        for _, limited in makers:
            stack.callback(limited.local.close)
        # registered last, so that it runs first: no thread begins another row
        stack.callback(pool.shutdown, wait=False, cancel_futures=True)
        futures = [pool.submit(scoring.row, *maker, i < len(scored)) for i, maker in enumerate(makers)]
        return [future.result() for future in futures]


def differences(pairs: Iterable[tuple[Row, Row]]) -> list[PairedDifference]:
    """Returns each pair of rows in each metric, plant by plant; each metric is corrected for their number."""
    known = [(first, second) for first, second in pairs if first.plants and second.plants]
    return [difference for metric in COMPARED for difference in _differences_in(metric, known)]


def _differences_in(metric: str, pairs: Sequence[tuple[Row, Row]]) -> list[PairedDifference]:
    compared = {
        (first.name, second.name): paired(_values(first, metric), _values(second, metric), len(pairs))
        for first, second in pairs
    }
    corrected = holm({names: comparison.p for names, comparison in compared.items()})
    return [
        PairedDifference(
            scored=names[0], other=names[1], metric=metric, p_holm=corrected[names], **vars(comparison)
        )
        for names, comparison in compared.items()
    ]


def _values(row: Row, metric: str) -> list[float]:
    return row.plants.metrics[metric].values if row.plants else []


START, TUNED = "start", "tuned"
PAPERS = f"{TUNED}/l1-pi"  # the paper's controller


def controllers(protocol: Protocol) -> list[Controller]:
    """Returns every controller of the protocol, tuned and with the start values of its FMU."""
    return [
        replace(with_gains(protocol, name), name=f"{which}/{name}")
        for which, with_gains in ((TUNED, tuned), (START, built_in))
        for name in protocol.controllers
    ]


def compare(protocol: Protocol, **options: Any) -> ScoreResult:
    """Returns the score of all, with `full` the differences of every pair of tuned controllers.

    options: of `score_controllers`
    Raises ScenarioError for a vehicle of unknown inertia, for which no tuned gains are scaled.
    """
    if not protocol.scales_gains:
        file = protocol.vehicle.file.path
        raise ScenarioError(
            f"{protocol.vehicle.name}: its inertia is not known: expected inertia in [variables] of {file}, "
            "which scales the tuned gains"
        )
    papers, *others = sorted(controllers(protocol), key=lambda controller: controller.name != PAPERS)
    result = score_controllers([papers], protocol, beside=others, **options)
    result.document.differences = differences(combinations(part(result.document, TUNED).rows, 2))
    return result


def for_page(result: ScoreResult) -> ScoreResult:
    """Returns the result with the gains of each row in its title, for a page that shows all rows together."""
    endings = {TUNED: "tuned", START: "default gains"}
    rows = [
        row.model_copy(update={"title": f"{row.title}, {endings[row.name.partition('/')[0]]}"})
        for row in result.document.rows
    ]
    return replace(result, document=result.document.model_copy(update={"rows": rows}))


def part(document: Score, which: str) -> Score:
    """Returns the rows of one kind; a table of them marks the best of its columns."""
    rows = [row for row in document.rows if row.name.startswith(f"{which}/")]
    return document.model_copy(update={"rows": rows})

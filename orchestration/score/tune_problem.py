"""The tuning of one controller: its free gains, what their cost depends on, and the file of those found."""

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import tomli_w

from fmus.files import write_text_atomically
from fmus.fmi.description import describe
from orchestration.errors import OrchestrationError
from orchestration.score.closed_loop import ClosedLoop, Controller
from orchestration.score.protocol import Protocol
from orchestration.score.tune import (
    LARGEST_IMPROVEMENT,
    LARGEST_SPREAD,
    LAST_PART,
    Problem,
    SearchResult,
    Tuning,
)
from orchestration.score.tune_cost import LARGEST, costs, practice_cases
from orchestration.score.tune_search import FreeGain, with_units
from orchestration.system.prepared_run import prepare


def problem_of(controller: Controller, protocol: Protocol, free: Iterable[FreeGain] = ()) -> Problem:
    """Returns the tuning of a controller, by default of the gains that the protocol has for it.

    Raises OrchestrationError for a controller that does not fit the vehicle, a value or a gain that its FMU
    cannot take, or a gain that is given a value for all evaluations.
    """
    case = practice_cases(protocol)[0]
    with ClosedLoop(controller, protocol) as loop:
        system = loop.scenario(case).system
        prepare(system, loop.experiment(case))
    components = system.components
    gains = with_units(list(free) or _of_protocol(controller, protocol), describe(components["controller"]))
    for gain in gains:
        if gain.name in controller.parameters:
            raise OrchestrationError(f"{gain.name}: it is set, and free: expected one of them")
    tuned = {
        "controller": repr(controller),
        "fmus": {name: _hash(path) for name, path in components.items()},
        "protocol": _what_costs(protocol),
    }
    return Problem(gains, tuned)


def _of_protocol(controller: Controller, protocol: Protocol) -> list[FreeGain]:
    table = protocol.controllers.get(controller.name)
    if table is None or table.fmu != controller.fmu:
        return []
    return [FreeGain(name, gain.low, gain.high) for name, gain in table.gains.items()]


def _what_costs(protocol: Protocol) -> dict[str, Any]:
    """Returns the part of the protocol that the cost depends on, as plain data."""
    data = protocol.file.data
    return {
        "version": protocol.version,
        "cost": data["cost"],
        "cases": {name: data["cases"][name] for name in data["cost"]["cases"]},
        **{key: data[key] for key in ("base", "trajectory", "practice_seeds")},
    }


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def provenance(tuning: Tuning, controller: Controller, protocol: Protocol) -> dict[str, Any]:
    """Returns what the file of a tuning has of the controller, the protocol and the cost.

    Raises OrchestrationError if every evaluation failed: then there are no gains to write.
    """
    best = tuning.best
    if best.cost >= LARGEST:
        raise OrchestrationError(
            f"{controller.name}: none of {tuning.evaluations} evaluations ran to its end: expected one that "
            f"does; the last failure: {best.metrics.get('failure', 'a cost that is not finite')}"
        )
    with ClosedLoop(controller, protocol) as loop:
        (every_seed,) = costs(loop, [best.gains], every_seed=True)
    table = protocol.tables.cost
    return {
        "controller": controller.name,
        "fmu": Path(controller.fmu).name,
        "league": controller.league,
        "protocol": protocol.version,
        "objective": f"mean {table.metric} over {', '.join(table.cases)}, practice seeds",
        "bounds": dict(table.bounds),
        "cost_of_every_practice_seed": every_seed["cost"],
    }


_CRITERION = (
    f"flat: the last {100 * LAST_PART:g} % of the search that begins at the best gains of all seeds lower "
    f"the cost by at most {100 * LARGEST_IMPROVEMENT:g} %; the seeds agree: most of them come within "
    f"{100 * LARGEST_SPREAD:g} % of the lowest"
)


def write(tuning: Tuning, fixed: Mapping[str, Any], provenance: Mapping[str, Any], path: Path) -> None:
    """Writes the gains of the best seed, and where the searches of all seeds ended.

    fixed: parameters that the tuning did not change, which belong to the law -> value
    provenance: plain data about the controller, the protocol and the cost
    """
    write_text_atomically(path, tomli_w.dumps(document(tuning, fixed, provenance)))


def document(tuning: Tuning, fixed: Mapping[str, Any], provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the content of the file."""
    best = tuning.best
    unchanged = {
        f"controller.{name}": {"value": value, "source": "fixed: what the law is, not tuned"}
        for name, value in fixed.items()
    }
    return {
        "tuning": {
            **provenance,
            "cost": best.cost,
            "is_flat": tuning.is_flat,
            "seeds_agree": tuning.seeds_agree,
            "criterion": _CRITERION,
            "improvement_in_the_last_part": tuning.improvement,
            "median_seed_above_the_lowest": tuning.spread,
            "optimiser": tuning.optimiser,
            "evaluations": tuning.evaluations,
            "metrics": dict(best.metrics),
            "seeds": [_seed(search) for search in tuning.searches],
            "refinement": _seed(tuning.refinement),
        },
        "parameters": {**unchanged, **_tuned_gains(tuning, str(provenance.get("protocol")))},
    }


def _tuned_gains(tuning: Tuning, protocol: str) -> dict[str, Any]:
    """Returns a table for each gain that was free."""
    best = tuning.best
    source = (
        f"tuned: cost {best.cost:.4g} cm of protocol {protocol}, {len(best.curve)} evaluations of each of "
        f"{len(tuning.searches)} seeds and from the best of them; not a published value"
    )
    return {
        f"controller.{gain.name}": {
            "value": best.gains[gain.name],
            "unit": gain.unit,
            "limits": [gain.low, gain.high],
            "at_a_limit": gain.is_at_a_limit(best.gains[gain.name]),
            "source": source,
        }
        for gain in tuning.problem.gains
    }


def _seed(search: SearchResult) -> dict[str, Any]:
    """Returns what a search ended at."""
    return {
        "seed": search.seed,
        "cost": search.cost,
        "evaluations": len(search.curve),
        "gains": dict(search.gains),
    }

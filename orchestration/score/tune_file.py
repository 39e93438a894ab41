"""The file of a tuning: gains for `parameter_files` of a scenario, and how far they can be trusted."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from fmus.files import write_text_atomically
from orchestration.score.tune import LARGEST_IMPROVEMENT, LARGEST_SPREAD, LAST_PART, SearchResult, Tuning

CRITERION = (
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
    """What the file contains."""
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
            "criterion": CRITERION,
            "improvement_in_the_last_part": tuning.improvement,
            "median_seed_above_the_lowest": tuning.spread,
            "optimiser": tuning.optimiser,
            "evaluations": tuning.evaluations,
            "figures": dict(best.figures),
            "seeds": [_seed(search) for search in tuning.searches],
            "refinement": _seed(tuning.refinement),
        },
        "parameters": {**unchanged, **_tuned_gains(tuning, str(provenance.get("protocol")))},
    }


def _tuned_gains(tuning: Tuning, protocol: str) -> dict[str, Any]:
    """A table for each gain that was free."""
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

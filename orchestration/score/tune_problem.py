"""What is tuned for one controller: its free gains, its cost, and what the cost depends on."""

import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from fmus.fmi.description import describe
from orchestration.errors import OrchestrationError
from orchestration.score.loop import Controller, Loop
from orchestration.score.protocol import Protocol
from orchestration.score.tune import Problem, Tuning
from orchestration.score.tune_cost import LARGEST, cost_of, practice_cases
from orchestration.score.tune_space import FreeGain, with_units
from orchestration.system.prepared_run import prepare


def problem_of(controller: Controller, protocol: Protocol, free: Iterable[FreeGain] = ()) -> Problem:
    """The tuning of a controller, by default of the gains that the protocol has for it.

    Raises OrchestrationError for a controller that does not fit the vehicle, a value or a gain that its FMU
    cannot take, or a gain that is given a value for all evaluations.
    """
    case = practice_cases(protocol)[0]
    with Loop(controller, protocol) as loop:
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
    """What the cost depends on of the protocol, as plain data."""
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
    """What the file of a tuning says of the controller, the protocol and the cost.

    Raises OrchestrationError if every evaluation failed: then there are no gains to write.
    """
    best = tuning.best
    if best.cost >= LARGEST:
        raise OrchestrationError(
            f"{controller.name}: none of {tuning.evaluations} evaluations ran to its end: expected one that "
            f"does; the last failure: {best.figures.get('failure', 'a cost that is not finite')}"
        )
    with Loop(controller, protocol) as loop:
        every_seed = cost_of(loop, best.gains, every_seed=True)
    table = protocol.tables.cost
    return {
        "controller": controller.name,
        "fmu": Path(controller.fmu).name,
        "league": controller.league,
        "protocol": protocol.version,
        "objective": f"mean {table.figure} over {', '.join(table.cases)}, practice seeds",
        "bounds": dict(table.bounds),
        "cost_of_every_practice_seed": every_seed["cost"],
    }

"""Evaluations as instances of ensembles, which step together; with the costs of evaluations one by one."""

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from queue import SimpleQueue
from typing import Any

from fmus.registry import fmu_folder
from orchestration.errors import EnsembleError, FmuWarning
from orchestration.many.ensemble_checks import check_ensemble
from orchestration.many.lane_library import LANES
from orchestration.score.figures_of_all import figures_of_all
from orchestration.score.isolated_loop import error_line
from orchestration.score.loop import Controller, Loop
from orchestration.score.protocol import Protocol
from orchestration.score.tune import Evaluate
from orchestration.score.tune_cost import (
    LARGEST,
    Gains,
    cost_of,
    cost_of_runs,
    figure_names,
    practice_cases,
)
from orchestration.score.tune_processes import processes


@contextmanager
def evaluations(controller: Controller, protocol: Protocol, workers: int, count: int) -> Iterator[Evaluate]:
    """So many evaluations side by side: by ensembles where they can be and that pays, else by processes."""
    with ExitStack() as stack:
        try:
            evaluate = stack.enter_context(ensembles(controller, protocol, workers, count))
        except EnsembleError:
            evaluate = stack.enter_context(processes(controller, protocol, workers))
        yield evaluate


@contextmanager
def ensembles(
    controller: Controller, protocol: Protocol, threads: int, count: int, is_asked_for: bool = False
) -> Iterator[Evaluate]:
    """So many threads, each with an ensemble of its own; EnsembleError where processes are to evaluate.

    count: of evaluations; is_asked_for: also where ensembles do not pay
    """
    with ExitStack() as stack:
        idle: SimpleQueue[Loop] = SimpleQueue()
        for _ in range(threads):
            loop = stack.enter_context(Loop(controller, protocol))
            _check_ensemble(loop, count, threads, is_asked_for)
            loop.ensemble(practice_cases(protocol)[0])
            idle.put(loop)
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("ignore", FmuWarning)  # of thousands of runs; results have the errors

        def costs(group: Sequence[Gains]) -> list[dict[str, Any]]:
            loop = idle.get()
            try:
                return costs_of_all(loop, group)
            finally:
                idle.put(loop)

        pool = stack.enter_context(ThreadPoolExecutor(threads))
        stack.callback(pool.shutdown, wait=False, cancel_futures=True)

        def evaluate(gains: Sequence[Gains]) -> Iterable[Mapping[str, Any]]:
            groups = [gains[first : first + LANES] for first in range(0, len(gains), LANES)]
            return (cost for group in pool.map(costs, groups) for cost in group)

        yield evaluate


def _check_ensemble(loop: Loop, count: int, threads: int, is_asked_for: bool) -> None:
    """EnsembleError for a controller or practice cases that processes are to evaluate."""
    cases = practice_cases(loop.protocol)
    system = loop.scenario(cases[0]).system
    if not (fmu := system.components["controller"]).is_relative_to(fmu_folder()):
        raise EnsembleError(f"{fmu} was not built here, and may need the time limit of a process")
    for case in cases:
        if loop.scenario(case).system != system:
            raise EnsembleError(f"{case.name} has another system than {cases[0].name}")
        check_ensemble(system, loop.experiment(case), count * len(cases), is_asked_for, threads=threads)


def costs_of_all(loop: Loop, gains: Sequence[Gains]) -> list[dict[str, Any]]:
    """`cost_of` of several gains; of those that give none, the largest cost and the reason."""
    cases, names = practice_cases(loop.protocol), figure_names(loop.protocol)
    runs = ([(case, loop.experiment(case, one)) for one in gains] for case in cases)
    figures = [figures_of_all(loop, of_case, names) for of_case in runs]
    costs: list[dict[str, Any]] = []
    for one, *runs in zip(gains, *figures, strict=True):
        complete = [(case.name, run) for case, run in zip(cases, runs, strict=True) if run is not None]
        try:
            is_complete = len(complete) == len(cases)
            costs.append(cost_of_runs(loop, one, complete) if is_complete else cost_of(loop, one))
        except Exception as error:  # whatever the reason, as in a process
            costs.append({"cost": LARGEST, "failure": error_line(error)})
    return costs

"""The figures of runs that step together, as instances of an ensemble."""

from collections.abc import Collection, Sequence
from contextlib import suppress
from typing import Any

from orchestration.errors import OrchestrationError
from orchestration.score.figures import figures_of
from orchestration.score.loop import Loop
from orchestration.score.protocol import Case
from orchestration.system.experiment import Experiment


def figures_of_all(
    loop: Loop, runs: Sequence[tuple[Case, Experiment]], names: Collection[str]
) -> list[dict[str, float] | None]:
    """The figures of each run; None for one that the loop is to run alone.

    That is one that fails, or whose figures do: the loop finds the reason. It is each where none differs: a
    group with one instance saves nothing.
    runs: of one system, with experiments that differ in values of parameters, inputs and signals alone
    """
    figures = list[dict[str, float] | None]([None] * len(runs))
    (first_case, first_experiment), varied = runs[0], _different([experiment for _, experiment in runs])
    if not varied:
        return figures
    try:
        recorded = loop.ensemble(first_case).run(first_experiment, varied)
    except OrchestrationError:  # of values that no instance can have
        return figures
    for instance in recorded.complete:
        case, experiment = runs[instance]
        with suppress(Exception):  # whatever the reason
            signals = loop.judged(case, experiment, recorded.run(instance))
            figures[instance] = figures_of(signals, case, loop.protocol, names)
    return figures


def _different(experiments: Sequence[Experiment]) -> dict[str, list[Any]]:
    """Name -> value in each experiment, but where all have the same object."""
    values = {
        name: [getattr(experiment, part)[name] for experiment in experiments]
        for part in ("parameters", "inputs", "signals")
        for name in getattr(experiments[0], part)
    }
    return {name: of_each for name, of_each in values.items() if any(v is not of_each[0] for v in of_each)}

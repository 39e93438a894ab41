"""What a score asks of one controller: functions of its `Loop`, which run in a process of their own."""

import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fmus.fmi.description import describe, of_causality
from orchestration.margins.fmu_margins import delay_margin
from orchestration.margins.hold import LoopSignal, last_part
from orchestration.results.recording import Recording
from orchestration.run.simulator import Simulator
from orchestration.score.figures import failures, figures_of
from orchestration.score.figures_of_all import figures_of_all
from orchestration.score.loop import OWN, Loop
from orchestration.score.protocol import Case
from orchestration.system.experiment import Experiment
from orchestration.system.system import System

_TRACED = ("depth", "reference", "u")
_TRACE_PERIOD_S = 0.5
_FEW_STEPS, _MANY_STEPS = 5_000, 200_000  # that are timed: many where few take a short time
_SHORT_S = 0.5
_REPETITIONS = 3
_TRUE_RATE = "measured_depth_rate"

Trace = dict[str, list[float]]
"""time [s], depth [m], reference [m] and u [N] of a run, every half second."""


@dataclass(frozen=True)
class ScoredRun:
    """Figures of a run, why it counts as failed, and what is drawn of it."""

    figures: dict[str, float]
    failed: list[str]
    trace: Trace = field(default_factory=dict)


def scored_run(loop: Loop, case: Case, names: Collection[str] = (), traced: bool = False) -> ScoredRun:
    """One run of a case, with all figures or those named."""
    signals = loop.run(case)
    figures = figures_of(signals, case, loop.protocol, names)
    return ScoredRun(figures, failures(figures, loop.protocol), _trace(signals) if traced else {})


def load_ensemble(loop: Loop, case: Case) -> None:
    """Compile what `scored_runs` needs, if it is not; EnsembleError if there can be no ensemble."""
    loop.ensemble(case)


def scored_runs(loop: Loop, cases: Sequence[Case], names: Collection[str]) -> list[ScoredRun | None]:
    """Runs of cases of one layer, in an ensemble; None for one that a simulator is to run alone."""
    runs = [(case, loop.experiment(case)) for case in cases]
    return [
        None if figures is None else ScoredRun(figures, failures(figures, loop.protocol))
        for figures in figures_of_all(loop, runs, names)
    ]


def _trace(signals: Recording) -> Trace:
    stride = max(1, round(_TRACE_PERIOD_S / (signals.time[1] - signals.time[0])))
    columns = {"time": signals.time, **{name: signals[name] for name in _TRACED}}
    return {name: np.round(column[::stride], 5).tolist() for name, column in columns.items()}


def uses_true_rate(loop: Loop, case: Case) -> bool:
    """Whether a run depends on the true depth rate, which no sensor of the vehicle measures."""
    controller = loop.controller
    variable = controller.variable(_TRUE_RATE)
    inputs = of_causality(describe(loop.scenario(case).system.components["controller"]), "input")
    if variable.removeprefix(OWN) not in {v.name for v in inputs}:
        return False
    without = replace(controller, settings={**controller.settings, variable: 0.0})
    with Loop(without, loop.protocol) as blind:
        return not np.array_equal(loop.run(case).values, blind.run(case).values)


def measured_delay_margin(loop: Loop, case: Case) -> float:
    """How much later [s] the measured depth may be while the case holds its target quietly.

    Of the first loss on a scan, as far as that goes. Not a number if it is not quiet as it is.
    """
    scenario = replace(loop.scenario(case), experiment=loop.experiment(case))
    hold = last_part("plant.depth", case.target.window[1])
    return delay_margin(scenario, LoopSignal.MEASUREMENT, hold=hold, only_first_loss=True).margin


def microseconds(loop: Loop, case: Case) -> float:
    """Processor time [us] of a communication step of the controller's FMU alone: the fastest of three runs.

    Its inputs keep their start values. The time of a short run is subtracted, which is that of the start.
    """
    loaded = loop.scenario(case)
    fmu = loaded.system.components["controller"]
    parameters = {n: v for n, v in loop.experiment(case).parameters.items() if n.startswith(OWN)}
    output = next(v.name for v in of_causality(describe(fmu), "output") if v.type != "String")
    step = loaded.experiment.step_size
    with Simulator(System({"controller": fmu})) as simulator:

        def duration(steps: int) -> float:
            experiment = Experiment(
                steps * step, step, parameters=parameters, record=(OWN + output,), open_inputs="start"
            )
            start = time.process_time()
            simulator.run(experiment)
            return time.process_time() - start

        many = _MANY_STEPS if duration(_FEW_STEPS) < _SHORT_S else _FEW_STEPS
        few = many // 10
        longer, shorter = (min(duration(steps) for _ in range(_REPETITIONS)) for steps in (many, few))
    return 1e6 * (longer - shorter) / (many - few)

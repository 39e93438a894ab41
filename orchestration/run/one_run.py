"""One run of a system."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import fields
from inspect import signature
from typing import Any, Never

from fmus.errors import nearest
from orchestration.errors import SystemDefinitionError
from orchestration.results.recording import Recording
from orchestration.run.checkpoint import Checkpoint, Checkpoints
from orchestration.run.simulator import Simulator
from orchestration.run.stepping import Progress
from orchestration.system.experiment import (
    AlgorithmName,
    Event,
    Experiment,
    InitialisationName,
    OpenInputsName,
    suggested_times,
)
from orchestration.system.faults import Fault
from orchestration.system.prepared_run import PreparedRun, prepare
from orchestration.system.signals import Signal
from orchestration.system.system import System
from orchestration.system.values import Value


def simulate(
    system: System,
    experiment: Experiment | None = None,
    progress: Progress | None = None,
    *,
    stop_time: float | None = None,
    step_size: float | None = None,
    start_time: float | None = None,
    algorithm: AlgorithmName = "jacobi",
    parameters: Mapping[str, Value] = {},
    inputs: Mapping[str, Value] = {},
    signals: Mapping[str, Signal] = {},
    events: Sequence[Event] = (),
    record: Sequence[str] = (),
    extrapolation: int = 0,
    step_sizes: Mapping[str, float] = {},
    tolerance: float | None = None,
    fmu_tolerance: float | None = None,
    initialisation: InitialisationName = "automatic",
    faults: Sequence[Fault] = (),
    open_inputs: OpenInputsName = "error",
    error_estimate: bool = False,
    timeout: float | None = None,
    real_time: float | None = None,
    checkpoints: Checkpoints | None = None,
    resume: Checkpoint | None = None,
    statistics: bool = False,
    **misspelt: Never,
) -> Recording:
    """Runs a system once and frees its FMUs.

        simulate(system, stop_time=10.0, step_size=0.01)

    experiment: in place of the settings stop_time .. error_estimate, which are those of `Experiment`
    stop_time, step_size, start_time: [s], by default as the FMUs suggest
    timeout: longest time [s] that a call of an FMU may take, a step for instance; the FMUs then run in a
    process of their own, so that one that hangs or crashes does no harm to this process
    progress, real_time, checkpoints, resume, statistics: see `Simulator.run`

    Raises SystemDefinitionError or FmuLoadError before the run starts, SimulationError afterwards: its
    `recording` holds the values recorded until then.
    """
    arguments = locals()
    if not isinstance(system, System):
        raise SystemDefinitionError(f"simulate: expected a System, got {system!r}")
    known = signature(simulate).parameters
    for name in misspelt:
        raise SystemDefinitionError(f"no setting {name!r}; {nearest(name, [*known][1:-1])}")
    names = [setting.name for setting in fields(Experiment)]  # the times first
    if experiment is None:
        times = suggested_times(system, stop_time, step_size, start_time)
        experiment = Experiment(*times, **{name: arguments[name] for name in names[3:]})
    else:
        given = [name for name in names if arguments[name] != known[name].default]
        if given:
            raise SystemDefinitionError(
                f"simulate: expected an experiment or its settings, got both: {', '.join(given)}"
            )
    options = {name: arguments[name] for name in ("real_time", "checkpoints", "resume", "statistics")}
    return simulate_prepared(system, prepare(system, experiment), progress, timeout, **options)


def simulate_prepared(
    system: System,
    prepared: PreparedRun,
    progress: Progress | None = None,
    timeout: float | None = None,
    fmus: ExitStack | None = None,
    **options: Any,
) -> Recording:
    """Runs what `prepare` made of this system; arguments and errors are those of `simulate`.

    fmus: frees the FMUs when it is closed; by default they are freed before this function returns
    """
    if timeout is not None:
        from orchestration.run.subprocess_run import simulate_in_subprocess  # few runs start processes

        return simulate_in_subprocess(system, prepared, timeout, progress, options)
    with ExitStack() as own:
        return (fmus or own).enter_context(Simulator(system)).run(prepared, progress, **options)

"""One run of a system."""

from collections.abc import Mapping, Sequence
from inspect import signature
from typing import Any, Never

from fmus.errors import nearest
from orchestration.errors import SystemDefinitionError
from orchestration.master.checkpoint import Checkpoint, Checkpoints
from orchestration.master.progress import Progress
from orchestration.master.simulator import Simulator
from orchestration.master.subprocess_run import simulate_in_subprocess
from orchestration.results.recording import Recording
from orchestration.system.experiment import (
    Algorithm,
    AlgorithmName,
    Event,
    Experiment,
    Initialisation,
    InitialisationName,
)
from orchestration.system.faults import Fault
from orchestration.system.settings import suggested_times
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
    algorithm: Algorithm | AlgorithmName = "jacobi",
    parameters: Mapping[str, Value] = {},
    inputs: Mapping[str, Value] = {},
    signals: Mapping[str, Signal] = {},
    events: Sequence[Event] = (),
    record: Sequence[str] = (),
    extrapolation: int = 0,
    step_sizes: Mapping[str, float] = {},
    tolerance: float | None = None,
    initialisation: Initialisation | InitialisationName = "automatic",
    faults: Sequence[Fault] = (),
    timeout: float | None = None,
    real_time: float | None = None,
    checkpoints: Checkpoints | None = None,
    resume: Checkpoint | None = None,
    **misspelt: Never,
) -> Recording:
    """Run a system once and free its FMUs.

        simulate(system, stop_time=10.0, step_size=0.01)

    experiment: in place of the settings stop_time .. faults, which are those of `Experiment`
    stop_time, step_size, start_time: [s], by default as the FMUs suggest
    timeout: longest time [s] that a call of an FMU may take, a step for instance; the FMUs then run in a
    process of their own, so that one that hangs or crashes does no harm to this process
    progress, real_time, checkpoints, resume: see `Simulator.run`

    Raises SystemDefinitionError or FmuLoadError before the run starts, SimulationError afterwards: its
    `recording` holds the values recorded until then.
    """
    if not isinstance(system, System):
        raise SystemDefinitionError(f"simulate: expected a System, got {system!r}")
    times = {"stop_time": stop_time, "step_size": step_size, "start_time": start_time}
    settings: dict[str, Any] = {
        "algorithm": algorithm,
        "parameters": parameters,
        "inputs": inputs,
        "signals": signals,
        "events": events,
        "record": record,
        "extrapolation": extrapolation,
        "step_sizes": step_sizes,
        "tolerance": tolerance,
        "initialisation": initialisation,
        "faults": faults,
    }
    known = signature(simulate).parameters
    for name in misspelt:
        raise SystemDefinitionError(f"no setting {name!r}; {nearest(name, [*known][1:-1])}")
    if experiment is None:
        experiment = Experiment(*suggested_times(system, **times), **settings)
    else:
        given = [name for name, value in {**times, **settings}.items() if value != known[name].default]
        if given:
            raise SystemDefinitionError(
                f"simulate: expected an experiment or its settings, got both: {', '.join(given)}"
            )
    if timeout is not None:
        options = {"real_time": real_time, "checkpoints": checkpoints, "resume": resume}
        return simulate_in_subprocess(system, experiment, timeout, progress, options)
    with Simulator(system) as simulator:
        return simulator.run(
            experiment, progress, real_time=real_time, checkpoints=checkpoints, resume=resume
        )

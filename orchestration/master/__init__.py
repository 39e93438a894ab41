"""The master algorithm: connects FMI 2.0 co-simulation FMUs and steps them together.

Communication points are t_i = start + i h, never accumulated; a last shorter step lands on the stop
time. At each point: scheduled changes are made, outputs are exchanged and recorded.

    Jacobi         every component steps from t_i to t_{i+1} with the outputs of t_i
    Gauss-Seidel   in the order of the components, each with the newest outputs there are

Inputs are held over a step, first order in h, or carried on by their last slope, second order.

    simulator.py       FMUs that stay loaded, and runs of them
    initialisation.py  initial values
    wiring.py          a system and an experiment as arrays
    loop.py            the communication loop over these arrays, compiled
    stepping.py        from the first point to the last, with events and progress
    between.py         shorter steps: after a discard, and to meet a tolerance
    snapshot.py, checkpoint.py  the system at one point, in memory and as a file
    pacing.py, interrupt.py, failure.py             what their names say
"""

from typing import Any

from orchestration.errors import SystemDefinitionError
from orchestration.master.checkpoint import Checkpoint, Checkpoints
from orchestration.master.simulator import Simulator
from orchestration.master.stepping import Progress
from orchestration.master.subprocess_run import simulate_apart
from orchestration.results.recording import Recording
from orchestration.system.experiment import Experiment
from orchestration.system.settings import experiment_of
from orchestration.system.system import System

__all__ = ["Simulator", "simulate"]


def simulate(
    system: System,
    experiment: Experiment | None = None,
    progress: Progress | None = None,
    *,
    timeout: float | None = None,
    real_time: float | None = None,
    checkpoints: Checkpoints | None = None,
    resume: Checkpoint | None = None,
    **settings: Any,
) -> Recording:
    """One run of a system; every FMU is freed at its end.

        simulate(system, stop_time=10.0, step_size=0.01)

    settings: of the `Experiment`, if none is given; of stop time and step size, what is not among them is
    what the FMUs suggest
    timeout: longest time [s] that a call of an FMU may take, a step for instance; the FMUs then run in a
    process of their own, and one that hangs or crashes takes nothing with it
    Other arguments, and errors: as of `Simulator.run`.
    """
    if not isinstance(system, System):
        raise SystemDefinitionError(f"simulate: expected a System, got {system!r}")
    options = {"real_time": real_time, "checkpoints": checkpoints, "resume": resume}
    if experiment and settings:
        raise SystemDefinitionError("simulate: expected an experiment, or its settings such as stop_time")
    chosen = experiment or experiment_of(system, settings, [*options, "timeout", "progress"])
    if timeout is not None:
        return simulate_apart(system, chosen, timeout, progress, options)
    with Simulator(system) as simulator:
        return simulator.run(chosen, progress, **options)

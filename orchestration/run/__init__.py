"""The compiled master algorithm: connects FMUs for co-simulation, FMI 2.0 or 3.0, and steps them together.

Communication points are t_i = start + i h, never accumulated; a last shorter step lands on the stop
time. At each point: scheduled changes are made, outputs are exchanged and recorded.

    Jacobi         every component steps from t_i to t_{i+1} with the outputs of t_i
    Gauss-Seidel   in the order of the components, each with the newest outputs there are

Inputs are held over a step, first order in h, or extrapolated with their last slope, second order.

    `simulate`         one run to its end, with every setting as an argument
    simulator.py       FMUs that stay loaded, and runs of them
    run.py, access.py  a run: it advances, reads, sets, saves and restores; its saved states
    initialisation.py  initial values
    wiring.py, bus.py, loop_data.py  a prepared run as arrays
    loop.c             the communication loop over these arrays; compiled_loop.py calls it, also on threads
    step_control.py, tolerance.py  shorter steps: after a discard, and to meet a tolerance
    error_estimate.py  how far exchanging at communication points leads astray, by a second run
    checkpoint.py      the system at one point as a file
    run_recording.py   the recording, errors and warnings of a run; the times of its phases, and real time
    subprocess_run.py  a run whose FMUs are in a process of their own
    process_guard.py   interrupts, floating-point mode, an end by `exit`, forked children
"""

from contextlib import ExitStack
from inspect import signature
from typing import Any, Unpack

from fmus.errors import nearest
from orchestration.errors import SystemDefinitionError
from orchestration.results.recording import Recording
from orchestration.run.checkpoint import Checkpoint, Checkpoints
from orchestration.run.run import Progress
from orchestration.run.simulator import Simulator
from orchestration.system.experiment import Experiment, ExperimentSettings, suggested_times
from orchestration.system.prepared_run import PreparedRun, prepare
from orchestration.system.system import System

__all__ = ["Progress", "Simulator", "simulate"]

_TIMES = ("stop_time", "step_size", "start_time")
_USUAL = {**vars(Experiment(1.0, 1.0)), **dict.fromkeys(_TIMES)}
"""Setting -> what it is where it is not given."""


def simulate(
    system: System,
    experiment: Experiment | None = None,
    progress: Progress | None = None,
    *,
    timeout: float | None = None,
    real_time: float | None = None,
    checkpoints: Checkpoints | None = None,
    resume: Checkpoint | None = None,
    statistics: bool = False,
    **settings: Unpack[ExperimentSettings],
) -> Recording:
    """Runs a system once and frees its FMUs: `simulate(system, stop_time=10.0, step_size=0.01)`.

    Parameters
    ----------
    system : System
        FMUs and their connections.
    experiment : Experiment, optional
        Times, inputs, and how components exchange values.
    progress, real_time, checkpoints, resume, statistics
        See `Simulator.run`.
    timeout : float, optional
        Longest time [s] of a call of an FMU, such as a step. The FMUs then run in a separate process, so that
        one that hangs or crashes does no harm to this process.
    **settings
        Settings of `Experiment`, in place of `experiment`. Times [s] are by default as the FMUs suggest.

    Returns
    -------
    Recording
        The recorded variables at the communication points.

    Raises
    ------
    SystemDefinitionError, FmuLoadError
        Before the run starts, for a system or settings that do not fit.
    SimulationError
        For a run that ends early: its `recording` holds the values until then.

    Examples
    --------
    >>> from orchestration import load_scenario
    >>> scenario = load_scenario("nominal-extended")
    >>> recording = simulate(scenario.system, scenario.experiment)
    >>> recording["plant.depth"].shape
    (15501,)
    """
    if not isinstance(system, System):
        raise SystemDefinitionError(f"simulate: expected a System, got {system!r}")
    given: dict[str, Any] = {**settings}
    known = {*ExperimentSettings.__annotations__, *signature(simulate).parameters} - {"system", "settings"}
    for name in (name for name in given if name not in known):
        raise SystemDefinitionError(f"no setting {name!r}; {nearest(name, known)}")
    if experiment is None:
        times = suggested_times(system, *(given.pop(name, None) for name in _TIMES))
        experiment = Experiment(*times, **given)
    elif both := [name for name, usual in _USUAL.items() if given.get(name, usual) != usual]:
        raise SystemDefinitionError(
            f"simulate: expected an experiment or its settings, got both: {', '.join(both)}"
        )
    how = {"real_time": real_time, "checkpoints": checkpoints, "resume": resume, "statistics": statistics}
    return simulate_prepared(system, prepare(system, experiment), progress, timeout, **how)


def simulate_prepared(
    system: System,
    prepared: PreparedRun,
    progress: Progress | None = None,
    timeout: float | None = None,
    fmus: ExitStack | None = None,
    **options: Any,
) -> Recording:
    """Runs what `prepare` made of this system; arguments and errors as in `simulate`.

    fmus: frees the FMUs when it is closed; by default they are freed before this function returns
    """
    if timeout is not None:
        # imported here: few runs start processes
        from orchestration.run.subprocess_run import simulate_in_subprocess

        return simulate_in_subprocess(system, prepared, timeout, progress, options)
    with ExitStack() as own:
        return (fmus or own).enter_context(Simulator(system)).run(prepared, progress, **options)

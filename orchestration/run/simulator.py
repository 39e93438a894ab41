"""A system whose FMUs stay loaded, and the runs that it makes."""

import os
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, chdir, contextmanager
from dataclasses import replace
from typing import Any, Self

import numpy as np

from fmus.fmi.description import describe
from fmus.fmi.instance import FmuInstance
from orchestration.errors import FmuLoadError, OrchestrationError, SimulationError, SystemDefinitionError
from orchestration.results.recording import Recording
from orchestration.run.checkpoint import Checkpoint, Checkpoints, check_can_save, restore
from orchestration.run.compiled_loop import compiled_loop
from orchestration.run.error_estimate import with_error_estimate
from orchestration.run.loop_data import Report, Storage
from orchestration.run.process_guard import ProcessGuard, deferred_interrupt, new_report
from orchestration.run.run import Progress, Run
from orchestration.run.run_recording import Pacing, RunStatistics, reason_of
from orchestration.run.wiring import WiredRun, build_wiring
from orchestration.system.experiment import Experiment
from orchestration.system.prepared_run import PreparedRun, PreparedRuns, check_for
from orchestration.system.system import CheckedSystem, System


class LoadedSystem:
    """A system, its FMUs while they are loaded, and what is known of it from earlier runs.

    Raises FmuLoadError for a file that is no FMU.
    """

    def __init__(self, system: System) -> None:
        self.system = system
        self._descriptions = {name: describe(path) for name, path in system.components.items()}
        self._loaded = ExitStack()
        self._instances: dict[str, FmuInstance] = {}
        self._must_reload = False
        self._running = threading.Lock()
        self._prepared_runs = PreparedRuns()
        self._checked: dict[tuple[tuple[str, ...], str], CheckedSystem] = {}

    def _check(self, experiment: Experiment, external: Sequence[str] = ()) -> CheckedSystem:
        """Returns the checked system, the same for the same inputs.

        external: inputs that the caller sets between the steps
        """
        key = (*experiment.driven_inputs, *external), experiment.open_inputs
        if key not in self._checked:
            self._checked[key] = check_for(self.system, experiment, external, self._descriptions)
        return self._checked[key]

    @contextmanager
    def _begin_run(self) -> Iterator[None]:
        """Refuses another run meanwhile."""
        if not self._running.acquire(blocking=False):
            kind = type(self).__name__.lower()
            raise OrchestrationError(f"this {kind} is running: expected another one for a run meanwhile")
        try:
            yield
        finally:
            self._running.release()

    def _load_or_reset(self) -> None:
        """Loads the FMUs that are not loaded, and resets the used ones."""
        if self._must_reload or not all(x.is_fresh or x.reset() for x in self._instances.values()):
            self.close()
        if not self._instances:
            with ExitStack() as loading:
                instances = {name: self._load(name, loading) for name in self._descriptions}
                self._instances, self._loaded = instances, loading.pop_all()

    def _load(self, name: str, loading: ExitStack) -> FmuInstance:
        path, description = self.system.components[name], self._descriptions[name]
        if not description.is_model_exchange:
            return loading.enter_context(FmuInstance(name, path, description))
        try:
            # imported here: FMPy takes time to import
            from fmus.fmi.model_exchange import ModelExchangeInstance
        except (ImportError, OSError) as error:
            raise FmuLoadError(
                f"{path} is for model exchange alone, for which CVode lacks: {error}"
            ) from error
        return loading.enter_context(ModelExchangeInstance(name, path, description))

    def close(self) -> None:
        """Frees every instance; the next run loads them again."""
        self._instances, self._must_reload = {}, False
        self._loaded.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class Simulator(LoadedSystem):
    """A system whose FMUs stay loaded over many runs, made at once or step by step; a context manager.

    The FMUs are loaded for the first run and reset for the next; after a failure they are loaded anew.

    Parameters
    ----------
    system : System
        FMUs and their connections.
    threads : int, optional
        Number of threads that step the FMUs of a Jacobi run, with the same results. By default as many as
        make `run` faster by measurement, and one for FMUs that may share memory. A run that the caller steps
        has one thread.

    Raises
    ------
    FmuLoadError
        For a file that is no FMU.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from orchestration import load_scenario
    >>> scenario = load_scenario("nominal-extended")
    >>> experiments = [replace(scenario.experiment, stop_time=stop) for stop in (1.0, 2.0)]
    >>> with Simulator(scenario.system) as simulator:
    ...     [float(simulator.run(experiment).time[-1]) for experiment in experiments]
    [1.0, 2.0]
    """

    _loop = staticmethod(compiled_loop)

    def __init__(self, system: System, threads: int | None = None) -> None:
        if threads is not None and threads < 1:
            raise OrchestrationError(f"threads: {threads}: expected at least 1")
        super().__init__(system)
        self._threads = threads
        self._guard: ProcessGuard | None = None
        self._last_run: Run | None = None  # until another one begins
        self._first_batch = 1
        self._wired: WiredRun | None = None  # of the run before

    def run(
        self,
        run: Experiment | PreparedRun,
        progress: Progress | None = None,
        *,
        real_time: float | None = None,
        checkpoints: Checkpoints | None = None,
        resume: Checkpoint | None = None,
        storage: Storage | None = None,
        statistics: bool = False,
    ) -> Recording:
        """Runs an experiment, or one that is prepared for this system, and returns its recording.

        Parameters
        ----------
        run : Experiment or PreparedRun
            The experiment.
        progress : callable, optional
            Called some ten times a second with the communication points done, and all of the run; also by the
            second run of an error estimate, which has half as many points.
        real_time : float, optional
            Simulated seconds in a second of the wall clock; by default as fast as possible.
        checkpoints : Checkpoints, optional
            Where and how often to save the whole system.
        resume : Checkpoint, optional
            A checkpoint of the same run, from which to continue.
        storage : Storage, optional
            Arrays of the loop that another process reads during the run.
        statistics : bool
            Whether the provenance gets the wall time of each phase and of the steps of each FMU.

        Returns
        -------
        Recording
            The recorded variables at the communication points.

        Raises
        ------
        SystemDefinitionError, FmuLoadError
            Before the run starts.
        SimulationError
            Afterwards; its `recording` holds the values until then.
        """
        with self._begin_run():
            pacing = None if real_time is None else Pacing(real_time)
            if checkpoints or resume:
                check_can_save(run.system if isinstance(run, PreparedRun) else self._check(run))
            measured = RunStatistics(self._descriptions, statistics)
            # the watching process finds one busy component in the report: one thread steps
            threads = self._threads if storage is None else 1
            begun = self._begin(run, (), storage, measured, threads=threads, pacing=pacing)
            begun.batch = self._first_batch
            _run_to_end(begun, progress, checkpoints, resume)
            recording = begun.recorded(is_final=storage is None)
            # halved: the next run may be slower, and an interrupt waits for a batch
            self._first_batch = max(1, begun.batch // 2)
            self._must_reload = False
        if not begun.prepared.experiment.error_estimate:
            return recording
        return with_error_estimate(recording, begun.prepared, lambda coarser: self.run(coarser, progress))

    def start(self, experiment: Experiment, external: Sequence[str] = ()) -> Run:
        """Initialises the system for an experiment, at its start time; the caller leads the run.

        Parameters
        ----------
        experiment : Experiment
            The experiment.
        external : sequence of str
            Inputs that the caller sets between the steps. They begin with their value in `experiment.inputs`,
            or the FMU's start value, are held over a step, and are recorded.

        Returns
        -------
        Run
            The run at its first communication point.

        Raises
        ------
        SystemDefinitionError
            Also for an error estimate: its second run is made by the whole experiment again.
        FmuLoadError, SimulationError
            As `run` does.
        """
        if experiment.error_estimate:
            raise SystemDefinitionError(
                "error_estimate of a run that the caller leads: expected False, or run(experiment)",
                ("experiment", "error_estimate"),
            )
        with self._begin_run():
            run = self._begin(experiment, tuple(external))
            try:
                with deferred_interrupt():
                    run.initialise()
            except KeyboardInterrupt as error:
                raise SimulationError(reason_of(error), run.recorded()) from error
            self._must_reload = False
            return run

    @contextmanager
    def _begin_run(self) -> Iterator[None]:
        """Ends the run before, which an FMU that crashes then cannot lose; refuses another one meanwhile."""
        with super()._begin_run():
            self._end_last_run()
            with chdir(os.curdir):
                # restores the folder: after an FMU changes it, relative paths would lead elsewhere
                yield

    def _end_last_run(self) -> None:
        if self._last_run:
            self._must_reload = self._must_reload or bool(self._last_run.failure)
            self._last_run.close()
            self._last_run = None

    def _begin(
        self,
        run: Experiment | PreparedRun,
        external: tuple[str, ...],
        storage: Storage | None = None,
        statistics: RunStatistics | None = None,
        **settings: Any,
    ) -> Run:
        """Checks an experiment, loads or resets the FMUs and wires them; returns the run, not initialised.

        settings: of `Run`
        """
        statistics = statistics or RunStatistics((), is_asked_for=False)
        if isinstance(run, PreparedRun):
            # this run was prepared elsewhere: the next one is not compared with it
            self._prepared_runs = PreparedRuns()
            prepared = run.copy()
        else:
            prepared = self._prepared_runs.prepare(self._check(run, external), run, external)
        earlier = self._wired if self._prepared_runs.only_values_differ else None
        # forgotten also if this run is never wired: it belongs to an earlier one
        self._wired = None
        rows, report = (storage.rows, storage.report) if storage else (np.empty(prepared.shape), new_report())
        storage = Storage(rows, report, statistics.steps)
        if self._guard:
            self._guard.close()
        guard = self._guard = ProcessGuard(self.system.components, storage.report)
        self._report = storage.report
        # a reset counts as a call of this run: a timeout watches it
        for instance in self._instances.values():
            instance.busy, instance.after_call = storage.report[Report.BUSY :], guard.end_call
        with statistics.phase("loading"):
            self._load_or_reset()
        # stays set if anything fails before the run is done: the FMUs' state is then unknown
        self._must_reload = True
        storage.report[Report.BUSY] = 0
        for instance in self._instances.values():
            instance.after_call = guard.end_call
        if earlier and earlier.instances is self._instances:
            wired = earlier.again(prepared, storage)
        else:
            wired = build_wiring(prepared, self._instances, storage, self._loop)
        # `again` needs all but the record, which takes most memory
        self._wired = replace(wired, wiring=wired.wiring._replace(rows=np.empty((0, 0))))
        self._last_run = Run(wired, guard, statistics, **settings)
        return self._last_run

    def _load(self, name: str, loading: ExitStack) -> FmuInstance:
        assert self._guard
        self._report[Report.BUSY] = -1 - list(self._descriptions).index(name)
        instance = super()._load(name, loading)
        self._guard.restore(name)
        return instance

    @property
    def warned(self) -> list[str]:
        """The components whose FMUs returned warnings in the last run."""
        return [name for name, instance in self._instances.items() if instance.has_warned]

    def close(self) -> None:
        """Frees every instance; the next run loads them again."""
        self._end_last_run()
        super().close()
        if self._guard:
            self._guard.close()


def _run_to_end(
    run: Run, progress: Progress | None, checkpoints: Checkpoints | None, resume: Checkpoint | None
) -> None:
    """Initialises or restores a run, and runs it to its end. SimulationError holds what was recorded."""
    try:
        with deferred_interrupt():
            run.initialise()
            if resume:
                restore(resume, run)
            run.statistics.start_time = run.time
            if checkpoints:
                checkpoints.save_until_done(run, progress)
            else:
                run.advance(progress=progress)
    except KeyboardInterrupt as error:
        run.record_now()
        saved = checkpoints.save_interrupted(run) if checkpoints else ""
        raise SimulationError(reason_of(error) + saved, run.recorded()) from error
    except SimulationError:
        raise
    except Exception as error:
        # a checkpoint that cannot be written or read
        raise run.failed(error) from error

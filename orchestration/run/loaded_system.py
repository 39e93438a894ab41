"""A system whose FMUs stay loaded from run to run: what `Simulator` and `Ensemble` have in common."""

import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import ClassVar, Self

from fmus.fmi.description import describe
from fmus.fmi.instance import FmuInstance
from orchestration.errors import OrchestrationError
from orchestration.system.experiment import Experiment
from orchestration.system.prepared_run import PreparedRuns, check_for
from orchestration.system.system import CheckedSystem, System


class LoadedSystem:
    """A system, its FMUs while they are loaded, and what is known of it from earlier runs.

    Raises FmuLoadError for a file that is no FMU.
    """

    _kind: ClassVar[str]  # in messages

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
            kind = self._kind
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
        instance = FmuInstance(name, self.system.components[name], self._descriptions[name])
        return loading.enter_context(instance)

    def close(self) -> None:
        """Frees every instance; the next run loads them again."""
        self._instances, self._must_reload = {}, False
        self._loaded.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

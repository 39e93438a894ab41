"""Runs that differ in parameters and constant inputs alone, as samples of a sweep, are prepared once."""

from collections.abc import Mapping

from orchestration.system.experiment import Experiment
from orchestration.system.prepared_run import PreparedRun, prepare_checked
from orchestration.system.signals import Constant, Cosine, Ramps
from orchestration.system.system import CheckedSystem

_MOST_STEPS = 100_000  # whose times and signals stay in memory
_IMMUTABLE = (Constant, Cosine, Ramps)  # signals that cannot have changed if they are equal
_VALUES = ("parameters", "inputs")


class PreparedRuns:
    """Prepares run after run, as `prepare_checked`.

    only_values_differ: whether the last one is as the one before but for values of parameters and constant
    inputs
    """

    only_values_differ = False

    def __init__(self) -> None:
        self._first: PreparedRun | None = None
        self._key: str | None = None

    def prepare(
        self, system: CheckedSystem, experiment: Experiment, external: tuple[str, ...] = ()
    ) -> PreparedRun:
        """The prepared run; arrays of its own, which a run may change."""
        key = _key(system, experiment) if not external else None
        self.only_values_differ = key is not None and key == self._key
        if not (self.only_values_differ and self._first):
            self._key, self._first = None, None  # should anything be refused
            first = prepare_checked(system, experiment, external)
            if key is None:
                return first
            self._key, self._first = key, first
        return self._first.with_values(experiment)


def _key(system: CheckedSystem, experiment: Experiment) -> str | None:
    """What two runs have in common that differ in values alone; None where equal things may have changed.

    As text, in which 0 and -0 differ.

    A system is checked with the inputs that an experiment drives: the same one has the same inputs.
    """
    signals = experiment.signals.values()
    can_change = experiment.events or experiment.faults or any(type(s) not in _IMMUTABLE for s in signals)
    if can_change or experiment.step_count > _MOST_STEPS:
        return None
    rest = (value for name, value in vars(experiment).items() if name not in _VALUES)
    copies = (tuple(value.items()) if isinstance(value, Mapping) else value for value in rest)
    return repr((id(system), *copies))

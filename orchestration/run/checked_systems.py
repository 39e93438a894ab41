"""A system checked with the inputs that experiments drive, once for the same inputs."""

from collections.abc import Mapping, Sequence

from fmus.fmi.model_description import ModelDescription
from orchestration.run.initialisation import ConnectionGroup, connection_groups
from orchestration.system.experiment import Experiment
from orchestration.system.open_inputs import OpenInputs
from orchestration.system.system import CheckedSystem, System, check

_Checked = tuple[CheckedSystem, tuple[ConnectionGroup, ...]]


class CheckedSystems:
    """The checked systems, with their groups of initial values, of experiments with one system."""

    def __init__(self, system: System, descriptions: Mapping[str, ModelDescription]) -> None:
        self._system, self._descriptions = system, descriptions
        self._checked: dict[tuple[tuple[str, ...], str], _Checked] = {}

    def check(self, experiment: Experiment, external: Sequence[str] = ()) -> _Checked:
        """That of an experiment; SystemDefinitionError for what does not fit.

        external: inputs that the caller sets between the steps
        """
        driven = (
            *experiment.driven_inputs,
            *(name for name in external if name not in experiment.inputs),
        )
        key = driven, experiment.open_inputs
        if key not in self._checked:
            system = check(self._system, driven, self._descriptions, OpenInputs(experiment.open_inputs))
            self._checked[key] = system, connection_groups(system)
        return self._checked[key]

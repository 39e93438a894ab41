"""Whether an ensemble runs instances of an experiment, or simulators one after another."""

from collections.abc import Sequence

from fmus.fmi.description import describe, is_independent
from fmus.native.lanes import LANES
from fmus.platforms import instruction_sets
from orchestration.errors import EnsembleError
from orchestration.many.ensemble_checks import check_supported
from orchestration.many.lane_library import is_compiled
from orchestration.run.initialisation import connection_groups
from orchestration.system.experiment import Experiment
from orchestration.system.prepared_run import check_for, prepare_checked
from orchestration.system.system import System

_MOST_BYTES = 2**28  # of recorded values of the groups of all threads
_STEPS_WORTH_COMPILING = (
    1e7  # each costs 0.25 us more an FMU in a Simulator; to compile an FMU takes 2 to 3 s
)


def check_ensemble(
    system: System,
    experiment: Experiment,
    instances: int,
    is_asked_for: bool = False,
    external: Sequence[str] = (),
    threads: int = 1,
) -> int:
    """Bytes of the values that a group of an ensemble records.

    instances: how many are run in all; is_asked_for: also where it does not pay
    external: inputs that the caller sets between the steps; FMUs are then compiled only if it is asked for
    threads: how many run a group at a time
    Raises EnsembleError, which says why simulators run them: an ensemble cannot, or it does not pay.
    """
    descriptions = {name: describe(path) for name, path in system.components.items()}
    for name, description in descriptions.items():
        if not is_independent(description):
            raise EnsembleError(f"{name} is no native FMU that l1-depth build wrote for this user")
    checked = check_for(system, experiment, external, descriptions)
    prepared = prepare_checked(checked, experiment, external)
    check_supported(prepared, connection_groups(checked))
    points, columns = prepared.shape
    group_bytes = 8 * LANES * points * columns
    if not is_asked_for:
        steps = 0 if external else instances * experiment.step_count  # as far as known
        _check_pays(system, instances, steps, group_bytes, threads)
    return group_bytes


def _check_pays(system: System, instances: int, steps: int, group_bytes: int, threads: int) -> None:
    """EnsembleError where simulators run as fast, or in much less memory."""
    if instances < LANES:
        raise EnsembleError(f"{instances} runs are less than the {LANES} that step at once")
    if (n_bytes := threads * group_bytes) > _MOST_BYTES:
        raise EnsembleError(f"{threads * LANES} runs at once record {n_bytes / 1e6:.0f} MB")
    best = instruction_sets()[0]
    if steps < _STEPS_WORTH_COMPILING and not all(is_compiled(p, best) for p in system.components.values()):
        raise EnsembleError(f"to compile the FMUs takes longer than {steps} steps save")

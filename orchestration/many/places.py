"""Places where many runs are made, by name: on this machine, and installed ones."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

from fmus import registry
from fmus.errors import nearest
from fmus.operating_system import usable_processors
from orchestration.errors import EnsembleError

if TYPE_CHECKING:
    from orchestration.many.ensemble_loop import Device
    from orchestration.many.job import Place

AUTO = "auto"
"""In threads of this process, in vectors where that pays; FMUs that may disturb others in processes."""
PROCESSOR, VECTORS, PROCESSES = "processor", "vectors", "processes"
LOCAL: Mapping[str, Mapping[str, Any]] = {
    AUTO: {},
    PROCESSOR: {"vectorise": False},
    VECTORS: {"vectorise": True},
    PROCESSES: {"isolate": True},
}
"""Places on this machine -> arguments of `LocalRuns`."""


def place_of(
    where: str, workers: int | None = None, note: Callable[[str], object] = lambda text: None
) -> "AbstractContextManager[Place]":
    """Returns a place of runs; EnsembleError for one that is not installed, and what opens it may raise.

    where: "auto"; "processor", one by one in each thread; "vectors", in which native FMUs of this exporter
    step together, with the same results; "processes", in which all FMUs are isolated; or an installed place
    (entry point of the group `l1_depth.places`) by the text before a colon: "gpu" of this machine, or the
    address of a Dask scheduler, tcp://HOST:PORT
    workers, note: of `LocalRuns`; by default a worker for each processor. A cluster has its own workers

    An installed place is a function of `where`, `workers` and `note`; it returns a context manager that
    yields a `Place` (`orchestration.many.job`), or `LocalRuns` with a device.
    """
    if where in LOCAL:
        from orchestration.many.local_runs import LocalRuns  # commands take their names from this file

        return LocalRuns(workers or usable_processors(), **LOCAL[where], note=note)
    places = registry.installed(registry.PLACES)
    name = where.partition(":")[0]
    if name not in places:
        address = "; the address of a scheduler is tcp://HOST:PORT" * (":" in where)
        raise EnsembleError(f"no place {where!r} for runs; {nearest(name, [*LOCAL, *places])}{address}")
    return places[name].load()(where, workers, note)


def device_of(where: str) -> "Device | None":
    """Returns the device of a place, None for this processor.

    Raises EnsembleError for another process, and what opens the place may raise.
    """
    from orchestration.many.local_runs import LocalRuns

    place = place_of(where)
    if where == PROCESSES or not isinstance(place, LocalRuns):
        raise EnsembleError(f"where = {where!r}: expected a place in this process")
    return place.device

"""The workers of a Dask cluster that is there already."""

from collections.abc import Iterator
from contextlib import contextmanager

from fmus.extras import imports_of
from orchestration.errors import SweepError
from orchestration.sweep.dask_workers import DaskWorkers

with imports_of("sweep", "a sweep"):
    from distributed import Client

PATIENCE_S = 30.0  # for a scheduler to answer and for its first worker


@contextmanager
def remote(address: str) -> Iterator[DaskWorkers]:
    """The workers of a scheduler somewhere, such as tcp://host:8786."""
    try:
        client = Client(address, timeout=PATIENCE_S, name="l1-depth sweep")
    except (OSError, ValueError) as error:
        raise SweepError(f"no Dask scheduler at {address}: {error}") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE_S)
        except TimeoutError:
            raise SweepError(f"the scheduler at {address} has no workers: expected one or more") from None
        yield DaskWorkers(client)

"""The workers of a Dask cluster: one that is there already, or one of this machine."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from tempfile import TemporaryDirectory

from fmus.extras import imports_of
from orchestration.errors import SweepError
from orchestration.sweep.dask_workers import DaskWorkers
from orchestration.sweep.worker import IgnoreSigint

with imports_of("sweep", "a sweep"):
    from dask import config
    from distributed import Client, LocalCluster

_PATIENCE_S = 30.0  # for a scheduler to answer and for its first worker


@contextmanager
def local(workers: int) -> Iterator[DaskWorkers]:
    """So many processes of one thread each, reachable from this machine alone, to try what a cluster does.

    Without a cluster, `orchestration.sweep.local` starts sooner and needs less.
    """
    with (
        TemporaryDirectory(prefix="l1-depth-sweep-", ignore_cleanup_errors=True) as folder,
        config.set({"temporary-directory": folder}),  # of all of Dask, not of its workers alone
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",  # with None it would be on every network
            memory_limit=None,
            local_directory=folder,
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster) as client,
    ):
        client.register_plugin(IgnoreSigint())
        yield DaskWorkers(client)


@contextmanager
def remote(address: str) -> Iterator[DaskWorkers]:
    """The workers of a scheduler somewhere, such as tcp://host:8786."""
    try:
        client = Client(address, timeout=_PATIENCE_S, name="l1-depth sweep")
    except (OSError, ValueError) as error:
        raise SweepError(f"no Dask scheduler at {address}: {error}") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_PATIENCE_S)
        except TimeoutError:
            raise SweepError(f"the scheduler at {address} has no workers: expected one or more") from None
        yield DaskWorkers(client)

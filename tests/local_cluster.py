"""A Dask cluster of this machine, for tests and measurements."""

import logging
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from tempfile import TemporaryDirectory

from dask import config
from distributed import Client, LocalCluster, Worker, WorkerPlugin

from orchestration.places.cluster import ClusterRuns


class IgnoreSigint(WorkerPlugin):
    """Workers ignore SIGINT: Ctrl-C at their terminal is for the process that started them."""

    name = "ignore-sigint"

    def setup(self, worker: Worker) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def local_cluster(workers: int) -> Iterator[tuple[Client, ClusterRuns]]:
    """Starts processes of one thread each, reachable only from this machine."""
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
        yield client, ClusterRuns(client)

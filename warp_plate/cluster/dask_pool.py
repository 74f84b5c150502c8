"""Workers of Dask distributed, which finds them tasks, shows them on its dashboard, and starts those that ended again.

A worker should have one thread, and a separate GPU or core.
"""

from __future__ import annotations

import json
import logging
import os
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warp_plate.cluster.local_pool import interrupts_blocked
from warp_plate.cluster.pool import WorkerPool, WorkersGone
from warp_plate.cluster.tasks import run_task
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

# Seconds to wait for a scheduler to answer and for a worker to join, and between counts of the workers.
ANSWER_SECONDS, JOIN_SECONDS, COUNT_SECONDS = 10.0, 60.0, 2.0
SETTINGS = {
    "distributed.admin.large-graph-warning-threshold": "1 GiB",  # a scene may name large files
    "distributed.scheduler.allowed-failures": 0,  # of a scheduler started here: run_tasks counts attempts
    # With Dask's defaults, two busy workers spend a tenth of a core on monitoring themselves.
    "distributed.worker.profile.enabled": False,
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.admin.tick.interval": "200ms",
}


class DaskPool(WorkerPool):
    """The workers of a Dask scheduler, which may come and go."""

    def __init__(self, client: Client, cluster: LocalCluster | None, address: str, device: str) -> None:
        super().__init__(device)
        self._client, self._cluster, self._address = client, cluster, address
        self._executor = client.get_executor(pure=False, retries=0)
        self._count = self._most = 0
        self._next_count, self._seen = 0.0, time.monotonic()
        try:
            while not self.worker_count():
                time.sleep(0.1)
        except BaseException:
            self.close()
            raise

    @property
    def description(self) -> str:
        return f"up to {self._most} Dask worker{'s' if self._most > 1 else ''} of {self._address}"

    def worker_count(self) -> int:
        """Return the number of the workers' threads, counted now and then."""
        now = time.monotonic()
        if self._count and now < self._next_count:
            return self._count
        self._count, self._next_count = self._count_threads(), now + COUNT_SECONDS
        if self._cluster is not None and self._count < self._most:
            self._cluster.scale(self._most)  # Dask gives up workers that end too often
        if self._count:
            self._seen, self._most = now, max(self._most, self._count)
        elif self._client.status == "closed" or now - self._seen > JOIN_SECONDS:
            raise WorkersGone(f"--cluster {self._address}: the scheduler is gone, or has had no worker for a minute")
        return self._count

    def submit(self, function: Callable[[Any], Any], argument: Any) -> Future[Any]:
        future: Future[Any] = self._executor.submit(run_task, function, argument)
        return future

    def close(self) -> None:
        """Leave the scheduler; one that was started here ends with its workers."""
        self._client.close(timeout=1)
        if self._cluster is not None:
            self._cluster.close()

    def _count_threads(self) -> int:
        from distributed import TimeoutError  # not Python's own before 3.11

        with suppress(OSError, TimeoutError):
            if self._client.status == "running":
                return sum(self._client.nthreads().values())
        return 0


def connect(address: str, device: str, log: Callable[[str], object]) -> DaskPool:
    """Return the pool of "local:4", "tcp://host:port" or a scheduler file; logs the address of its dashboard.

    Raises:
        SceneError: Dask is not installed, no scheduler answers, or no worker has joined it.
    """
    try:
        import distributed
        from dask import config

        config.set(SETTINGS)
        cluster = _start_workers(address) if address.startswith("local:") else None
    except ImportError as error:
        raise SceneError(f"--cluster {address}: {error}: pip install 'warp-plate[cluster]'") from None
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # errors are reported here in one line
    scheduler = address if cluster or "://" in address else _address_in(address)
    try:
        client = distributed.Client(cluster or scheduler, timeout=ANSWER_SECONDS, set_as_default=False)
    except Exception as error:  # Dask raises a different one for each scheme of an address
        line = str(error).partition("\n")[0] or type(error).__name__
        raise SceneError(f"--cluster {address}: no scheduler answers there: {line}") from None
    pool = DaskPool(client, cluster, address, device)
    if client.dashboard_link:
        log(f"dashboard of the workers: {client.dashboard_link}")
    return pool


def _address_in(path: str) -> str:
    """Return the address in a scheduler's file."""
    if not os.path.isfile(path):
        raise SceneError(f"--cluster {path}: no such file; must be local:4, tcp://HOST:PORT or a scheduler's file")
    try:
        return str(json.loads(Path(path).read_text(encoding="utf-8"))["address"])
    except (ValueError, KeyError, TypeError, RecursionError):
        raise SceneError(f"--cluster {path}: has no address, so no scheduler wrote it") from None


def _start_workers(address: str) -> LocalCluster:
    """Start the workers of "local:4": one thread each; who connects needs this run's certificate."""
    from distributed import LocalCluster

    count = address.partition(":")[2]
    if not (count.isdecimal() and int(count) >= 1):
        raise SceneError(f"--cluster {address}: must be local:COUNT with a count of workers from 1 on, such as local:4")
    with interrupts_blocked():
        return LocalCluster(
            n_workers=int(count),
            threads_per_worker=1,
            host="127.0.0.1",
            security=True,
            dashboard_address="127.0.0.1:0",
            worker_dashboard_address="127.0.0.1:0",
            memory_limit=0,  # only the machine's own limit counts
            silence_logs=logging.CRITICAL,
            env={"WARP_PLATE_THREADS": os.environ.get("WARP_PLATE_THREADS", "1")},
        )

"""Pools of workers for the options ``--devices`` and ``--cluster``: those of Dask distributed.

``--devices`` starts a scheduler and a process of one thread for each device of this machine; ``--cluster`` uses a
running scheduler. Processes are spawned, never forked: a copy of a process that has used CUDA or threads is broken.
"""

from __future__ import annotations

import json
import logging
import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warp_plate.cluster.pool import WorkerPool, WorkersGone
from warp_plate.cluster.tasks import DEVICE_VARIABLE, run_task
from warp_plate.interrupts import TERMINAL_SIGNALS
from warp_plate.scene.errors import SceneError
from warp_plate.scene.vary import counted
from warp_plate.solve.devices import find_device

if TYPE_CHECKING:
    from distributed import Client, SpecCluster

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


@contextmanager
def open_pool(
    devices: str | None,
    cluster: str | None,
    device: str | None = None,
    log: Callable[[str], object] = lambda line: None,
    answer_seconds: float = ANSWER_SECONDS,
) -> Iterator[WorkerPool | None]:
    """Open the pool that ``--devices`` or ``--cluster`` ask for and close it at the end; None if neither is given.

    Args:
        devices: Devices of this machine, such as "cuda:0,cuda:1" or "cpu,cpu"; each has a process.
        cluster: "tcp://host:port" or the path of a scheduler file.
        device: Device of the cluster's workers (default: each one's own choice).
        log: Called with a line for people: the dashboard's address, and at the end how many tasks were run again.
        answer_seconds: Time that the cluster's scheduler has to answer [s].

    Raises:
        SceneError: Both are given, no such device, no such scheduler, a worker that cannot start, or no Dask.
    """
    if devices is not None and cluster is not None:
        raise SceneError("--devices, --cluster: give one of them; workers of a cluster have their devices")
    name = f"--devices {devices}" if cluster is None else f"--cluster {cluster}"
    pool: DaskPool | None = None
    try:
        if devices is not None:
            pool = _start_workers(_device_names(devices))
        elif cluster is not None:
            client = _connect(name, _scheduler_address(cluster), answer_seconds)
            pool = DaskPool(client, name, device or "auto")
    except ImportError as error:
        raise SceneError(f"{name}: {error}: pip install 'warp-plate[cluster]'") from None
    if pool is None:
        yield None
        return
    try:
        while not pool.worker_count():
            time.sleep(0.1)
        if pool.dashboard:
            log(f"dashboard of the workers: {pool.dashboard}")
        yield pool
    finally:
        pool.close()
        for reason, count in pool.retried.items():
            log(f"{counted(count, 'task')} run again: {reason}")


def _device_names(text: str) -> list[str]:
    """Return the devices of "cuda:0,cuda:1" as Warp names them."""
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise SceneError(f"--devices {text}: must be devices with commas between, such as cuda:0,cuda:1 or cpu,cpu")
    try:
        return [find_device(name).alias for name in names]
    except SceneError as error:
        raise SceneError(f"--devices {text}: {error}") from None


def _scheduler_address(cluster: str) -> str:
    """Return the address of a scheduler: that given or that in its file."""
    if "://" in cluster:
        return cluster
    if not os.path.isfile(cluster):
        raise SceneError(f"--cluster {cluster}: no such file; must be tcp://HOST:PORT or a scheduler's file")
    try:
        return str(json.loads(Path(cluster).read_text(encoding="utf-8"))["address"])
    except (ValueError, KeyError, TypeError, RecursionError):
        raise SceneError(f"--cluster {cluster}: has no address, so no scheduler wrote it") from None


class DaskPool(WorkerPool):
    """The workers of a Dask scheduler, which may come and go.

    ``name`` is the option that named the workers; ``cluster`` has a scheduler and workers that were started here.
    """

    def __init__(self, client: Client, name: str, device: str = "auto", cluster: SpecCluster | None = None) -> None:
        super().__init__(device)
        self.join_seconds = JOIN_SECONDS
        self.dashboard: str = client.dashboard_link
        self._client, self._cluster, self._name = client, cluster, name
        self._executor = client.get_executor(pure=False, retries=0)
        assert client.scheduler_comm is not None
        client.scheduler_comm.interval = 0.001  # Dask waits 10 ms between messages, such as the blocks of two workers
        self._count = self._most = 0
        self._next_count, self._seen = 0.0, time.monotonic()

    @property
    def description(self) -> str:
        return f"up to {counted(self._most, 'Dask worker')} ({self._name.partition(' ')[2]})"

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
        elif self._client.status == "closed" or now - self._seen > self.join_seconds:
            raise WorkersGone(f"{self._name}: the scheduler is gone, or has had no worker for a minute")
        return self._count

    def submit(self, function: Callable[[Any], Any], argument: Any) -> Future[Any]:
        future: Future[Any] = self._executor.submit(_run_on_worker, function, argument)
        return future

    def restart_worker(self, error: BaseException) -> None:
        if worker := vars(error).get("worker"):
            self._client.restart_workers([worker], raise_for_error=False)

    def close(self) -> None:
        """Leave the scheduler; one that was started here ends with its workers."""
        self._client.close(timeout=1)
        if self._cluster is not None:
            self._cluster.close()

    def _count_threads(self) -> int:
        with suppress(OSError):
            if self._client.status == "running":
                return sum(self._client.nthreads().values())
        return 0


def _start_workers(devices: Sequence[str]) -> DaskPool:
    """Start a scheduler and a worker for each device; who connects needs this run's certificate."""
    from dask import config
    from distributed import Nanny, Scheduler, Security, SpecCluster

    config.set(SETTINGS)
    name, security = f"--devices {','.join(devices)}", Security.temporary()
    place = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0", "protocol": "tls://", "security": security}
    scheduler = {"cls": Scheduler, "options": {**place, "dashboard": True}}
    environment = {"WARP_PLATE_THREADS": os.environ.get("WARP_PLATE_THREADS", "1")}
    workers = {}
    for number, device in enumerate(devices):
        options = {
            **place,
            "dashboard": False,
            "env": {**environment, DEVICE_VARIABLE: device},
            "nthreads": 1,
            "memory_limit": 0,  # only the machine's own limit counts
            "silence_logs": logging.CRITICAL,
        }
        workers[number] = {"cls": Nanny, "options": options}
    try:
        with interrupts_blocked():
            cluster = SpecCluster(workers, scheduler, security=security, silence_logs=logging.CRITICAL)
    except Exception as error:  # Dask raises that of its worker, of whatever kind
        raise SceneError(f"{name}: workers cannot start: {_first_line(error)}") from None
    return DaskPool(_connect(name, cluster), name, cluster=cluster)


def _connect(name: str, scheduler: str | SpecCluster, answer_seconds: float = ANSWER_SECONDS) -> Client:
    """Return a client of a scheduler."""
    from dask import config
    from distributed import Client

    class ClosedIfRefused(Client):
        """A client that closes when it cannot connect: the garbage collector, which closes Dask's, can deadlock."""

        def start(self, **options: Any) -> None:
            try:
                super().start(**options)
            except BaseException:
                self.close(timeout=1)
                raise

    config.set(SETTINGS)
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # errors are reported here in one line
    try:
        return ClosedIfRefused(scheduler, timeout=answer_seconds, set_as_default=False)
    except Exception as error:  # Dask raises a different one for each scheme of an address
        raise SceneError(f"{name}: no scheduler answers there: {_first_line(error)}") from None


def _run_on_worker(function: Callable[[Any], Any], argument: Any) -> Any:
    """Run a task; an error names the worker if that can be restarted."""
    from distributed import get_worker

    try:
        return run_task(function, argument)
    except Exception as error:
        if get_worker().nanny:
            vars(error)["worker"] = get_worker().address
        raise


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0] or type(error).__name__


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Keep Ctrl-C and SIGHUP from processes and threads that are started in the block; here they come after it."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # unblocks SIGINT if the first process of a program starts it
    before = signal.pthread_sigmask(signal.SIG_BLOCK, TERMINAL_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

"""Pools of workers for the options ``--devices`` and ``--cluster``.

``--devices`` starts a process for each device, by ``concurrent.futures``. ``--cluster`` uses Dask distributed, whose
scheduler finds tasks for workers of any host, shows them on its dashboard, and restarts those that ended. Dask's own
local workers do not replace the processes: they take twice as long to start and 50 times as long to hand over a task.

Processes are spawned, never forked: a copy of a process that has used CUDA or threads is broken. A worker of Dask
should have one thread, and a separate GPU or core.
"""

from __future__ import annotations

import json
import logging
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warp_plate.cluster.pool import WorkerPool, WorkersGone
from warp_plate.cluster.tasks import DEVICE_VARIABLE, run_task
from warp_plate.interrupts import TERMINAL_SIGNALS
from warp_plate.scene.errors import SceneError
from warp_plate.scene.vary import counted
from warp_plate.solve.devices import find_device

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

# Libraries of linear algebra read these when a process begins.
ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"), "1")
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
) -> Iterator[WorkerPool | None]:
    """Open the pool that ``--devices`` or ``--cluster`` ask for and close it at the end; None if neither is given.

    Args:
        devices: Devices of this machine, such as "cuda:0,cuda:1" or "cpu,cpu"; each has a process.
        cluster: "local:4", "tcp://host:port" or the path of a scheduler file.
        device: Device of the cluster's workers (default: each one's own choice).
        log: Called with a line for people: the dashboard's address, and at the end how many tasks were run again.

    Raises:
        SceneError: Both are given, no such device, no such scheduler, or Dask is not installed.
    """
    if devices is not None and cluster is not None:
        raise SceneError("--devices, --cluster: give one of them; workers of a cluster have their devices")
    pool: WorkerPool | None = None
    if devices is not None:
        pool = LocalPool(device_names(devices))
    elif cluster is not None:
        pool = connect(cluster, device or "auto", log)
    try:
        yield pool
    finally:
        if pool is not None:
            pool.close()
            for reason, count in pool.retried.items():
                log(f"{counted(count, 'task')} run again: {reason}")


@dataclass
class _Worker:
    device: str
    executor: ProcessPoolExecutor
    futures: list[Future[Any]] = field(default_factory=list)  # not done, or done since the last submit

    @property
    def load(self) -> int:
        return sum(not future.done() for future in self.futures)

    @property
    def failed(self) -> bool:
        """True if the process has ended, or raised an error after which CUDA may be unusable in it."""
        done = [future for future in self.futures if future.done() and not future.cancelled()]
        return any(not isinstance(future.exception(), (type(None), SceneError, MemoryError)) for future in done)


class LocalPool(WorkerPool):
    """A process for each device of this machine; one that fails is replaced."""

    def __init__(self, devices: Sequence[str]) -> None:
        super().__init__()
        self._context = multiprocessing.get_context("spawn")
        # Workers hold the other end, and end themselves when this one is closed, be it by the end of this process.
        self._workers_end, self._lifeline = self._context.Pipe(duplex=False)
        self._processes: set[BaseProcess] = set()
        self._workers = [_Worker(device, self._start(device)) for device in devices]

    @property
    def description(self) -> str:
        count, devices = len(self._workers), ", ".join(worker.device for worker in self._workers)
        return f"{count} process{'es' if count > 1 else ''} ({devices})"

    def worker_count(self) -> int:
        return len(self._workers)

    def submit(self, function: Callable[[Any], Any], argument: Any) -> Future[Any]:
        """Give a task to the worker that has the fewest."""
        worker = min(self._workers, key=lambda candidate: candidate.load)
        if worker.failed:
            worker.executor.shutdown(wait=False, cancel_futures=True)
            worker.executor, worker.futures = self._start(worker.device), []
        try:
            future = worker.executor.submit(run_task, function, argument)
        except BrokenExecutor as error:
            future = Future()
            future.set_exception(error)
        worker.futures = [*(pending for pending in worker.futures if not pending.done()), future]
        return future

    def close(self) -> None:
        self._lifeline.close()
        for process in self._processes:  # one that hangs, or was stopped, would never end itself
            process.kill()
        for worker in self._workers:
            worker.executor.shutdown(cancel_futures=True)
        self._workers_end.close()

    def _start(self, device: str) -> ProcessPoolExecutor:
        executor = ProcessPoolExecutor(1, self._context, _start_worker, (device, self._workers_end))
        others = set(multiprocessing.active_children())
        with interrupts_blocked(), patched_environment(ONE_THREAD if device == "cpu" else {}):
            executor.submit(os.getpid)  # starts the process now
        self._processes |= set(multiprocessing.active_children()) - others
        return executor


def device_names(text: str) -> list[str]:
    """Return the devices of "cuda:0,cuda:1" as Warp names them.

    Raises:
        SceneError: One is not on this machine.
    """
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise SceneError(f"--devices {text}: must be devices with commas between, such as cuda:0,cuda:1 or cpu,cpu")
    try:
        return [find_device(name).alias for name in names]
    except SceneError as error:
        raise SceneError(f"--devices {text}: {error}") from None


@contextmanager
def patched_environment(values: Mapping[str, str]) -> Iterator[None]:
    """Give processes that are started in the block environment variables that are not set."""
    added = {name: value for name, value in values.items() if name not in os.environ}
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Keep Ctrl-C and SIGHUP from processes and threads that are started in the block; here they come after it."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, TERMINAL_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _start_worker(device: str, lifeline: Connection) -> None:
    """Prepare a worker process."""
    for number in TERMINAL_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    os.dup2(2, 1)  # output of libraries must not mix with that of the command
    os.environ[DEVICE_VARIABLE] = device
    if device == "cpu":
        os.environ.setdefault("WARP_PLATE_THREADS", "1")
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()


def _end_with(lifeline: Connection) -> None:
    with suppress(EOFError, OSError):
        lifeline.recv_bytes()
    os._exit(0)


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
        from dask import config
        from distributed import Client

        config.set(SETTINGS)
        cluster = _start_workers(address) if address.startswith("local:") else None
    except ImportError as error:
        raise SceneError(f"--cluster {address}: {error}: pip install 'warp-plate[cluster]'") from None
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # errors are reported here in one line
    scheduler = address if cluster or "://" in address else _address_in(address)

    class ClosedIfRefused(Client):  # type: ignore[misc]
        """A client that closes when it cannot connect: the garbage collector, which closes Dask's, can deadlock."""

        def start(self, **options: Any) -> None:
            try:
                super().start(**options)
            except BaseException:
                self.close(timeout=1)
                raise

    try:
        client = ClosedIfRefused(cluster or scheduler, timeout=ANSWER_SECONDS, set_as_default=False)
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

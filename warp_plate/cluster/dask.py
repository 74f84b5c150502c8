"""Workers of Dask distributed, which finds them work, gives it to others when they end, and shows it on its dashboard.

A worker should have one thread, and a GPU or a core of its own.
"""

from __future__ import annotations

import logging
import os
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from warp_plate.cluster.pool import Answer, Task, WorkersGone
from warp_plate.cluster.work import perform
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from distributed import Client, Future, LocalCluster

# Tasks for each of the workers' threads: the next one is there when one is done.
DEPTH = 2
# Seconds to wait for a scheduler to answer or to come back, for a worker to join, and between looks at who is there.
ANSWERS, JOINS, LOOK = 10.0, 60.0, 2.0


def open_dask(where: str, device: str, tell: Callable[[str], object]) -> Dask:
    """The pool of "local:4", "tcp://host:port" or a scheduler file; tells the address of its dashboard.

    Raises:
        SceneError: Dask is not installed, no scheduler answers, or no worker has joined it.
    """
    try:
        import distributed
    except ImportError:
        raise SceneError(f"--cluster {where}: Dask is not installed: pip install 'warp-plate[cluster]'") from None
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # what it says is said here in one line
    cluster = None
    head, _, count = where.partition(":")
    if head == "local" and not (count.isdecimal() and int(count) >= 1):
        raise SceneError(f"--cluster {where}: must be local:COUNT with a count of workers from 1 on, such as local:4")
    try:
        if head == "local":
            cluster = _local(int(count))
            client = distributed.Client(cluster, timeout=ANSWERS)
            client.register_plugin(_deaf_to_interrupts())
        elif "://" in where:
            client = distributed.Client(where, timeout=ANSWERS)
        elif os.path.isfile(where):
            client = distributed.Client(scheduler_file=where, timeout=ANSWERS)
        else:
            raise SceneError(f"--cluster {where}: no such file; must be local:4, tcp://HOST:PORT or a scheduler's file")
    except (OSError, ValueError, distributed.TimeoutError) as error:
        if isinstance(error, SceneError):
            raise
        line = str(error).partition("\n")[0] or type(error).__name__
        raise SceneError(f"--cluster {where}: no scheduler answers there: {line}") from None
    pool = Dask(client, cluster, where, device)
    if client.dashboard_link:
        tell(f"dashboard of the workers: {client.dashboard_link}")
    return pool


class Dask:
    """A pool of a scheduler's workers; see ``pool.Pool``."""

    def __init__(self, client: Client, cluster: LocalCluster | None, where: str, device: str) -> None:
        self.told: Callable[[int, int], object] | None = None
        self.device = device
        self._client, self._cluster, self._where = client, cluster, where
        self._events: SimpleQueue[tuple[int, Future]] = SimpleQueue()
        self._running: dict[int, Future] = {}
        self._late: dict[int, Future] = {}
        self._tickets = 0
        self._slots = self._most = 0
        self._looked, self._seen = 0.0, time.monotonic()
        try:
            while not self._slots:
                self._look()
                time.sleep(0 if self._slots else 0.1)
        except BaseException:
            self.close()
            raise

    @property
    def words(self) -> str:
        """See ``Pool``."""
        return f"up to {self._most} Dask worker{'s' if self._most > 1 else ''} of {self._where}"

    @property
    def free(self) -> int:
        """See ``Pool``."""
        return DEPTH * self._slots - len(self._running)

    @property
    def idle(self) -> int:
        """See ``Pool``; which worker has which task is the scheduler's affair, so that of several one may be idle."""
        return max(self._slots - len(self._running), int(self._slots > 1))

    def submit(self, task: Task) -> int:
        """See ``Pool``; the scheduler chooses the worker."""
        self._tickets += 1
        ticket = self._tickets
        future = self._client.submit(perform, task.name, task.payload, pure=False, retries=0)
        self._running[ticket] = future
        future.add_done_callback(lambda done: self._events.put((ticket, done)))
        return ticket

    def wait(self, seconds: float) -> list[tuple[int, Answer]]:
        """See ``Pool``."""
        answers = []
        try:
            answers.append(self._hear(*self._events.get(timeout=seconds)))
            while True:
                answers.append(self._hear(*self._events.get_nowait()))
        except Empty:
            self._look()
        return answers

    def forget(self, ticket: int) -> None:
        """See ``Pool``: the scheduler still holds its worker for busy, as it is."""
        future = self._running.pop(ticket, None)
        if future is not None:  # else it was done just now
            self._late[ticket] = future

    def abandon(self) -> None:
        """See ``Pool``: nobody wants these futures any more, so that the scheduler drops what waits; what a worker is
        at, it ends."""
        self._running.clear()

    def close(self) -> None:
        """See ``Pool``: a scheduler that ran before goes on, and so do its workers."""
        self._client.close(timeout=1)
        if self._cluster is not None:
            self._cluster.close()

    def _hear(self, ticket: int, future: Future) -> tuple[int, Answer]:
        self._running.pop(ticket, None)
        self._late.pop(ticket, None)
        if future.status == "finished":
            return ticket, Answer(**future.result())
        if future.status == "error":
            return ticket, _of_error(future.exception())
        return ticket, Answer(fault="lost", text="the scheduler lost it")

    def _look(self) -> None:
        """Count the workers' threads, now and then.

        Raises:
            WorkersGone: no scheduler for some ANSWERS seconds, or no worker for JOINS.
        """
        from distributed import TimeoutError  # of Python 3.10 another one

        now = time.monotonic()
        if now - self._looked < LOOK and self._slots:
            return
        while True:
            with suppress(OSError, TimeoutError):
                if self._client.status == "running":
                    self._slots = sum(self._client.nthreads().values())
                    break
            if self._client.status == "closed" or time.monotonic() - now > 2 * ANSWERS:
                raise WorkersGone(f"--cluster {self._where}: the scheduler is gone")
            time.sleep(0.1)
        self._looked, self._most = time.monotonic(), max(self._most, self._slots)
        if self._cluster is not None and self._slots < self._most:
            self._cluster.scale(self._most)  # workers that ended too often were given up
        if self._slots:
            self._seen = self._looked
        elif self._looked - self._seen > JOINS:
            raise WorkersGone(f"--cluster {self._where}: the scheduler has had no worker for {JOINS:g} s")


def _local(workers: int) -> LocalCluster:
    """Worker processes of one thread each on this machine, which listen to nobody else."""
    from distributed import LocalCluster

    environment = {"WARP_PLATE_THREADS": os.environ.get("WARP_PLATE_THREADS", "1")}
    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        worker_dashboard_address="127.0.0.1:0",
        memory_limit=0,  # the machine's own limit counts
        silence_logs=logging.CRITICAL,
        env=environment,
    )


def _deaf_to_interrupts() -> Any:
    """For workers of this machine's terminal: Ctrl-C is for the program that started them, which ends them."""
    from distributed import WorkerPlugin

    class Deaf(WorkerPlugin):
        def setup(self, worker: object) -> None:
            signal.signal(signal.SIGINT, signal.SIG_IGN)

    return Deaf()


def _of_error(error: BaseException) -> Answer:
    """The answer of a task that raised what is no fault of the task's, or whose workers ended.

    Raises:
        SceneError: workers lack a module. Anything else that a task raised.
    """
    from distributed import KilledWorker

    if isinstance(error, KilledWorker):
        return Answer(fault="lost", text="its workers ended", final=True)
    if isinstance(error, ImportError):
        raise SceneError(f"a worker cannot import {error.name}: install the same warp-plate on every worker")
    raise error

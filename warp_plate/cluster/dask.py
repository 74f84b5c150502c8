"""Workers of Dask distributed, which finds them work, gives it to others when they end, and shows it on its dashboard.

A worker should have one thread, and a GPU or a core of its own.
"""

from __future__ import annotations

import json
import logging
import os
import signal
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, NamedTuple

from warp_plate.cluster.pool import Answer, Task, WorkersGone, fittest
from warp_plate.cluster.tasks import of_error, perform
from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from distributed import Client, Future, LocalCluster

# Tasks for each of the workers' threads: the next one is there when one is done.
DEPTH = 2
# Seconds to wait for a scheduler to answer or to come back, for a worker to join, and between looks at who is there.
ANSWERS, JOINS, LOOK = 10.0, 60.0, 2.0
# Seconds in which a worker hands over an answer, some hundred kilobytes.
FETCH = 10.0
# Of workers that this program starts on cores that it fills: watching itself, Dask with two took a tenth of a core.
QUIET = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.admin.tick.interval": "200ms",
}


def open_dask(where: str, device: str, tell: Callable[[str], object]) -> Dask:
    """The pool of "local:4", "tcp://host:port" or a scheduler file; tells the address of its dashboard.

    Raises:
        SceneError: Dask is not installed, no scheduler answers, or no worker has joined it.
    """
    try:
        import distributed
    except ImportError:
        raise SceneError(f"--cluster {where}: Dask is not installed: pip install 'warp-plate[cluster]'") from None
    from dask import config

    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # what it says is said here in one line
    config.set({"distributed.admin.large-graph-warning-threshold": "1 GiB"})  # a recipe may name large files
    config.set({"distributed.scheduler.allowed-failures": 0})  # of a scheduler of ours: attempts are counted here
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
            _check_file(where)
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


def _check_file(where: str) -> None:
    """Raises SceneError where the file was not written by a scheduler."""
    try:
        found = json.loads(Path(where).read_text(encoding="utf-8"))
    except ValueError:
        found = None
    if not (isinstance(found, dict) and isinstance(found.get("address"), str)):
        raise SceneError(
            f"--cluster {where}: has no address, so no scheduler wrote it; must be the file of "
            "dask scheduler --scheduler-file"
        )


class _Sent(NamedTuple):
    """workers: to which alone the scheduler may give it; empty: to any."""

    task: Task
    future: Future
    workers: set[str]


class Dask:
    """A pool of a scheduler's workers; see ``pool.Pool``."""

    def __init__(self, client: Client, cluster: LocalCluster | None, where: str, device: str) -> None:
        self.told: Callable[[int, int], object] | None = None
        self.retried = Counter[str]()
        self.device = device
        self._client, self._cluster, self._where = client, cluster, where
        self._events: SimpleQueue[tuple[int, Future]] = SimpleQueue()
        self._running: dict[int, _Sent] = {}
        self._late: dict[int, _Sent] = {}
        self._tickets = 0
        self._threads: Mapping[str, int] = {}
        self._most = 0
        self._looked, self._seen = 0.0, time.monotonic()
        try:
            while not self._threads:
                self._look()
                time.sleep(0 if self._threads else 0.1)
        except BaseException:
            self.close()
            raise

    @property
    def words(self) -> str:
        """See ``Pool``."""
        return f"up to {self._most} Dask worker{'s' if self._most > 1 else ''} of {self._where}"

    def free(self, task: Task | None = None) -> int:
        """See ``Pool``. A worker's end counts against all that is with it: so that it is known who is to blame, none
        has two tasks while one runs, or is to run, under which a worker ended before."""
        tasks = [task, *(sent.task for sent in self._running.values())]
        depth = 1 if any(one is not None and one.attempts for one in tasks) else DEPTH
        return depth * self._slots() - len(self._running)

    def idle(self, task: Task | None = None) -> int:
        """See ``Pool``; which worker has which task is the scheduler's affair, so that of several one may be idle."""
        slots = self._slots(task)
        return max(slots - len(self._running), int(slots > 1))

    def submit(self, task: Task) -> int:
        """See ``Pool``; the scheduler chooses among the workers."""
        self._tickets += 1
        ticket = self._tickets
        workers = fittest(self._threads, task)
        if len(workers) == len(self._threads):  # any, also one that joins later
            workers = set()
        future = self._client.submit(
            perform_there, task.name, task.payload, pure=False, retries=0, workers=list(workers) or None
        )
        self._running[ticket] = _Sent(task, future, workers)
        future.add_done_callback(lambda done: self._events.put((ticket, done)))
        return ticket

    def wait(self, seconds: float) -> list[tuple[int, Answer]]:
        """See ``Pool``."""
        answers = []
        try:
            answers += self._hear(*self._events.get(timeout=seconds))
            while True:
                answers += self._hear(*self._events.get_nowait())
        except Empty:
            return answers + self._look()

    def forget(self, ticket: int) -> None:
        """See ``Pool``: the scheduler still holds its worker for busy, as it is."""
        sent = self._running.pop(ticket, None)
        if sent is not None:  # else it was done just now
            self._late[ticket] = sent

    def abandon(self) -> None:
        """See ``Pool``: the scheduler drops what waits; what a worker is at, it ends."""
        for sent in (*self._running.values(), *self._late.values()):
            sent.future.release()  # which its callback holds too
        self._running.clear()
        self._late.clear()

    def close(self) -> None:
        """See ``Pool``: a scheduler that ran before goes on, and so do its workers."""
        self._client.close(timeout=1)
        if self._cluster is not None:
            self._cluster.close()

    def _slots(self, task: Task | None = None) -> int:
        """Threads of the workers that it may go to."""
        return sum(self._threads[name] for name in fittest(self._threads, task))

    def _hear(self, ticket: int, future: Future) -> list[tuple[int, Answer]]:
        self._late.pop(ticket, None)
        if self._running.pop(ticket, None) is None:  # nobody waits for it any more
            return []
        if future.status == "error":
            return [(ticket, _of_error(future.exception()))]
        # The worker holds the answer; where it ended meanwhile, Dask would wait until another has done the task again.
        with suppress(Exception):
            return [(ticket, Answer(**future.result(timeout=FETCH)))]
        return [(ticket, Answer(fault="lost", text="its worker ended with the answer"))]

    def _look(self) -> list[tuple[int, Answer]]:
        """Count the workers' threads, now and then; what was for workers that are gone waits for others.

        Raises:
            WorkersGone: no scheduler for some ANSWERS seconds, or no worker for JOINS.
        """
        from distributed import TimeoutError  # of Python 3.10 another one

        now = time.monotonic()
        if now - self._looked < LOOK and self._threads:
            return []
        while True:
            with suppress(OSError, TimeoutError):
                if self._client.status == "running":
                    self._threads = self._client.nthreads()
                    break
            if self._client.status == "closed" or time.monotonic() - now > 2 * ANSWERS:
                raise WorkersGone(f"--cluster {self._where}: the scheduler is gone")
            time.sleep(0.1)
        self._looked, self._most = time.monotonic(), max(self._most, self._slots())
        if self._cluster is not None and self._slots() < self._most:
            self._cluster.scale(self._most)  # workers that ended too often were given up
        if self._threads:
            self._seen = self._looked
        elif self._looked - self._seen > JOINS:
            raise WorkersGone(f"--cluster {self._where}: the scheduler has had no worker for {JOINS:g} s")
        bound = {ticket: sent.workers for ticket, sent in self._running.items() if sent.workers}
        gone = [ticket for ticket, workers in bound.items() if not workers & {*self._threads}]
        for ticket in gone:
            self._running.pop(ticket).future.release()
        return [(ticket, Answer(fault="waiting", text="the workers that it was for are gone")) for ticket in gone]


def perform_there(name: str, payload: Mapping[str, Any]) -> dict[str, Any]:
    """``work.perform`` on a worker, which says who it is."""
    from distributed import get_worker

    return {**perform(name, payload, caught=True), "worker": get_worker().address}


def _local(workers: int) -> LocalCluster:
    """Worker processes of one thread each on this machine, which listen to nobody else."""
    from dask import config
    from distributed import LocalCluster

    config.set(QUIET)
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
    """The answer of a task whose workers ended, or that did not come as far as ``perform``."""
    from distributed import KilledWorker

    if isinstance(error, KilledWorker):
        return Answer(fault="lost", text="its workers ended")
    return Answer(**of_error(error))

"""A pool of workers, and how tasks run on it: repeated if a worker ended or its memory was short."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from warp_plate.cluster.tasks import run_task
from warp_plate.interrupts import check_interrupt, postponed_interrupts
from warp_plate.scene.errors import SceneError
from warp_plate.scene.vary import counted

if TYPE_CHECKING:
    from distributed import Client, SpecCluster

# The least and the most node-steps of a block. On a CPU 0.01 and 0.1 s of a core; on a GPU what fills an H200 once
# (2112 plates of the paper's scene), and 16 times that.
BLOCK_NODE_STEPS = {"cpu": (1e8, 8e8), "cuda": (1.65e9, 2.64e10)}
# Failures after which a task is given up.
ATTEMPTS = 3
# Tasks queued for each worker, so that it need not wait for the next one.
TASKS_PER_WORKER = 2
# Seconds between checks for Ctrl-C, between counts of the workers, for the scheduler to give their number, and to wait
# for a worker to join.
POLL_SECONDS, COUNT_SECONDS, ANSWER_SECONDS, JOIN_SECONDS = 0.2, 2.0, 5.0, 60.0
# Seconds in which workers may end by themselves when a pool closes.
END_SECONDS = 1.5


class WorkersGone(SceneError):
    """No worker is left and none will come; unfinished work can be continued later."""


class WorkerPool:
    """The workers of a Dask scheduler, which run functions of one argument, and may come and go.

    Attributes:
        device: Device on which workers run plates; "auto" for each one's own choice.
        block_node_steps: Least and most work in a block of plates, by kind of device.
        on_progress: Called with (tasks done, tasks in all) while :func:`run_tasks` runs.
    """

    on_progress: Callable[[int, int], object] | None = None

    def __init__(self, client: Client, name: str, device: str = "auto", cluster: SpecCluster | None = None) -> None:
        """``name`` is the option that named the workers; ``cluster`` has a scheduler and workers started here."""
        self.device, self.block_node_steps = device, dict(BLOCK_NODE_STEPS)
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
        """The workers in a few words."""
        return f"up to {counted(self._most, 'Dask worker')} ({self._name.partition(' ')[2]})"

    def worker_count(self) -> int:
        """Return the number of the workers' threads, counted now and then; raise ``WorkersGone`` if none is left."""
        now = time.monotonic()
        if self._count and now < self._next_count:
            return self._count
        self._count, self._next_count = self._count_threads(), now + COUNT_SECONDS
        if self._cluster is not None and self._count < self._most:
            self._cluster.scale(self._most)  # Dask gives up workers that end too often
        if self._count:
            self._seen, self._most = now, max(self._most, self._count)
        elif self._client.status == "closed" or now - self._seen > self.join_seconds:
            ended = "; workers end where warp-plate is not installed"
            raise WorkersGone(f"{self._name}: the scheduler is gone, or has had no worker for a minute{ended}")
        return self._count

    def submit(self, function: Callable[[Any], Any], argument: Any) -> Future[Any]:
        """Give a task to a worker, where it waits until the worker is done with others."""
        future: Future[Any] = self._executor.submit(_run_on_worker, function, argument)
        return future

    def restart_worker(self, error: BaseException) -> None:
        """Restart the worker on which an error of the program was raised, after which CUDA may be unusable."""
        if worker := vars(error).get("worker"):
            self._client.restart_workers([worker], raise_for_error=False)

    def close(self) -> None:
        """Leave the scheduler; one that was started here ends with its workers, which are killed if busy or hanging.

        Ctrl-C waits, so that no result is lost.
        """
        with postponed_interrupts():
            self._client.close(timeout=1)
            if self._cluster is not None:
                ended = threading.Event()
                threading.Thread(target=_kill_workers, args=[self._cluster, ended], daemon=True).start()
                try:
                    self._cluster.close()
                finally:
                    ended.set()

    def _count_threads(self) -> int:
        client = self._client
        with suppress(OSError):  # TimeoutError among them
            if client.status == "running" and client.scheduler is not None:
                count = client.sync(client.scheduler.ncores, workers=None, callback_timeout=ANSWER_SECONDS)
                return sum(count.values())
        return 0


def _kill_workers(cluster: SpecCluster, ended: threading.Event) -> None:
    """Kill the workers that were started here until the cluster has ended: a suspended one ends by SIGKILL alone, and
    Python waits for it. Dask may start another in its place, which may hang too."""
    while not ended.wait(END_SECONDS):
        for nanny in list(cluster._created):  # those that have not joined yet are not among its workers
            if number := nanny.pid:
                with suppress(OSError):  # it has just ended
                    os.kill(number, getattr(signal, "SIGKILL", signal.SIGTERM))  # Windows kills by the latter


def _run_on_worker(function: Callable[[Any], Any], argument: Any) -> Any:
    """Run a task; an error names the worker if that can be restarted."""
    from distributed import get_worker

    try:
        return run_task(function, argument)
    except Exception as error:
        if get_worker().nanny:
            vars(error)["worker"] = get_worker().address
        raise


@dataclass(eq=False)
class Task:
    """A call of a function of a module's top level."""

    function: Callable[[Any], Any]  # workers find it by its name
    argument: Any
    key: Any = None  # anything by which the caller knows the result
    attempts: int = 0  # how often the task failed


@dataclass(frozen=True)
class Outcome:
    """The result of a task."""

    value: Any = None  # return value of the function; None for a task that was given up
    failure: str = ""  # why it was given up; "" if it was not


def run_tasks(pool: WorkerPool, tasks: Iterable[Task]) -> Iterator[tuple[Task, Outcome]]:
    """Yield each task with its outcome, in the order in which they finish.

    Raises:
        SceneError: A task raised it: bad input is bad everywhere.
        WorkersGone: No worker is left.
        KeyboardInterrupt: Ctrl-C was pressed. Tasks that have not begun are cancelled, also if the caller leaves.
    """
    waiting, running, done = deque(tasks), dict[Future[Any], Task](), 0
    try:
        while waiting or running:
            most = pool.worker_count() * TASKS_PER_WORKER  # counted also while all tasks wait at workers that are lost
            while waiting and len(running) < most:
                # A task that failed before runs alone, so that no other fails with it.
                if running and any(task.attempts for task in (waiting[0], *running.values())):
                    break
                task = waiting.popleft()
                running[pool.submit(task.function, task.argument)] = task
            if running:
                finished, _ = wait(running, POLL_SECONDS, FIRST_COMPLETED)
            else:
                finished = set()
                time.sleep(POLL_SECONDS)  # until there is a worker
            check_interrupt()
            for future in finished:
                task = running.pop(future)
                outcome = _outcome(pool, task, future)
                if outcome is None:
                    waiting.appendleft(task)
                    continue
                done += 1
                if pool.on_progress is not None:
                    pool.on_progress(done, done + len(waiting) + len(running))
                yield task, outcome
    finally:
        for future in running:
            future.cancel()


def _outcome(pool: WorkerPool, task: Task, future: Future[Any]) -> Outcome | None:
    """Return the outcome of a task; None if it is to be run again."""
    if future.cancelled():  # Dask lost it
        return None
    error = future.exception()
    if error is None:
        return Outcome(future.result())
    if isinstance(error, SceneError):
        raise SceneError(f"a worker: {error}")
    if isinstance(error, ImportError):
        raise SceneError(f"a worker cannot import {error.name}: install the same warp-plate on every worker")
    if isinstance(error, MemoryError):
        reason = str(error)
    else:
        pool.restart_worker(error)
        killed = type(error).__name__ == "KilledWorker"
        reason = "its worker ended" if killed else f"{type(error).__name__}: {str(error).strip()}".partition("\n")[0]
    task.attempts += 1
    if task.attempts == ATTEMPTS:
        return Outcome(failure=f"given up after {ATTEMPTS} attempts: {reason}")
    return None

"""A pool of workers, and how tasks run on it: repeated if a worker ended or its memory was short."""

import time
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from typing import Any

from warp_plate.interrupts import check_interrupt
from warp_plate.scene.errors import SceneError

# The least and the most node-steps of a block. On a CPU 0.01 and 0.1 s of a core; on a GPU what fills an H200 once
# (2112 plates of the paper's scene), and 16 times that.
BLOCK_NODE_STEPS = {"cpu": (1e8, 8e8), "cuda": (1.65e9, 2.64e10)}
# Failures after which a task is given up.
ATTEMPTS = 3
# Tasks queued for each worker, so that it need not wait for the next one.
TASKS_PER_WORKER = 2
# Seconds between checks for Ctrl-C and for workers that came or went.
POLL_SECONDS = 0.2


class WorkersGone(SceneError):
    """No worker is left and none will come; unfinished work can be continued later."""


class WorkerPool(ABC):
    """Workers that run functions of one argument."""

    def __init__(self, device: str = "auto") -> None:
        self.device = device  # on which workers run plates; "auto" for each worker's own choice
        self.block_node_steps = dict(BLOCK_NODE_STEPS)  # least and most work in a block of plates, by kind of device
        # Called with (tasks done, tasks in all) while ``run_tasks`` runs
        self.on_progress: Callable[[int, int], object] | None = None
        self.retried: Counter[str] = Counter()  # tasks that were run again, by the reason

    @property
    @abstractmethod
    def description(self) -> str:
        """The workers in a few words."""

    @abstractmethod
    def worker_count(self) -> int:
        """Return the number of tasks that can run at once, or raise ``WorkersGone`` if no worker is left."""

    @abstractmethod
    def submit(self, function: Callable[[Any], Any], argument: Any) -> Future[Any]:
        """Give a task to a worker, where it waits until the worker is done with others."""

    def restart_worker(self, error: BaseException) -> None:  # noqa: B027
        """Restart the worker on which an error of the program was raised, after which CUDA may be unusable."""

    @abstractmethod
    def close(self) -> None:
        """End the workers that this pool started, even if they are busy."""


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
            while waiting and len(running) < pool.worker_count() * TASKS_PER_WORKER:
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
    pool.retried[reason] += 1
    return None

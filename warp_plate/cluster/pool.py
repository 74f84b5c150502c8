"""A pool of workers, and how tasks run on it: repeated if a worker ended, and halved if memory was short."""

from __future__ import annotations

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
# Tasks queued for each worker, so that it need not wait for the next one.
TASKS_PER_WORKER = 2
# Seconds between checks for Ctrl-C and for workers that came or went.
POLL_SECONDS = 0.2


class WorkersGone(SceneError):
    """No worker is left and none will come; unfinished work can be continued later."""


class WorkerPool(ABC):
    """Workers that run functions of one argument.

    Attributes:
        device: Device on which workers run plates; "auto" for each worker's own choice.
        attempts: Number of failures after which a task is given up.
        block_node_steps: The least and the most work in a block of plates, by the kind of device.
        on_progress: Called with (tasks done, tasks in all) while ``run_tasks`` runs; None: nobody is.
        retried: Number of tasks that were run again, or in halves, by the reason.
    """

    def __init__(self, device: str = "auto") -> None:
        self.device = device
        self.attempts = 3
        self.block_node_steps = dict(BLOCK_NODE_STEPS)
        self.on_progress: Callable[[int, int], object] | None = None
        self.retried: Counter[str] = Counter()

    @property
    @abstractmethod
    def description(self) -> str:
        """The workers in a few words."""

    @abstractmethod
    def worker_count(self) -> int:
        """Return the number of tasks that can run at once.

        Raises:
            WorkersGone: No worker is left.
        """

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
    """A call of a function of a module's top level.

    Attributes:
        function: The function; workers find it by its name.
        argument: Its argument.
        key: Anything by which the caller knows the result.
        attempts: How often the task failed.
    """

    function: Callable[[Any], Any]
    argument: Any
    key: Any = None
    attempts: int = 0


@dataclass(frozen=True)
class Outcome:
    """The result of a task.

    Attributes:
        value: Return value of the function; None for a task that was given up.
        failure: Why it was given up; "" if it was not.
    """

    value: Any = None
    failure: str = ""


def run_tasks(
    pool: WorkerPool, tasks: Iterable[Task], halves: Callable[[Task], list[Task]] = lambda task: []
) -> Iterator[tuple[Task, Outcome]]:
    """Yield each task with its outcome, in the order in which they finish.

    Args:
        pool: The workers.
        tasks: The tasks.
        halves: Splits a task for which memory was short into smaller ones; returns none if that cannot be done.

    Raises:
        SceneError: A task raised it: bad input is bad everywhere.
        WorkersGone: No worker is left.
        KeyboardInterrupt: Ctrl-C was pressed. Tasks that have not begun are cancelled, also if the caller leaves.
    """
    waiting, running, done = deque(tasks), dict[Future[Any], Task](), 0
    try:
        while waiting or running:
            while waiting and len(running) < _most_running(pool.worker_count(), [waiting[0], *running.values()]):
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
                outcome = _outcome(pool, task, future, halves)
                if not isinstance(outcome, Outcome):
                    waiting.extendleft(outcome)
                    continue
                done += 1
                if pool.on_progress is not None:
                    pool.on_progress(done, done + len(waiting) + len(running))
                yield task, outcome
    finally:
        for future in running:
            future.cancel()


def _most_running(workers: int, tasks: list[Task]) -> int:
    """Return the number of tasks that may run at once: only one if a task failed before, so that no other fails with
    it."""
    return min(workers, 1) if any(task.attempts for task in tasks) else TASKS_PER_WORKER * workers


def _outcome(
    pool: WorkerPool, task: Task, future: Future[Any], halves: Callable[[Task], list[Task]]
) -> Outcome | list[Task]:
    """Return the outcome of a task, or the tasks that are to be run in its place."""
    if future.cancelled():  # Dask lost it
        return [task]
    error = future.exception()
    if error is None:
        return Outcome(future.result())
    if isinstance(error, SceneError):
        raise SceneError(f"a worker: {error}")
    if isinstance(error, ImportError):
        raise SceneError(f"a worker cannot import {error.name}: install the same warp-plate on every worker")
    reason = _reason(error)
    smaller = halves(task) if isinstance(error, MemoryError) else []
    if not isinstance(error, MemoryError):
        pool.restart_worker(error)
    task.attempts += 1
    if not smaller and task.attempts == pool.attempts:
        return Outcome(failure=f"given up after {pool.attempts} attempts: {reason}")
    pool.retried[reason] += 1
    return smaller or [task]


def _reason(error: BaseException) -> str:
    """Return one line about an error."""
    if type(error).__name__ == "KilledWorker":
        return "its worker ended"
    if isinstance(error, MemoryError):
        return str(error)
    return f"{type(error).__name__}: {str(error).strip()}".partition("\n")[0]

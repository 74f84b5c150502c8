"""The boundary: tasks of plain data go out to a pool's workers, and their answers come back as they are done.

A task is a function of a module and what it is called with: numbers, texts, bytes, arrays, and lists and tables of
these. ``Here`` does tasks in this process; ``processes.Processes`` on several devices or cores of this machine;
``dask.Dask`` on the workers of a Dask scheduler. What is done with tasks that fail stands once, in ``spread``.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

from warp_plate.cluster.tasks import perform
from warp_plate.scene.errors import SceneError

Payload = Mapping[str, Any]
# Gives the answer's value, or a function that waits for the rest of the work and gives it.
Function = Callable[[Payload], Mapping[str, Any] | Callable[[], Mapping[str, Any]]]
# "lost": the worker ended under the task, or the task raised what no task should; "waiting": the worker ended before it
# came to the task; "memory": it had too little; "wrong": the task is bad input, everywhere the same.
Fault = Literal["", "lost", "waiting", "memory", "wrong"]


class WorkersGone(SceneError):
    """No worker is left, and none will come: what was under way can be done later."""


@dataclass(eq=False)
class Task:
    """What a worker is to do.

    function: of a module's top level, so that a worker finds it by its name; payload: what it is called with, which
    stays as it is until its answer has come. place: the caller's own, to know the answer by. size: its work, as a part
    of that of the largest tasks of its kind. attempts: how many workers ended under it. avoid: the workers that failed
    it, the last one last.
    """

    function: Function
    payload: Payload
    place: Any = None
    size: float = 1.0
    attempts: int = 0
    avoid: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """By which a worker finds the function."""
        return f"{self.function.__module__}:{self.function.__qualname__}"


@dataclass(frozen=True)
class Answer:
    """What a task came to: a value, or a fault and one line about it. worker: who answered, where one did."""

    value: Mapping[str, Any] = field(default_factory=dict)
    fault: Fault = ""
    text: str = ""
    worker: str = ""


def fittest(workers: Iterable[str], task: Task | None) -> set[str]:
    """The workers that a task may go to: those that have not failed it, and where there are none, the one that failed
    it longest ago. It rather waits for one of these than goes to another that is free."""
    failed = {name: place for place, name in enumerate(() if task is None else task.avoid)}
    ranks = {name: failed.get(name, -1) for name in workers}
    return {name for name, rank in ranks.items() if rank == min(ranks.values())}


class Pool(Protocol):
    """Workers. Its methods are called from one thread; one ``spread`` at a time."""

    told: Callable[[int, int], object] | None
    """Called by ``spread`` with tasks done and in all."""
    retried: Counter[str]
    """How many tasks were to be done again, or in halves, by what went wrong."""
    device: str
    """What workers run plates on that were not told otherwise: "auto" for each one's own choice."""

    @property
    def words(self) -> str:
        """What it is, for people."""

    def free(self, task: Task | None = None) -> int:
        """How many more tasks it takes, some of them to wait with a worker that is not done with another; with a task:
        how many like it, of its ``fittest`` workers. One that was attempted before has a worker of its own, so that it
        is known what ended that."""

    def idle(self, task: Task | None = None) -> int:
        """How many workers have nothing to do; with a task: of its ``fittest``."""

    def submit(self, task: Task) -> int:
        """Give a task to one of its ``fittest`` workers, where ``free`` says that there is room; returns the ticket
        that its answer will have. It never waits for a worker."""

    def wait(self, seconds: float) -> list[tuple[int, Answer]]:
        """Answers that came, after at most so many seconds; of given up tasks too.

        Raises:
            WorkersGone: see there.
        """

    def forget(self, ticket: int) -> None:
        """The answer to this ticket is not wanted any more; another worker gave it."""

    def abandon(self) -> None:
        """Give up all tasks that are under way, as soon as that can be done."""

    def close(self) -> None:
        """End the workers that this pool started, whatever they do."""


class Here:
    """A pool of no workers: each task is done in this process, when it is waited for."""

    def __init__(self) -> None:
        self.told: Callable[[int, int], object] | None = None
        self.retried = Counter[str]()
        self._tasks: deque[tuple[int, Task]] = deque()
        self._tickets = 0

    words = "this process"
    device = "auto"

    def free(self, task: Task | None = None) -> int:
        """One at a time."""
        return 1 - len(self._tasks)

    def idle(self, task: Task | None = None) -> int:
        """See :class:`Pool`."""
        return 0

    def submit(self, task: Task) -> int:
        """See :class:`Pool`."""
        self._tickets += 1
        self._tasks.append((self._tickets, task))
        return self._tickets

    def wait(self, seconds: float) -> list[tuple[int, Answer]]:
        """See :class:`Pool`."""
        if not self._tasks:
            return []
        ticket, task = self._tasks.popleft()
        return [(ticket, Answer(**perform(task.name, task.payload)))]

    def forget(self, ticket: int) -> None:
        """See :class:`Pool`."""

    def abandon(self) -> None:
        """See :class:`Pool`."""
        self._tasks.clear()

    def close(self) -> None:
        """See :class:`Pool`."""

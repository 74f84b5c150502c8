"""The boundary: tasks of plain data go out to a pool's workers, and their answers come back as they are done.

A task is a function of a module and what it is called with: numbers, texts, bytes, arrays, and lists and tables of
these. ``Here`` does tasks in this process; ``processes.Processes`` on several devices or cores of this machine;
``dask.Dask`` on the workers of a Dask scheduler. What is done with tasks that fail stands once, in ``spread``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

from warp_plate.cluster.work import perform
from warp_plate.scene.errors import SceneError

Payload = Mapping[str, Any]
# Gives the answer's value, or a function that waits for the rest of the work and gives it.
Function = Callable[[Payload], Mapping[str, Any] | Callable[[], Mapping[str, Any]]]
# "lost": the worker ended under the task; "waiting": it ended before it came to the task; "memory": it had too little;
# "wrong": the task is bad input, everywhere the same.
Fault = Literal["", "lost", "waiting", "memory", "wrong"]


class WorkersGone(SceneError):
    """No worker is left, and none will come: what was under way can be done later."""


@dataclass(eq=False)
class Task:
    """What a worker is to do.

    function: of a module's top level, so that a worker finds it by its name; payload: what it is called with. place:
    the caller's own, to know the answer by. attempts: how many workers ended under it.
    """

    function: Function
    payload: Payload
    place: Any = None
    attempts: int = 0

    @property
    def name(self) -> str:
        """By which a worker finds the function."""
        return f"{self.function.__module__}:{self.function.__qualname__}"


@dataclass(frozen=True)
class Answer:
    """What a task came to: a value, or a fault and one line about it; final: no other worker should be tried."""

    value: Mapping[str, Any] = field(default_factory=dict)
    fault: Fault = ""
    text: str = ""
    final: bool = False


class Pool(Protocol):
    """Workers. Its methods are called from one thread; one ``spread`` at a time."""

    told: Callable[[int, int], object] | None
    """Called by ``spread`` with tasks done and in all."""
    device: str
    """What workers run plates on that were not told otherwise: "auto" for each one's own choice."""

    @property
    def words(self) -> str:
        """What it is, for people."""

    @property
    def free(self) -> int:
        """How many more tasks it takes, some of them to wait with a worker that is not done with another."""

    @property
    def idle(self) -> int:
        """How many workers have nothing to do."""

    def submit(self, task: Task) -> int:
        """Give a task to a worker; returns the ticket that its answer will have."""

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
        self._tasks: deque[tuple[int, Task]] = deque()
        self._tickets = 0

    words = "this process"
    device = "auto"
    idle = 0

    @property
    def free(self) -> int:
        """One at a time."""
        return 1 - len(self._tasks)

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


@contextmanager
def open_pool(
    devices: str | None,
    cluster: str | None,
    device: str | None = None,
    tell: Callable[[str], object] = lambda line: None,
) -> Iterator[Pool | None]:
    """The pool that ``--devices`` or ``--cluster`` ask for, closed at the end; None where neither is given.

    Args:
        devices: such as "cuda:0,cuda:1", or "cpu,cpu": a process for each; a CPU one has one thread.
        cluster: "local:4", "tcp://host:port" or the path of a scheduler file. device: of its workers; left out, each
            one's own choice.
        tell: takes a line for people.

    Raises:
        SceneError: both are given, no such device, no such scheduler, or Dask is not installed.
    """
    if devices is not None and cluster is not None:
        raise SceneError("--devices, --cluster: give one of them; workers of a cluster have their devices")
    pool: Pool | None = None
    if devices is not None:
        from warp_plate.cluster.processes import Processes, device_names

        pool = Processes(device_names(devices))
    elif cluster is not None:
        from warp_plate.cluster.dask import open_dask

        pool = open_dask(cluster, device or "auto", tell)
    try:
        yield pool
    finally:
        if pool is not None:
            pool.close()

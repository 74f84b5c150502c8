"""A pool of workers: processes on the devices of this machine, or the workers of a Dask scheduler.

Both are thin layers over an executor of ``concurrent.futures``; ``scheduler`` handles failing tasks.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from warp_plate.scene.errors import SceneError


class WorkersGone(SceneError):
    """No worker is left and none will come; unfinished work can be continued later."""


class WorkerPool(ABC):
    """Workers that run functions of one argument.

    Attributes:
        device: Device on which workers run plates; "auto" for each worker's own choice.
        on_progress: Called with (tasks done, tasks in all) while ``run_tasks`` runs; None: nobody is.
        retried: Number of tasks that were run again, or in halves, by the reason.
    """

    def __init__(self, device: str = "auto") -> None:
        self.device = device
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

    @abstractmethod
    def close(self) -> None:
        """End the workers that this pool started, even if they are busy."""

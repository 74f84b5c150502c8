"""Pools of workers: processes on the devices of this machine, or the workers of a Dask scheduler.

Both are thin layers over an executor of ``concurrent.futures``; what happens when a task fails is in ``scheduler``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any

from warp_plate.scene.errors import SceneError
from warp_plate.scene.vary import counted


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
        """Return how many tasks can run at once.

        Raises:
            WorkersGone: No worker is left.
        """

    @abstractmethod
    def submit(self, function: Callable[[Any], Any], argument: Any) -> Future[Any]:
        """Give a task to a worker, where it waits until the worker is done with others."""

    @abstractmethod
    def close(self) -> None:
        """End the workers that this pool started, whatever they are doing."""


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
        from warp_plate.cluster.local_pool import LocalPool, device_names

        pool = LocalPool(device_names(devices))
    elif cluster is not None:
        from warp_plate.cluster.dask_pool import connect

        pool = connect(cluster, device or "auto", log)
    try:
        yield pool
    finally:
        if pool is not None:
            pool.close()
            for reason, count in pool.retried.items():
                log(f"{counted(count, 'task')} run again: {reason}")

"""Pools of workers for the options ``--devices`` and ``--cluster``."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from warp_plate.cluster.dask_pool import connect
from warp_plate.cluster.local_pool import LocalPool, device_names
from warp_plate.cluster.pool import WorkerPool
from warp_plate.scene.errors import SceneError
from warp_plate.scene.vary import counted


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

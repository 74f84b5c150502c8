"""From ``--devices`` or ``--cluster`` to a pool of workers, which is closed at the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from warp_plate.cluster.pool import Pool
from warp_plate.scene.errors import SceneError
from warp_plate.scene.vary import counted


@contextmanager
def open_pool(
    devices: str | None,
    cluster: str | None,
    device: str | None = None,
    tell: Callable[[str], object] = lambda line: None,
) -> Iterator[Pool | None]:
    """The pool that ``--devices`` or ``--cluster`` ask for, closed at the end; None where neither is given.

    At the end it tells how often work was done again, and why.

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
            try:
                for why, count in pool.retried.items():
                    tell(f"{counted(count, 'task')} done again: {why}")
            finally:
                pool.close()

"""Pools of workers for the options ``--devices`` and ``--cluster``: those of Dask distributed.

``--devices`` starts a scheduler and a process of one thread for each device of this machine; ``--cluster`` uses a
running scheduler. Processes are spawned, never forked: a copy of a process that has used CUDA or threads is broken.
"""

from __future__ import annotations

import json
import logging
import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warp_plate.cluster.pool import WorkerPool
from warp_plate.cluster.tasks import DEVICE_VARIABLE
from warp_plate.interrupts import TERMINAL_SIGNALS, check_interrupt, deferred_interrupts
from warp_plate.scene.errors import SceneError, under
from warp_plate.solve.devices import find_device

if TYPE_CHECKING:
    from distributed import Client, SpecCluster

# Seconds that a scheduler has to answer.
ANSWER_SECONDS = 10.0
# Open files of the scheduler and its client, and of each worker.
FILES, FILES_A_WORKER = 32, 10
SETTINGS = {
    "distributed.admin.large-graph-warning-threshold": "1 GiB",  # a scene may name large files
    "distributed.scheduler.allowed-failures": 0,  # of a scheduler started here: run_tasks counts attempts
    # With Dask's defaults, two busy workers spend a tenth of a core on monitoring themselves.
    "distributed.worker.profile.enabled": False,
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.admin.tick.interval": "200ms",
}


@contextmanager
def open_pool(
    devices: str | None,
    cluster: str | None,
    device: str | None = None,
    log: Callable[[str], object] = lambda line: None,
    answer_seconds: float = ANSWER_SECONDS,
) -> Iterator[WorkerPool | None]:
    """Open the pool that ``--devices`` or ``--cluster`` ask for and close it at the end; None if neither is given.

    Args:
        devices: Devices of this machine, such as "cuda:0,cuda:1" or "cpu,cpu"; each has a process.
        cluster: "tcp://host:port" or the path of a scheduler file.
        device: Device of the cluster's workers (default: each one's own choice).
        log: Called with a line for people, the dashboard's address.
        answer_seconds: Time that the cluster's scheduler has to answer [s].

    Raises:
        SceneError: Both are given, no such device, no such scheduler, a worker that cannot start, or no Dask.
    """
    if devices is not None and cluster is not None:
        raise SceneError("--devices, --cluster: give one of them; workers of a cluster have their devices")
    name = f"--devices {devices}" if cluster is None else f"--cluster {cluster}"
    pool: WorkerPool | None = None
    try:
        if devices is not None:
            pool = _start_workers(_device_names(devices))
        elif cluster is not None:
            client = _connect(name, _scheduler_address(cluster), answer_seconds)
            pool = WorkerPool(client, name, device or "auto")
    except ImportError as error:
        raise SceneError(f"{name}: {error}: pip install 'warp-plate[cluster]'") from None
    if pool is None:
        yield None
        return
    try:
        while not pool.worker_count():
            time.sleep(0.1)
        if pool.dashboard:
            log(f"dashboard of the workers: {pool.dashboard}")
        yield pool
    finally:
        pool.close()


def _device_names(text: str) -> list[str]:
    """Return the devices of "cuda:0,cuda:1" as Warp names them."""
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise SceneError(f"--devices {text}: must be devices with commas between, such as cuda:0,cuda:1 or cpu,cpu")
    with under(f"--devices {text}"):
        return [find_device(name).alias for name in names]


def _scheduler_address(cluster: str) -> str:
    """Return the address of a scheduler: that given or that in its file."""
    if "://" in cluster:
        return cluster
    if not os.path.isfile(cluster):
        raise SceneError(f"--cluster {cluster}: no such file; must be tcp://HOST:PORT or a scheduler's file")
    try:
        return str(json.loads(Path(cluster).read_text(encoding="utf-8"))["address"])
    except (ValueError, KeyError, TypeError, RecursionError):
        raise SceneError(f"--cluster {cluster}: has no address, so no scheduler wrote it") from None


def _start_workers(devices: Sequence[str]) -> WorkerPool:
    """Start a scheduler and a worker for each device; who connects needs this run's certificate."""
    from dask import config
    from distributed import Nanny, Scheduler, Security, SpecCluster

    name = f"--devices {','.join(devices)}"
    _check_open_files(name, len(devices))
    config.set(SETTINGS)
    security = Security.temporary()
    place = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0", "protocol": "tls://", "security": security}
    scheduler = {"cls": Scheduler, "options": {**place, "dashboard": True}}
    environment = {"WARP_PLATE_THREADS": os.environ.get("WARP_PLATE_THREADS", "1")}
    workers = {}
    for number, device in enumerate(devices):
        options = {
            **place,
            "dashboard": False,
            "env": {**environment, DEVICE_VARIABLE: device},
            "nthreads": 1,
            "memory_limit": 0,  # only the machine's own limit counts
            "silence_logs": logging.CRITICAL,
        }
        workers[number] = {"cls": Nanny, "options": options}
    try:
        with deferred_interrupts(), interrupts_blocked():
            cluster = SpecCluster(workers, scheduler, security=security, silence_logs=logging.CRITICAL)
    except Exception as error:  # Dask raises that of its worker, of whatever kind
        check_interrupt()  # a SIGTERM to all processes ended that worker
        raise SceneError(f"{name}: workers cannot start: {_first_line(error)}") from None
    return WorkerPool(_connect(name, cluster), name, cluster=cluster)


def _check_open_files(name: str, workers: int) -> None:
    """Raise a SceneError if this process may not open the files that so many workers need."""
    with suppress(ImportError):  # no such limit here
        import resource

        most, needed = resource.getrlimit(resource.RLIMIT_NOFILE)[0], FILES + FILES_A_WORKER * workers
        if most != resource.RLIM_INFINITY and most < needed:
            raise SceneError(f"{name}: needs up to {needed} open files, but ulimit -n allows {most}")


def _connect(name: str, scheduler: str | SpecCluster, answer_seconds: float = ANSWER_SECONDS) -> Client:
    """Return a client of a scheduler."""
    from dask import config
    from distributed import Client

    class ClosedIfRefused(Client):
        """A client that closes when it cannot connect: the garbage collector, which closes Dask's, can deadlock."""

        def start(self, **options: Any) -> None:
            try:
                super().start(**options)
            except BaseException:
                self.close(timeout=1)
                raise

    config.set(SETTINGS)
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # errors are reported here in one line
    try:
        return ClosedIfRefused(scheduler, timeout=answer_seconds, set_as_default=False)
    except Exception as error:  # Dask raises a different one for each scheme of an address
        raise SceneError(f"{name}: no scheduler answers there: {_first_line(error)}") from None


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0] or type(error).__name__


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Keep Ctrl-C and SIGHUP from processes and threads that are started in the block; here they come after it."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, TERMINAL_SIGNALS)
    try:
        resource_tracker.ensure_running()  # unblocks SIGINT if the first process of a program starts it
        signal.pthread_sigmask(signal.SIG_BLOCK, TERMINAL_SIGNALS)
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

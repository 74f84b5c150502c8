"""A process for each device of this machine, by ``concurrent.futures``.

Processes are spawned, never forked: a copy of a process that has used CUDA or threads is broken.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from warp_plate.cluster.pool import WorkerPool
from warp_plate.cluster.tasks import DEVICE_VARIABLE, run_task
from warp_plate.interrupts import TERMINAL_SIGNALS
from warp_plate.scene.errors import SceneError
from warp_plate.solve.devices import find_device

# Libraries of linear algebra read these when a process begins.
ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"), "1")


@dataclass
class _Worker:
    device: str
    executor: ProcessPoolExecutor
    futures: list[Future[Any]] = field(default_factory=list)  # not done, or done since the last submit

    @property
    def load(self) -> int:
        return sum(not future.done() for future in self.futures)

    @property
    def failed(self) -> bool:
        """True if the process has ended, or raised an error after which CUDA may be unusable in it."""
        done = [future for future in self.futures if future.done() and not future.cancelled()]
        return any(not isinstance(future.exception(), (type(None), SceneError, MemoryError)) for future in done)


class LocalPool(WorkerPool):
    """A process for each device of this machine; one that fails is replaced."""

    def __init__(self, devices: Sequence[str]) -> None:
        super().__init__()
        self._context = multiprocessing.get_context("spawn")
        # Workers hold the other end, and end themselves when this one is closed, be it by the end of this process.
        self._workers_end, self._lifeline = self._context.Pipe(duplex=False)
        self._processes: set[BaseProcess] = set()
        self._workers = [_Worker(device, self._start(device)) for device in devices]

    @property
    def description(self) -> str:
        count, devices = len(self._workers), ", ".join(worker.device for worker in self._workers)
        return f"{count} process{'es' if count > 1 else ''} ({devices})"

    def worker_count(self) -> int:
        return len(self._workers)

    def submit(self, function: Callable[[Any], Any], argument: Any) -> Future[Any]:
        """Give a task to the worker that has the fewest."""
        worker = min(self._workers, key=lambda one: one.load)
        if worker.failed:
            worker.executor.shutdown(wait=False, cancel_futures=True)
            worker.executor, worker.futures = self._start(worker.device), []
        try:
            future = worker.executor.submit(run_task, function, argument)
        except BrokenExecutor as error:
            future = Future()
            future.set_exception(error)
        worker.futures = [one for one in worker.futures if not one.done()] + [future]
        return future

    def close(self) -> None:
        self._lifeline.close()
        for process in self._processes:  # one that hangs, or was stopped, would never end itself
            process.kill()
        for worker in self._workers:
            worker.executor.shutdown(cancel_futures=True)
        self._workers_end.close()

    def _start(self, device: str) -> ProcessPoolExecutor:
        executor = ProcessPoolExecutor(1, self._context, _start_worker, (device, self._workers_end))
        others = set(multiprocessing.active_children())
        with interrupts_blocked(), patched_environment(ONE_THREAD if device == "cpu" else {}):
            executor.submit(os.getpid)  # starts the process now
        self._processes |= set(multiprocessing.active_children()) - others
        return executor


def device_names(text: str) -> list[str]:
    """Return the devices of "cuda:0,cuda:1" as Warp names them.

    Raises:
        SceneError: One is not on this machine.
    """
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise SceneError(f"--devices {text}: must be devices with commas between, such as cuda:0,cuda:1 or cpu,cpu")
    try:
        return [find_device(name).alias for name in names]
    except SceneError as error:
        raise SceneError(f"--devices {text}: {error}") from None


@contextmanager
def patched_environment(values: Mapping[str, str]) -> Iterator[None]:
    """Give processes that are started in the block environment variables that are not set."""
    added = {name: value for name, value in values.items() if name not in os.environ}
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Keep Ctrl-C and SIGHUP from processes and threads that are started in the block; here they come after it."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, TERMINAL_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _start_worker(device: str, lifeline: Connection) -> None:
    """Prepare a worker process."""
    for number in TERMINAL_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    os.dup2(2, 1)  # output of libraries must not mix with that of the command
    os.environ[DEVICE_VARIABLE] = device
    if device == "cpu":
        os.environ.setdefault("WARP_PLATE_THREADS", "1")
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()


def _end_with(lifeline: Connection) -> None:
    with suppress(EOFError, OSError):
        lifeline.recv_bytes()
    os._exit(0)

"""Workers on this machine: one process for each device named, each with that device alone, chosen before Warp starts.

Processes are started anew, never forked: a copy of a process that has used CUDA or threads is broken.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from typing import IO, Any

from warp_plate.cluster.frames import Parts, encode, receive
from warp_plate.cluster.pool import Answer, Task, WorkersGone, fittest
from warp_plate.cluster.solver_spec import DEVICE
from warp_plate.scene.errors import SceneError
from warp_plate.solve.devices import find_device

# Tasks of full size with a worker at a time, so that the next one is there when one is done, and a GPU has begun with
# it; more would be given away before it is known who is done first.
DEPTH = {"cpu": 2.0, "cuda": 2.5}
# A worker that ends so often before it could do anything is not started again.
STARTS = 3
# Seconds until a worker that was asked to end is made to.
GRACE = 2.0
# Of a pipe, where the system lets it be as large: a block passes at once.
PIPE_BYTES = 2**20
# For a worker's C library, where it is glibc: what held one block holds the next, and is not given back in between.
MEMORY = {"MALLOC_MMAP_THRESHOLD_": str(2**25), "MALLOC_TRIM_THRESHOLD_": str(2**30)}
# A new Python finds what this one finds, and nothing in the folder that it happens to run in.
START = "import sys; sys.path[:] = sys.argv[1:]; from warp_plate.cluster.worker import main; main()"


def device_names(text: str) -> list[str]:
    """The devices of "cuda:0,cuda:1", as Warp names them.

    Raises:
        SceneError: one is not on this machine.
    """
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise SceneError(f"--devices {text}: must be devices with commas between, such as cuda:0,cuda:1 or cpu,cpu")
    try:
        return [find_device(name).alias for name in names]
    except SceneError as error:
        raise SceneError(f"--devices {text}: {error}") from None


@dataclass(eq=False)
class _Worker:
    """tickets: of the task that it is at, and then of those that wait with it, with their sizes. alone: the last was
    attempted before.
    outbox: what a thread of its own writes to it, so that nobody else waits for one that reads nothing; None: no more.
    """

    device: str
    process: subprocess.Popen[bytes]
    outbox: SimpleQueue[Parts | None] = field(default_factory=SimpleQueue)
    tickets: dict[int, float] = field(default_factory=dict)
    ready: bool = False
    alone: bool = False

    @property
    def name(self) -> str:
        """In answers."""
        return str(self.process.pid)

    @property
    def load(self) -> float:
        """Work that it has."""
        return sum(self.tickets.values())

    def room(self, task: Task | None) -> int:
        """For how many tasks of full size."""
        if (task is not None and task.attempts > 0) or (self.alone and self.tickets):
            return 1 - len(self.tickets)
        return int(DEPTH[self.device.partition(":")[0]] - self.load)


class Processes:
    """A pool of one process for each device; see ``pool.Pool``."""

    device = "auto"  # each process has but one

    def __init__(self, devices: Sequence[str]) -> None:
        self.told: Callable[[int, int], object] | None = None
        self.retried = Counter[str]()
        self._events: SimpleQueue[tuple[_Worker, dict[str, Any] | None]] = SimpleQueue()
        self._tickets = 0
        self._failed_starts: Counter[str] = Counter()
        self._workers: list[_Worker] = []
        self._last = ""
        self.words = f"{len(devices)} process{'es' if len(devices) > 1 else ''} ({', '.join(devices)})"
        for device in devices:
            self._start(device)

    @property
    def processes(self) -> list[int]:
        """Their numbers."""
        return [worker.process.pid for worker in self._workers]

    def free(self, task: Task | None = None) -> int:
        """See ``Pool``."""
        return sum(max(0, worker.room(task)) for worker in self._fit(task))

    def idle(self, task: Task | None = None) -> int:
        """See ``Pool``."""
        return sum(not worker.tickets for worker in self._fit(task))

    def submit(self, task: Task) -> int:
        """See ``Pool``; of the workers that have started, the one with the least work gets it."""
        self._tickets += 1
        parts = encode({"ticket": self._tickets, "name": task.name, "payload": task.payload})
        worker = min((one for one in self._fit(task) if one.room(task) > 0), key=lambda one: one.load)
        worker.tickets[self._tickets] = task.size
        worker.alone = task.attempts > 0
        worker.outbox.put(parts)
        return self._tickets

    def wait(self, seconds: float) -> list[tuple[int, Answer]]:
        """See ``Pool``."""
        if not self._workers:
            raise WorkersGone(f"no worker is left: {STARTS} in a row ended as they started; {self._last}")
        answers: list[tuple[int, Answer]] = []
        try:
            answers += self._hear(*self._events.get(timeout=seconds))
            while True:
                answers += self._hear(*self._events.get_nowait())
        except Empty:
            return answers

    def forget(self, ticket: int) -> None:
        """See ``Pool``: whoever is at it has no time for another task until it is done."""

    def abandon(self) -> None:
        """See ``Pool``: workers that are at work are ended, and others started when there is work again."""
        for worker in self._workers:
            if worker.tickets:
                worker.process.kill()

    def close(self) -> None:
        """See ``Pool``."""
        for worker in self._workers:
            worker.outbox.put(None)
        for worker in self._workers:
            try:
                worker.process.wait(GRACE)
            except subprocess.TimeoutExpired:
                worker.process.kill()
                worker.process.wait()
        self._workers = []

    def _fit(self, task: Task | None) -> list[_Worker]:
        """Who may get it now; a worker that has yet to start may be waited for."""
        names = fittest((worker.name for worker in self._workers), task)
        return [worker for worker in self._workers if worker.ready and worker.name in names]

    def _start(self, device: str) -> None:
        environment, own = {**MEMORY, **os.environ}, device
        if device.startswith("cuda"):
            index = int(device.partition(":")[2] or 0)
            seen = environment.get("CUDA_VISIBLE_DEVICES")
            environment["CUDA_VISIBLE_DEVICES"] = seen.split(",")[index] if seen else str(index)
            own = "cuda:0"
        else:
            environment.setdefault("WARP_PLATE_THREADS", "1")
        environment[DEVICE] = own
        process = subprocess.Popen(
            [sys.executable, "-c", START, *sys.path],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            start_new_session=True,  # Ctrl-C is for this process, which then ends its workers
        )
        for pipe in (process.stdin, process.stdout):
            _widen(pipe)
        worker = _Worker(device, process)
        self._workers.append(worker)
        for target in (self._listen, _write):
            threading.Thread(target=target, args=(worker,), daemon=True).start()

    def _listen(self, worker: _Worker) -> None:
        """In a thread of its own: hand on what a worker says, and that it has ended."""
        stream = worker.process.stdout
        assert stream is not None
        try:
            with stream:
                while (message := receive(stream)) is not None:
                    self._events.put((worker, message))
        finally:
            worker.process.kill()  # it has ended, or what it says is no answer
            worker.process.wait()
            self._events.put((worker, None))

    def _hear(self, worker: _Worker, message: dict[str, Any] | None) -> list[tuple[int, Answer]]:
        if worker not in self._workers:
            return []
        if message is None:
            how = worker.process.returncode
            why = f"its worker on {worker.device} ended ({f'signal {-how}' if how < 0 else f'status {how}'})"
            under = list(worker.tickets)[:1]
            for ticket in under:
                del worker.tickets[ticket]
            return [*((ticket, Answer(fault="lost", text=why)) for ticket in under), *self._ended(worker, why)]
        worker.ready = True
        self._failed_starts[worker.device] = 0
        if "ready" in message:
            return []
        del worker.tickets[message["ticket"]]
        answer = Answer(**message["answer"], worker=worker.name)
        return [(message["ticket"], answer), *(self._ended(worker, answer.text) if answer.fault == "lost" else [])]

    def _ended(self, worker: _Worker, why: str) -> list[tuple[int, Answer]]:
        """Start another in the place of one that has ended, or ends now; what waited with it waits again."""
        self._workers.remove(worker)
        worker.outbox.put(None)
        if not worker.ready:
            self._failed_starts[worker.device] += 1
        if self._failed_starts[worker.device] < STARTS:
            self._start(worker.device)
        self._last = why
        return [(ticket, Answer(fault="waiting", text=why)) for ticket in worker.tickets]


def _widen(pipe: IO[bytes] | None) -> None:
    with suppress(ImportError, AttributeError, OSError):  # not on this system, or not allowed
        import fcntl

        assert pipe is not None
        fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, PIPE_BYTES)


def _write(worker: _Worker) -> None:
    """In a thread of its own: what is for a worker, until it is to end."""
    stream = worker.process.stdin
    assert stream is not None
    with suppress(OSError), stream:  # it has ended: whoever listens to it will say so
        while (parts := worker.outbox.get()) is not None:
            stream.writelines(parts)
            stream.flush()

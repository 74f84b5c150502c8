"""A process of ``processes.Processes``: tasks come on standard input, answers go to standard output."""

from __future__ import annotations

import os
import signal
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from queue import SimpleQueue
from typing import IO, Any

from warp_plate.cluster.frames import receive, send

# A task that came, or the ticket of one with which the GPU is done.
Event = dict[str, Any] | int


def main() -> None:
    """Do tasks one after the other until standard input ends, which ends the process at once; and so does a task that
    raised what no task should: after an error of CUDA nothing in the process works any more.

    Those that come while a GPU is at others are begun, as many as there are states, so that it does not stand still.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for who started it
    answers = os.fdopen(os.dup(1), "wb")
    given = os.fdopen(os.dup(0), "rb")  # not sys.stdin, whose lock the thread would hold when Python ends
    os.dup2(2, 1)  # what libraries print must not come among the answers
    events: SimpleQueue[Event] = SimpleQueue()
    watched: SimpleQueue[tuple[int, Callable[[], object]]] = SimpleQueue()
    threading.Thread(target=_listen, args=(given, events), daemon=True).start()
    threading.Thread(target=_watch, args=(watched, events), daemon=True).start()
    from warp_plate.cluster.tasks import begin, gpu_end

    waiting: deque[dict[str, Any]] = deque()
    begun: deque[tuple[int, Callable[[], dict[str, Any]]]] = deque()

    def answer(last: int) -> None:
        """Those begun, up to this ticket."""
        while begun and begun[0][0] <= last:
            ticket, rest = begun.popleft()
            fields = rest()
            send({"ticket": ticket, "answer": fields}, answers)
            if fields.get("fault") == "lost":
                os._exit(1)

    send({"ready": os.getpid()}, answers)
    while True:
        event = events.get()
        if isinstance(event, dict):
            waiting.append(event)
        else:
            answer(event)
        while waiting and not begun:
            task = waiting.popleft()
            begun.append((task["ticket"], begin(task["name"], task["payload"], caught=True)))
            if (wait := gpu_end()) is None:
                answer(task["ticket"])
            else:
                watched.put((task["ticket"], wait))


def _listen(stream: IO[bytes], events: SimpleQueue[Event]) -> None:
    """The next task comes while one is done; who gave them is gone when there are no more, or what comes is none."""
    status = 1
    try:
        while (task := receive(stream)) is not None:
            events.put(task)
        status = 0
    finally:
        os._exit(status)


def _watch(watched: SimpleQueue[tuple[int, Callable[[], object]]], events: SimpleQueue[Event]) -> None:
    """Say when the GPU is done; what went wrong on it is said by who waits for the task's end."""
    while True:
        ticket, wait = watched.get()
        with suppress(Exception):
            wait()
        events.put(ticket)

"""A process of ``processes.Processes``: tasks come on standard input, answers go to standard output."""

from __future__ import annotations

import os
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

    Those that come while the GPU is at others are begun all the same, so that it has no pause between them.
    """
    answers = os.fdopen(os.dup(1), "wb")
    given = os.fdopen(os.dup(0), "rb")  # not sys.stdin, whose lock the thread would hold when Python ends
    os.dup2(2, 1)  # what libraries print must not come among the answers
    events: SimpleQueue[Event] = SimpleQueue()
    watched: SimpleQueue[tuple[int, Callable[[], object]]] = SimpleQueue()
    threading.Thread(target=_listen, args=(given, events), daemon=True).start()
    threading.Thread(target=_watch, args=(watched, events), daemon=True).start()
    from warp_plate.cluster.work import begin, gpu_end

    send({"ready": os.getpid()}, answers)
    begun: deque[tuple[int, Callable[[], dict[str, Any]]]] = deque()
    while True:
        event = events.get()
        if isinstance(event, dict):
            ticket = event["ticket"]
            begun.append((ticket, begin(event["name"], event["payload"], caught=True)))
            if (wait := gpu_end()) is not None:
                watched.put((ticket, wait))
                continue
            done = len(begun)
        else:  # answered already where the GPU stood still when a later one had been begun
            done = sum(ticket <= event for ticket, _ in begun)
        for ticket, rest in [begun.popleft() for _ in range(done)]:
            answer = rest()
            send({"ticket": ticket, "answer": answer}, answers)
            if answer.get("fault") == "lost":
                os._exit(1)


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
        with suppress(RuntimeError):
            wait()
        events.put(ticket)

"""A process of ``processes.Processes``: tasks come on standard input, answers go to standard output."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import IO, Any

from warp_plate.cluster.frames import receive, send

# Seconds between looks at a GPU while a task may come, at first and at most, and after which it is no longer looked at:
# one that has failed is never done.
LOOK, LONGEST_LOOK, LOOKS = 1e-4, 5e-3, 0.1


def main() -> None:
    """Do tasks one after the other until standard input ends, which ends the process at once; and so does a task that
    raised what no task should: after an error of CUDA nothing in the process works any more.

    One that comes within LOOKS seconds, while the GPU is at the last, is begun before that is waited for, so that it is
    not idle between them.
    """
    answers = os.fdopen(os.dup(1), "wb")
    given = os.fdopen(os.dup(0), "rb")  # not sys.stdin, whose lock the thread would hold when Python ends
    os.dup2(2, 1)  # what libraries print must not come among the answers
    tasks: SimpleQueue[dict[str, Any]] = SimpleQueue()
    threading.Thread(target=_listen, args=(given, tasks), daemon=True).start()
    from warp_plate.cluster.work import at_work, begin

    def following() -> dict[str, Any] | None:
        """The next task; None where none comes while the GPU is at the one begun."""
        look, until = LOOK, time.monotonic() + LOOKS
        while True:
            with suppress(Empty):
                return tasks.get(timeout=look)
            if not at_work() or time.monotonic() > until:
                return None
            look = min(1.5 * look, LONGEST_LOOK)

    send({"ready": os.getpid()}, answers)
    begun: tuple[int, Callable[[], dict[str, Any]]] | None = None
    while True:
        task = tasks.get() if begun is None else following()
        after = None
        if task is not None:
            after = task["ticket"], begin(task["name"], task["payload"], caught=True)
        if begun is not None:
            ticket, rest = begun
            answer = rest()
            send({"ticket": ticket, "answer": answer}, answers)
            if answer.get("fault") == "lost":
                os._exit(1)
        begun = after


def _listen(stream: IO[bytes], tasks: SimpleQueue[dict[str, Any]]) -> None:
    """The next task comes while one is done; who gave them is gone when there are no more, or what comes is none."""
    status = 1
    try:
        while (task := receive(stream)) is not None:
            tasks.put(task)
        status = 0
    finally:
        os._exit(status)

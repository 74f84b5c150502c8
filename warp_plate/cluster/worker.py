"""A process of ``processes.Processes``: tasks come on standard input, answers go to standard output."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import IO, Any

from warp_plate.cluster.frames import receive, send


def main() -> None:
    """Do tasks one after the other until standard input ends, which ends the process at once; and so does a task that
    raised what no task should: after an error of CUDA nothing in the process works any more.

    The next one is begun before the last is waited for, so that a GPU is never idle between them.
    """
    answers = os.fdopen(os.dup(1), "wb")
    given = os.fdopen(os.dup(0), "rb")  # not sys.stdin, whose lock the thread would hold when Python ends
    os.dup2(2, 1)  # what libraries print must not come among the answers
    tasks: SimpleQueue[dict[str, Any]] = SimpleQueue()
    threading.Thread(target=_listen, args=(given, tasks), daemon=True).start()
    from warp_plate.cluster.work import begin

    send({"ready": os.getpid()}, answers)
    begun: tuple[int, Callable[[], dict[str, Any]]] | None = None
    while True:
        following = None
        if begun is None or not tasks.empty():
            task = tasks.get()
            following = task["ticket"], begin(task["name"], task["payload"], caught=True)
        if begun is not None:
            ticket, rest = begun
            answer = rest()
            send({"ticket": ticket, "answer": answer}, answers)
            if answer.get("fault") == "lost":
                os._exit(1)
        begun = following


def _listen(stream: IO[bytes], tasks: SimpleQueue[dict[str, Any]]) -> None:
    """The next task comes while one is done; who gave them is gone when there are no more, or what comes is none."""
    status = 1
    try:
        while (task := receive(stream)) is not None:
            tasks.put(task)
        status = 0
    finally:
        os._exit(status)

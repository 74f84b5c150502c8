"""A process of ``processes.Processes``: tasks come on standard input, answers go to standard output."""

from __future__ import annotations

import os
import sys
import threading
from queue import SimpleQueue
from typing import IO, Any

from warp_plate.cluster.frames import receive, send


def main() -> None:
    """Do tasks one after the other until standard input ends, which ends the process at once."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print must not come among the answers
    tasks: SimpleQueue[dict[str, Any]] = SimpleQueue()
    threading.Thread(target=_listen, args=(sys.stdin.buffer, tasks), daemon=True).start()
    from warp_plate.cluster.work import perform

    send({"ready": os.getpid()}, answers)
    while True:
        task = tasks.get()
        send({"ticket": task["ticket"], "answer": perform(task["name"], task["payload"])}, answers)


def _listen(stream: IO[bytes], tasks: SimpleQueue[dict[str, Any]]) -> None:
    """The next task comes while one is done; who gave them is gone when there are no more."""
    while (task := receive(stream)) is not None:
        tasks.put(task)
    os._exit(0)

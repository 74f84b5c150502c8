"""Ctrl-C in a command: heard soon, but not where Python would lose it."""

from __future__ import annotations

import _thread
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

# Seconds after which a Ctrl-C that came at a bad moment is tried again.
AGAIN = 0.02


@contextmanager
def at_safe_moments() -> Iterator[None]:
    """While this lasts, Ctrl-C raises KeyboardInterrupt once no module is being imported and no object taken away.

    Python loses an exception that is raised in a callback or in ``__del__``, and within an import it may then keep a
    lock for ever, so that the next thread that imports something waits without end.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, _interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _interrupt(number: int, frame: FrameType | None) -> None:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib") or frame.f_code.co_name == "__del__":
            later = threading.Timer(AGAIN, _thread.interrupt_main)
            later.daemon = True
            later.start()
            return
        frame = frame.f_back
    raise KeyboardInterrupt

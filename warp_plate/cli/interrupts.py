"""Ctrl-C in a command: heard soon, but not where Python would lose it."""

from __future__ import annotations

import _thread
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

# Seconds after which a Ctrl-C that came at a bad moment is tried again.
AGAIN = 0.02
_later: threading.Timer | None = None


@contextmanager
def at_safe_moments() -> Iterator[None]:
    """While this lasts, Ctrl-C raises KeyboardInterrupt once no module is being imported and no object taken away.

    Within an import Python may keep a lock for ever, so that the next thread that imports something waits without end.
    What is raised in ``__del__`` or in a callback is lost, and some libraries written in C or Rust lose it as well:
    Python reports each such loss, and Ctrl-C is then tried again.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    report = sys.unraisablehook

    def lost(what: sys.UnraisableHookArgs) -> None:
        if issubclass(what.exc_type, KeyboardInterrupt):
            _again()
        else:
            report(what)

    before = signal.signal(signal.SIGINT, _interrupt)
    sys.unraisablehook = lost
    try:
        yield
    finally:
        _cancel()  # what was to be ended has ended
        sys.unraisablehook = report
        signal.signal(signal.SIGINT, before)


def _interrupt(number: int, frame: FrameType | None) -> None:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib") or frame.f_code.co_name == "__del__":
            return _again()
        frame = frame.f_back
    raise KeyboardInterrupt


def _again() -> None:
    global _later
    _later = threading.Timer(AGAIN, _wake)
    _later.daemon = True
    _later.start()


def _cancel() -> None:
    if _later is not None:
        _later.cancel()


def _wake() -> None:
    """Ctrl-C once more, heard by the main thread at once even where it waits."""
    if sys.platform == "win32":
        _thread.interrupt_main()
    else:
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)

"""Ctrl-C: a flag that long loops look at between iterations, and an ordinary KeyboardInterrupt everywhere else."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_pending = False


class SecondInterrupt(KeyboardInterrupt):
    """A second Ctrl-C, before the first was looked at: whatever was being updated may be half done."""


@contextmanager
def deferred_interrupts() -> Iterator[None]:
    """Make Ctrl-C wait for the next call of ``check_interrupt``, at the latest for the end of the block.

    A second Ctrl-C raises ``SecondInterrupt`` at once. Outside the main thread, where Python never raises
    KeyboardInterrupt, this does nothing.
    """
    previous = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(previous):
        yield
        return
    signal.signal(signal.SIGINT, _set_flag)
    try:
        yield
        check_interrupt()
    finally:
        signal.signal(signal.SIGINT, previous)


def check_interrupt() -> None:
    """Raise KeyboardInterrupt if Ctrl-C was pressed in ``deferred_interrupts``, or if Python lost it."""
    global _pending
    if _pending and threading.current_thread() is threading.main_thread():
        _pending = False
        raise KeyboardInterrupt


def remember_lost_interrupts() -> None:
    """Let ``check_interrupt`` raise again a KeyboardInterrupt that Python could only report, as in ``__del__``."""
    report = sys.unraisablehook

    def hook(unraisable: sys.UnraisableHookArgs) -> None:
        global _pending
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            _pending = True
        else:
            report(unraisable)

    sys.unraisablehook = hook


def _set_flag(signal_number: int, frame: object) -> None:
    global _pending
    _pending = not _pending
    if not _pending:
        raise SecondInterrupt

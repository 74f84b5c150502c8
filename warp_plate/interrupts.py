"""Ctrl-C: a flag that long loops check between iterations, and an ordinary KeyboardInterrupt everywhere else.

SIGTERM, which batch systems send before they kill, and SIGHUP of a closed terminal end a command in the same way.
"""

from __future__ import annotations

import _thread
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

# Sent by a terminal to all processes of a command; Windows has no SIGHUP.
TERMINAL_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGHUP") if hasattr(signal, name))
END_SIGNALS = (*TERMINAL_SIGNALS, signal.SIGTERM)
# Time after which an interrupt that was lost is repeated [s].
REPEATED = 0.01
_pending = False


class SecondInterrupt(KeyboardInterrupt):
    """A second Ctrl-C before the first was handled: an update may be incomplete."""


@contextmanager
def deferred_interrupts() -> Iterator[None]:
    """Make Ctrl-C wait for the next call of ``check_interrupt``, at the latest for the end of the block.

    A second Ctrl-C raises ``SecondInterrupt`` at once. Outside the main thread, where Python never raises
    KeyboardInterrupt, this does nothing.
    """
    with end_signals(_set_flag):
        yield
        check_interrupt()


@contextmanager
def postponed_interrupts() -> Iterator[None]:
    """Make Ctrl-C, however often it comes in the block, wait for the first ``check_interrupt`` after it.

    For what ends within seconds, and must end before files are written or the program ends.
    """
    with end_signals(_remember):
        yield


@contextmanager
def end_signals(handle: Callable[[int, Any], object]) -> Iterator[None]:
    """Handle Ctrl-C, SIGTERM and SIGHUP by a function, unless they are ignored; outside the main thread do nothing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = {number: handler for number in END_SIGNALS if callable(handler := signal.getsignal(number))}
    for number in previous:
        signal.signal(number, handle)
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def check_interrupt() -> None:
    """Raise KeyboardInterrupt if Ctrl-C was pressed in ``deferred_interrupts``."""
    global _pending
    if _pending and threading.current_thread() is threading.main_thread():
        _pending = False
        raise KeyboardInterrupt


def interrupt_on_termination() -> None:
    """Raise KeyboardInterrupt also on SIGTERM and SIGHUP, unless they are ignored as under ``nohup``."""
    for number in END_SIGNALS:
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, signal.default_int_handler)


def ignore_interrupts() -> None:
    """Ignore Ctrl-C, SIGTERM and SIGHUP for good, when a command is done and only Python has to end."""
    if threading.current_thread() is threading.main_thread():
        for number in END_SIGNALS:
            signal.signal(number, signal.SIG_IGN)


def repeat_lost_interrupts() -> None:
    """Send SIGTERM soon after a KeyboardInterrupt that Python could only report, as in ``__del__`` or an import."""
    report = sys.unraisablehook

    def hook(unraisable: sys.UnraisableHookArgs) -> None:
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            again = threading.Timer(REPEATED, _thread.interrupt_main, [signal.SIGTERM])
            again.daemon = True
            again.start()
        else:
            report(unraisable)

    sys.unraisablehook = hook


def _remember(signal_number: int, frame: object) -> None:
    global _pending
    _pending = True


def _set_flag(signal_number: int, frame: object) -> None:
    global _pending
    second = _pending and signal_number == signal.SIGINT  # other signals often come in pairs
    _pending = not second
    if second:
        raise SecondInterrupt

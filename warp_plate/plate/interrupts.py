"""Ctrl-C at the right moments: it waits while particles move, threads share work, or a file is written."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

LetThrough = Callable[[], AbstractContextManager[None]]


@contextmanager
def interrupts_held() -> Iterator[LetThrough]:
    """While this lasts Ctrl-C is heard only under the context manager that is yielded; else it waits for the next.

    One that still waits at the end is heard then. Outside the main thread, where Python never raises
    KeyboardInterrupt, nothing changes.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield nullcontext
        return
    heard = before
    through = waiting = False

    def handle(number: int, frame: object) -> None:
        nonlocal waiting
        if through:
            heard(number, frame)  # type: ignore[arg-type]
        else:
            waiting = True

    def hear() -> None:
        nonlocal waiting
        if waiting:
            waiting = False
            heard(signal.SIGINT, None)

    @contextmanager
    def let_through() -> Iterator[None]:
        nonlocal through
        through = True
        try:
            hear()
            yield
        finally:
            through = False

    signal.signal(signal.SIGINT, handle)
    try:
        yield let_through
    finally:
        signal.signal(signal.SIGINT, before)
        hear()

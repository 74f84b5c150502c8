"""Wall time of the command that runs."""

from __future__ import annotations

import time

_began = time.perf_counter()


def restart() -> None:
    """Begin a command."""
    global _began
    _began = time.perf_counter()


def elapsed() -> float:
    """Return the seconds since the command began."""
    return time.perf_counter() - _began

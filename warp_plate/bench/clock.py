"""Seconds that a piece of work takes on a device."""

from __future__ import annotations

import time
from collections.abc import Callable

import warp as wp


def seconds_of(work: Callable[[], None], device: wp.Device) -> float:
    """From an idle device to an idle device: what is still queued counts for neither side [s]."""
    wp.synchronize_device(device)
    start = time.perf_counter()
    work()
    wp.synchronize_device(device)
    return time.perf_counter() - start

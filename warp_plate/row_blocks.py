"""Work on the rows of large arrays, shared among threads, and arrays shared among callers.

NumPy releases Python's lock inside a block and treats each row by itself, so that no number depends on the cut.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np

# Fewest rows of a block; threads do not pay for less. More threads than MOST_THREADS wait for each other.
FEWEST_ROWS = 8192
MOST_THREADS = 8


def over_blocks(task: Callable[[slice], object], rows: int) -> None:
    """Call ``task`` with slices that together are all rows, one for each thread.

    A task sets ``np.errstate`` itself if it needs one: threads begin with NumPy's default.
    """
    size = max(FEWEST_ROWS, -(-rows // _threads()))
    blocks = [slice(first, min(first + size, rows)) for first in range(0, rows, size)]
    if len(blocks) == 1:
        task(blocks[0])
    elif blocks:
        list(_pool().map(task, blocks))


def read_only(*arrays: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return arrays that are kept for later callers after forbidding to write to them."""
    for array in arrays:
        array.flags.writeable = False
    return arrays


@cache
def _threads() -> int:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    setting = os.environ.get("WARP_PLATE_THREADS", "")
    return max(1, min(int(setting[:4]) if setting.isdecimal() else cores, MOST_THREADS))


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(_threads(), thread_name_prefix="rows of arrays")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # a fork copies no threads

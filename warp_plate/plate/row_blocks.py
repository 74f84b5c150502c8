"""Work on the rows of large arrays, in blocks that stay in a core's cache and are shared among threads.

NumPy lets go of Python's lock inside a block, and takes each row by itself, so that no number depends on the cut.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

# Rows of a block; so few rows take one call and no thread, also those of the largest blocks that workers get of the
# paper's scene (``cluster.evaluator``). More threads than that wait for each other.
ROWS = 8448
MOST_THREADS = 8


def over_blocks(task: Callable[[slice], object], rows: int) -> None:
    """Call ``task`` with slices that together are all rows; it writes its part of what is asked for.

    A task sets ``np.errstate`` itself, if it needs one: threads begin with NumPy's own.
    """
    blocks = [slice(first, min(first + ROWS, rows)) for first in range(0, rows, ROWS)]
    if len(blocks) <= 1:
        for block in blocks:
            task(block)
        return
    for done in [_pool().submit(task, block) for block in blocks]:
        done.result()


@cache
def _pool() -> ThreadPoolExecutor:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    told = os.environ.get("WARP_PLATE_THREADS", "")  # checked where the CPU's own threads are counted
    threads = int(told) if told.isdecimal() else cores
    return ThreadPoolExecutor(max(1, min(threads, MOST_THREADS)), thread_name_prefix="rows of arrays")

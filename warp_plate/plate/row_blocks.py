"""Work on the rows of large arrays, in blocks that stay in a core's cache and are shared among threads.

NumPy releases Python's lock inside a block and treats each row by itself, so that no number depends on the cut.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

# Rows of a block: fewer take one call and no thread. More threads than MOST_THREADS wait for each other.
ROWS = 8448
MOST_THREADS = 8


def over_blocks(task: Callable[[slice], object], rows: int) -> None:
    """Call ``task`` with slices that together are all rows.

    A task sets ``np.errstate`` itself if it needs one: threads begin with NumPy's default.
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
    setting = os.environ.get("WARP_PLATE_THREADS", "")
    threads = int(setting) if setting.isdecimal() else cores
    return ThreadPoolExecutor(max(1, min(threads, MOST_THREADS)), thread_name_prefix="rows of arrays")

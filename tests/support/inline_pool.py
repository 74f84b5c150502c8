"""A pool for tests: one worker, which is this process."""

import os
import signal
from concurrent.futures import Future
from pathlib import Path
from unittest.mock import Mock

from warp_plate.cluster.pool import WorkerPool
from warp_plate.cluster.tasks import run_task


class KilledWorker(Exception):
    """What Dask raises if a worker ended."""


class InlinePool(WorkerPool):
    """Runs each task when it is submitted."""

    description = "this process"

    def __init__(self, device="cpu"):
        self.device = device
        self.block_node_steps = {"cpu": (1.0, 1.0)}  # blocks of the fewest plates

    def worker_count(self):
        return 1

    def submit(self, function, argument):
        future = Future()
        try:
            future.set_result(self.run(function, argument))
        except Exception as error:
            future.set_exception(error)
        return future

    def run(self, function, argument):
        """Run a task; overridden by tests whose workers fail."""
        return run_task(function, argument)

    def close(self):
        pass


def press_twice(**options):
    os.kill(os.getpid(), signal.SIGINT)
    os.kill(os.getpid(), signal.SIGINT)


class InterruptedPool(InlinePool):
    """One that Ctrl-C finds twice while it closes, and twice in a task once a search has a checkpoint."""

    dashboard, _client, _cluster, close = "", Mock(close=press_twice), None, WorkerPool.close

    def run(self, function, argument):
        if Path("panel-localize.checkpoint.h5").exists():
            press_twice()
        return super().run(function, argument)

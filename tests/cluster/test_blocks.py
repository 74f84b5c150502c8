"""What workers get: blocks of plates between their limits, sent as their numbers."""

import pickle
import subprocess
import sys
import threading
from concurrent.futures import Future
from contextlib import suppress
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from support.inline_pool import InlinePool
from warp_plate import PlateSolver, Scene
from warp_plate.cluster.evaluator import block_size
from warp_plate.cluster.pool import BLOCK_NODE_STEPS, Task, WorkerPool, WorkersGone, run_tasks
from warp_plate.cluster.tasks import Evaluation, SolverSpec, make_solver
from warp_plate.plate.designs import Designs


@pytest.mark.parametrize(("kind", "least", "most"), [("cpu", 128, 1024), ("cuda", 2112, 33792)])
def test_blocks_of_the_papers_plates(kind, least, most):
    """Two for each worker, of a multiple of 64 plates, or more where these would be too large."""
    node_steps, work = PlateSolver(Scene.load("paper"), "cpu").node_steps_per_plate, BLOCK_NODE_STEPS[kind]
    assert block_size(100 * most, 2, node_steps, work) == most
    assert block_size(10, 2, node_steps, work) == least
    assert block_size(4 * 5 * most // 8 - 3, 2, node_steps, work) == 5 * most // 8


def test_a_plate_is_sent_as_its_numbers():
    """16 bytes for each actuator, 8 for each frequency, delay and coordinate; 8 come back for each region."""

    def bytes_a_plate(make):
        whole, half = (len(pickle.dumps(make(count))) for count in (3000, 1500))
        return (whole - half) / 1500

    def designs(count):
        values = {"frequency": np.ones((count, 4)), "centre": np.ones((count, 4, 2)), "delay": np.ones((count, 4))}
        return Designs(np.ones((count, 4), complex), **values)

    assert bytes_a_plate(lambda count: Designs(np.ones((count, 4), complex))) == pytest.approx(64, abs=0.1)
    assert bytes_a_plate(designs) == pytest.approx(64 + 4 * 8 * 4, abs=0.1)
    assert bytes_a_plate(lambda count: Evaluation(np.ones((count, 2)), 0, {})) == pytest.approx(16, abs=0.1)


def test_a_worker_keeps_a_solver_of_its_own_device_and_threads(scene, monkeypatch):
    monkeypatch.setenv("WARP_PLATE_DEVICE", "cpu")
    monkeypatch.delenv("WARP_PLATE_THREADS", raising=False)
    spec = SolverSpec.of(scene((9, 9)), "cuda:99", "auto")
    solver = make_solver(spec)
    assert (solver.device.alias, solver.specialized.threads) == ("cpu", 1)
    assert make_solver(pickle.loads(pickle.dumps(spec))) is solver
    monkeypatch.setenv("WARP_PLATE_THREADS", "3")
    assert make_solver(SolverSpec.of(scene((9, 9)), "cuda:99", "auto")).specialized.threads == 3


def test_workers_that_hang_are_killed_until_all_have_ended(monkeypatch):
    """Dask may start another in place of one that was killed, until it learns that it is to end."""
    monkeypatch.setattr("warp_plate.cluster.pool.END_SECONDS", 0.1)
    nanny, statuses = SimpleNamespace(pid=None), []

    def close():
        for _ in range(3):
            with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as worker:
                nanny.pid = worker.pid
                with suppress(subprocess.TimeoutExpired):
                    worker.wait(20)
                statuses.append(worker.poll())
                worker.kill()

    cluster = SimpleNamespace(_created=[nanny], close=close)
    WorkerPool(Mock(), "--devices cpu", cluster=cluster).close()
    assert None not in statuses


def test_a_minute_passes_until_no_worker_is_left(monkeypatch):
    """For the first one, and whenever all are lost."""
    client, now = Mock(status="running", **{"sync.return_value": {}}), 0.0
    monkeypatch.setattr("warp_plate.cluster.pool.time", Mock(monotonic=lambda: now))
    pool = WorkerPool(client, "--cluster tcp://far:8786")
    for start in (0.0, 1000.0):
        now = start
        if start:
            client.sync.return_value = {"worker": 2}
            assert pool.worker_count() == 2
            client.sync.return_value = {}
        now = start + 59
        assert pool.worker_count() == 0
        now = start + 61
        with pytest.raises(WorkersGone, match="has had no worker for a minute"):
            pool.worker_count()


class Deserted(InlinePool):
    """A worker that is lost with its task."""

    counts = iter([1])

    def worker_count(self):
        if count := next(self.counts, 0):
            return count
        raise WorkersGone("no worker is left: of a test")

    def submit(self, function, argument):
        future = Future()
        late = threading.Timer(3.0, lambda: future.cancelled() or future.set_result(None))  # if nobody notices
        late.daemon = True
        late.start()
        return future


def test_workers_that_are_lost_with_all_tasks_are_not_waited_for():
    with pytest.raises(WorkersGone, match="of a test"):
        list(run_tasks(Deserted(), [Task(abs, 1)]))

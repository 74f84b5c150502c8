"""Plates on Dask's workers: the same bits, and the right answer when workers or their scheduler end."""

import gc
import os
import signal
import socket
import ssl
import subprocess
import sys
import threading
import time
from contextlib import suppress

import numpy as np
import pytest

from support.inline_pool import InlinePool
from support.worker_tasks import doubled, end_worker, process_number
from support.workers import assert_same_history, assert_same_run, random_phasors, small_search
from warp_plate import CheckpointFile, PlateSolver, SceneError, load_checkpoint, localize, resume
from warp_plate.cluster import opening
from warp_plate.cluster.evaluator import make_evaluator
from warp_plate.cluster.opening import open_pool
from warp_plate.cluster.pool import ATTEMPTS, Task, WorkersGone, run_tasks

distributed = pytest.importorskip("distributed")
dask = pytest.importorskip("dask")
psutil = pytest.importorskip("psutil")  # which Dask needs as well
needs_listeners = pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells who listens where")


LINES = []  # logged as the pool was opened


@pytest.fixture(scope="module")
def pool():
    """Two workers of this machine, started once for all tests here."""
    with open_pool(None, "local:2", log=LINES.append) as made:
        yield made


def worker_processes(pool):
    """The processes of both workers."""
    found = set()
    while len(found) < 2:
        tasks = [Task(process_number, 0.05) for _ in range(8)]
        found |= {outcome.value for _, outcome in run_tasks(pool, tasks)}
    return sorted(found)


def test_a_search_is_the_same_on_dask(pool, scene):
    made = small_search(scene, iterations=2)
    result = localize(made, device="cpu", estimate=False, pool=pool)
    assert_same_history(result, localize(made, device="cpu", estimate=False))
    assert result.device.endswith("plates of the search on up to 2 Dask workers of local:2")
    assert os.getpid() not in worker_processes(pool)
    assert LINES[0].startswith("dashboard of the workers: http://127.0.0.1:")


def listening(pool):
    """The addresses at which this process and the workers' listen."""
    processes = [psutil.Process(number) for number in (os.getpid(), *worker_processes(pool))]
    return [
        connection.laddr
        for process in processes
        for connection in getattr(process, "net_connections", process.connections)("inet")
        if connection.status == psutil.CONN_LISTEN
    ]


@needs_listeners
def test_nothing_listens_but_to_this_machine(pool):
    """Scheduler, workers, nannies and dashboards."""
    found = listening(pool)
    assert len(found) >= 4
    assert {address.ip for address in found} == {"127.0.0.1"}


@needs_listeners
def test_who_lacks_the_certificate_is_refused(pool):
    """The dashboards, which run nothing, speak HTTP."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    refused = []
    for address in listening(pool):
        with socket.create_connection(address, 60) as plain:
            plain.sendall(b"GET / HTTP/1.0\r\n\r\n")
            with suppress(ConnectionError):
                if plain.recv(4) == b"HTTP":
                    continue
        opened = context.wrap_socket(socket.create_connection(address, 60))
        with opened, pytest.raises(ssl.SSLError, match="CERTIFICATE_REQUIRED"):
            opened.recv(1)
        refused.append(address)
    assert len(refused) >= 3  # scheduler and workers


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_workers_killed_at_random_moments_change_nothing(pool, scene, random):
    made, phasors = scene((9, 9), window=(0.002, 0.02), damping=20.0), random_phasors(random, 1500)
    expected = PlateSolver(made, "cpu").run(phasors)
    evaluator = make_evaluator(made, "cpu", pool=pool)
    evaluator.run(phasors)
    victim = int(random.choice(worker_processes(pool)))
    killer = threading.Timer(random.uniform(0, 0.5), os.kill, (victim, signal.SIGKILL))
    killer.start()
    assert_same_run(evaluator.run(phasors), expected)
    killer.join()
    assert not evaluator.lost


@pytest.mark.slow
def test_a_task_that_no_worker_survives(pool):
    """The tasks that wait with it are not to blame."""
    tasks = [Task(end_worker, 0, "end"), *(Task(doubled, value, value) for value in range(9))]
    found = {task.key: outcome for task, outcome in run_tasks(pool, tasks)}
    assert found.pop("end").failure == f"given up after {ATTEMPTS} attempts: its worker ended"
    assert {value: outcome.value for value, outcome in found.items()} == {value: 2 * value for value in range(9)}


def test_no_scheduler_is_one_line(tmp_path, monkeypatch):
    """Each client is closed at once: if the garbage collector did it, two of them could wait for each other."""
    monkeypatch.setattr(opening, "ANSWER_SECONDS", 0.5)
    open_clients = []
    monkeypatch.setattr(distributed.Client, "__del__", lambda client: open_clients.append(client.status))
    file = tmp_path / "scheduler.json"
    for text in ("x", '{"address": 7}', "[1]", "[" * 10**5):
        file.write_text(text, encoding="utf-8")
        line = r"scheduler.json: (has no address|no scheduler answers there)"
        with pytest.raises(SceneError, match=line), open_pool(None, str(file)):
            pass
    for where in ("tcp://127.0.0.1:1", "tls://127.0.0.1:1", "ucx://127.0.0.1:1"):  # a reserved port
        with pytest.raises(SceneError, match=f"--cluster {where}: no scheduler answers there"), open_pool(None, where):
            pass
    gc.collect()
    assert set(open_clients) <= {"closed"}
    assert dask.config.get("scheduler", None) is None  # Dask's other users in this process keep theirs


def start(*words):
    """Start a program of Dask's, as ``dask scheduler`` and ``dask worker`` are."""
    return subprocess.Popen([sys.executable, "-m", *words, "--host", "127.0.0.1"], stderr=subprocess.DEVNULL)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_a_scheduler_that_goes_away_leaves_a_checkpoint(tmp_path, scene, monkeypatch):
    """A search with the scheduler's file continues in this process, to the same result."""
    monkeypatch.setattr(opening, "JOIN_SECONDS", 5.0)
    made, file = small_search(scene, iterations=400), tmp_path / "scheduler.json"
    scheduler = start("distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(file))
    while not file.exists():
        time.sleep(0.1)
    worker = start("distributed.cli.dask_worker", "--nthreads", "1", "--no-dashboard", "--scheduler-file", str(file))
    path = tmp_path / "panel.checkpoint.h5"

    def after(done, total, best):
        if done == 5:
            scheduler.kill()

    try:
        checkpoints = CheckpointFile(path, np.inf)
        with open_pool(None, str(file)) as there, pytest.raises(WorkersGone, match="the scheduler is gone"):
            localize(made, device="cpu", estimate=False, pool=there, on_progress=after, checkpoints=checkpoints)
    finally:
        for process in (scheduler, worker):
            process.kill()
            process.wait()
    begun = load_checkpoint(path)
    assert 5 <= begun.iterations < 400
    result = resume(begun, "cpu", estimate=False, pool=InlinePool())
    assert_same_history(result, localize(made, device="cpu", estimate=False))

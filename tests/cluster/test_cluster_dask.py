"""Plates on Dask's workers: the same bits, and the right answer when workers or their scheduler end."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from test_cluster import assert_same, assert_same_result, doubled, drives_of, searched
from test_cluster_faults import LINE, failing, starved

from warp_plate import CheckpointFile, PlateSolver, SceneError, load_checkpoint, localize, resume
from warp_plate.cluster import blocks, dask
from warp_plate.cluster.opening import open_pool
from warp_plate.cluster.pool import Here, Task, WorkersGone
from warp_plate.cluster.scheduler import ATTEMPTS, spread
from warp_plate.cluster.solver import SpreadSolver

pytest.importorskip("distributed")
LISTENS = "0A"


@pytest.fixture(scope="module")
def told():
    """What was told as the pool was opened."""
    return []


@pytest.fixture(scope="module")
def pool(told):
    """Two workers of this machine, started once for all tests here."""
    with open_pool(None, "local:2", tell=told.append) as made:
        yield made


@pytest.fixture
def small_blocks(monkeypatch):
    """Of the fewest plates that a block has."""
    monkeypatch.setitem(blocks.BLOCK_NODE_STEPS, "cpu", 1.0)


def number(payload):
    """The process that a task is done in."""
    time.sleep(payload["seconds"])
    return {"process": os.getpid()}


def numbers(pool):
    """Those of both workers."""
    found = set()
    while len(found) < 2:
        tasks = [Task(number, {"seconds": 0.05}) for _ in range(8)]
        found |= {answer.value["process"] for _, answer in spread(pool, tasks)}
    return sorted(found)


def test_a_search_is_the_same_on_dask(pool, told, scene, small_blocks):
    made = searched(scene)
    result = localize(made, device="cpu", estimate=False, pool=pool)
    assert_same_result(result, localize(made, device="cpu", estimate=False))
    assert result.device.endswith("plates of the search on up to 2 Dask workers of local:2")
    assert os.getpid() not in numbers(pool)
    assert told[0].startswith("dashboard of the workers: http://127.0.0.1:")


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="only Linux tells who listens where")
def test_nothing_listens_but_to_this_machine(pool):
    """Scheduler, workers, nannies and dashboards."""
    sockets = set()
    for process in (os.getpid(), *numbers(pool)):
        links = [os.readlink(link) for link in Path(f"/proc/{process}/fd").iterdir() if link.is_symlink()]
        sockets |= {link[len("socket:[") : -1] for link in links if link.startswith("socket:[")}
    found = []
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text().splitlines()[1:]:
            place, state, inode = (line.split()[index] for index in (1, 3, 9))
            if state == LISTENS and inode in sockets:
                found.append(place.partition(":")[0])
    assert len(found) >= 4
    assert set(found) == {f"{int.from_bytes(socket.inet_aton('127.0.0.1'), sys.byteorder):08X}"}


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
@pytest.mark.parametrize("runs", [1, pytest.param(9, marks=pytest.mark.slow)])
def test_workers_killed_at_random_moments_change_nothing(runs, pool, scene, random, small_blocks):
    made, drives = scene((21, 21), damping=20.0, precision="float32"), drives_of(random, 1500)
    expected = PlateSolver(made, "cpu").run(drives)
    solver = SpreadSolver(pool, made, "cpu")
    solver.run(drives)
    for _ in range(runs):
        victim = int(random.choice(numbers(pool)))
        killer = threading.Timer(random.uniform(0, 0.5), os.kill, (victim, signal.SIGKILL))
        killer.start()
        assert_same(solver.run(drives), expected)
        killer.join()
    assert solver.node_steps == (runs + 1) * expected.node_steps
    assert not solver.lost


def ends(payload):
    os._exit(3)


def raises_import_error(payload):
    raise ModuleNotFoundError("No module named 'absent'", name="absent")


@pytest.mark.slow
def test_a_task_that_no_worker_survives(pool):
    """Those that wait with it are not to blame, as Dask has it."""
    tasks = [Task(ends, {}, "ends"), *(Task(doubled, {"value": one}, one) for one in range(9))]
    found = {task.place: answer for task, answer in spread(pool, tasks)}
    answer = found.pop("ends")
    assert (answer.fault, answer.text) == ("lost", "its workers ended")
    assert {one: answer.value["twice"] for one, answer in found.items()} == {one: 2 * one for one in range(9)}


def test_a_task_under_which_a_worker_ended_is_alone_with_the_next(pool, monkeypatch):
    """Else the end of that would count against others too."""
    monkeypatch.setattr(pool, "_threads", {"one": 1, "other": 1})
    assert pool.free() == 4
    assert pool.free(Task(number, {}, attempts=1)) == 2
    pool.submit(Task(number, {"seconds": 0}, attempts=1))
    assert pool.free() == 1
    pool.abandon()
    assert pool.free() == 4


def test_what_tasks_raise_is_one_line(pool):
    """A module that a worker lacks, at once; what no task should raise, after it was tried elsewhere."""
    tasks = [Task(raises_import_error, {}), *(Task(failing, {"value": value}, value) for value in range(5))]
    found = {task.place: answer for task, answer in spread(pool, tasks)}
    line = "a worker cannot import absent: install the same warp-plate on every worker"
    assert (found[None].fault, found[None].text) == ("wrong", line)
    assert (found[3].fault, found[3].text) == ("lost", LINE)
    assert [found[at].value.get("twice") for at in range(5)] == [0, 2, 4, None, 8]
    assert tasks[4].attempts == ATTEMPTS


def test_a_worker_without_memory_costs_no_plate_where_another_has_it(pool, scene, random, small_blocks, monkeypatch):
    monkeypatch.setattr(blocks, "run_block", starved)
    made, drives = scene((9, 9), damping=20.0), drives_of(random)
    drives[:, 0] = numbers(pool)[0]
    solver, expected = SpreadSolver(pool, made, "cpu"), PlateSolver(made, "cpu").run(drives)
    assert_same(solver.run(drives), expected)
    assert not solver.lost


def test_what_is_for_a_worker_that_is_gone_waits_for_another(pool, monkeypatch):
    monkeypatch.setattr(pool, "_threads", {"tcp://127.0.0.1:1": 1, "another": 1})
    ticket = pool.submit(Task(doubled, {"value": 1}, avoid=("another",)))
    monkeypatch.setattr(pool, "_looked", 0.0)
    ((heard, answer),) = pool.wait(0.1)
    assert (heard, answer.fault) == (ticket, "waiting")
    assert "tcp://127.0.0.1:1" not in pool._threads


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGSTOP")
def test_an_answer_that_stays_with_its_worker_is_lost(pool, monkeypatch):
    """As where that ends between the task's end and the reading of its answer: nobody waits for it without end."""
    monkeypatch.setattr(dask, "FETCH", 0.2)
    workers = numbers(pool)
    ticket = pool.submit(Task(number, {"seconds": 0}))
    future = pool._running[ticket].future
    while not future.done():
        time.sleep(0.01)
    try:
        for worker in workers:
            os.kill(worker, signal.SIGSTOP)
        ((heard, answer),) = pool.wait(1.0)
    finally:
        for worker in workers:
            os.kill(worker, signal.SIGCONT)
    assert (heard, answer.fault) == (ticket, "lost")
    assert numbers(pool) == workers


def leaves_a_mark(payload):
    time.sleep(0.5)
    Path(payload["folder"], str(payload["at"])).touch()
    return {}


def test_what_waits_is_dropped_with_whoever_wanted_it(pool, tmp_path):
    """But for what workers are at; and no answer of it comes later."""
    for at in range(6):
        pool.submit(Task(leaves_a_mark, {"folder": str(tmp_path), "at": at}))
    pool.abandon()
    assert pool.wait(0.5) == []
    numbers(pool)
    assert len(list(tmp_path.iterdir())) <= 2


@pytest.mark.parametrize("text", ["{}", "x", '{"address": 7}', "[1]"])
def test_a_file_that_no_scheduler_wrote_is_one_line(text, tmp_path):
    file = tmp_path / "scheduler.json"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(SceneError, match=r"scheduler.json: has no address, so no"), open_pool(None, str(file)):
        pass


def test_no_scheduler_is_one_line(monkeypatch):
    monkeypatch.setattr(dask, "ANSWERS", 0.5)
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))
        where = f"tcp://127.0.0.1:{nobody.getsockname()[1]}"
        with pytest.raises(SceneError, match=f"--cluster {where}: no scheduler answers there"), open_pool(None, where):
            pass


def start(*words):
    """A program of Dask's, as ``dask scheduler`` and ``dask worker`` are."""
    return subprocess.Popen([sys.executable, "-m", *words, "--host", "127.0.0.1"], stderr=subprocess.DEVNULL)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_a_scheduler_that_goes_away_leaves_a_checkpoint(tmp_path, scene, small_blocks, monkeypatch):
    """By the scheduler's file; the search goes on in this process, to the same result."""
    monkeypatch.setattr(dask, "ANSWERS", 3.0)
    made, file = searched(scene, iterations=400), tmp_path / "scheduler.json"
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
    result = resume(begun, "cpu", estimate=False, pool=Here())
    assert_same_result(result, localize(made, device="cpu", estimate=False))

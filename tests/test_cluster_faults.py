"""The right answer whatever happens to who runs the plates, and what is lost for good is named."""

import os
import signal
import sys
import threading
import time
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest
from test_cluster import PLATES, assert_same, assert_same_result, drives_of, searched

from warp_plate import (
    CheckpointFile,
    PlateSolver,
    SceneError,
    load_checkpoint,
    load_result,
    localize,
    resume,
    save_result,
)
from warp_plate.cli.main import main
from warp_plate.cluster import blocks, pool, processes, work
from warp_plate.cluster.pool import Here, WorkersGone
from warp_plate.cluster.processes import Processes
from warp_plate.cluster.solver import SpreadSolver
from warp_plate.cluster.spread import ATTEMPTS
from warp_plate.scene.load import dump_scene


@pytest.fixture(scope="module")
def two():
    """Two processes, started once for the tests here that leave them as they were."""
    with closing(Processes(["cpu", "cpu"])) as made:
        yield made


@pytest.fixture
def small_blocks(monkeypatch):
    """Of the fewest plates that a block has."""
    monkeypatch.setitem(blocks.BLOCK_NODE_STEPS, "cpu", 1.0)


def killed_at_random(workers, solver, drives, expected, random, longest):
    """A run of plates while one of its workers is killed at some moment."""
    victim = random.choice(workers.processes)

    def kill():
        os.kill(victim, signal.SIGKILL)

    # Its number stays its own until the pool, in this thread, has heard of its end and waited for it.
    timer = threading.Timer(random.uniform(0, longest), kill)
    timer.start()
    run = solver.run(drives)
    timer.cancel()
    timer.join()
    assert_same(run, expected)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
@pytest.mark.parametrize("runs", [3, pytest.param(17, marks=pytest.mark.slow)])
def test_workers_killed_at_random_moments_change_nothing(runs, scene, random, small_blocks):
    made = scene((21, 21), damping=20.0, precision="float32")
    drives = drives_of(random, 1500)
    expected = PlateSolver(made, "cpu").run(drives)
    with closing(Processes(["cpu", "cpu"])) as workers:
        solver = SpreadSolver(workers, made, "cpu")
        started = time.perf_counter()
        solver.run(drives)
        longest = time.perf_counter() - started
        for _ in range(runs):
            killed_at_random(workers, solver, drives, expected, random, longest)
        assert solver.node_steps == (runs + 1) * expected.node_steps
        assert not solver.lost


@pytest.mark.skipif(sys.platform == "win32", reason="Windows cannot stop a process")
def test_a_worker_that_stands_still_holds_nobody(scene, random, small_blocks):
    """The slowest host that there can be: its block is given to another, and its answer counts for nothing."""
    made, drives = scene((21, 21), damping=20.0, precision="float32"), drives_of(random, 600)
    expected = PlateSolver(made, "cpu").run(drives)
    with closing(Processes(["cpu", "cpu"])) as workers:
        solver = SpreadSolver(workers, made, "cpu")
        solver.run(drives)
        while workers.idle < 2:
            workers.wait(0.1)
        os.kill(workers.processes[0], signal.SIGSTOP)
        assert_same(solver.run(drives), expected)
        os.kill(workers.processes[0], signal.SIGCONT)
        assert_same(solver.run(drives), expected)
        assert solver.node_steps == 3 * expected.node_steps


def poisoned(payload):
    """``run_block`` on a worker that ends under every block whose first drive is 7."""
    if len(payload.get("drives", ())) and payload["drives"][0, 0] == 7:
        os._exit(3)
    return work.run_block(payload)


def test_a_block_that_no_worker_survives_is_named(two, scene, random, small_blocks, monkeypatch):
    monkeypatch.setattr(blocks, "run_block", poisoned)
    made, drives = scene((9, 9), damping=20.0), drives_of(random)
    drives[64] = 7
    solver = SpreadSolver(two, made, "cpu")
    run, expected = solver.run(drives), PlateSolver(made, "cpu").run(drives)
    lost = slice(64, 128)
    (why,) = solver.lost
    assert why == f"block given up after {ATTEMPTS} workers: its worker on cpu ended (status 3)"
    assert solver.lost[why] == 64
    assert set(run.status[lost]) == {why}
    assert np.isnan(run.energy[lost]).all()
    kept = np.r_[0:64, 128:PLATES]
    assert run.energy[kept].tobytes() == expected.energy[kept].tobytes()
    assert run.node_steps == len(kept) * solver.node_steps_per_plate


@pytest.mark.parametrize("most", [20, 0])
def test_a_block_is_halved_until_memory_holds_it(most, scene, random, small_blocks, monkeypatch):
    """As Warp says that there is too little; where not even one plate has room, their status says so."""
    made, drives = scene((9, 9), damping=20.0), drives_of(random)
    real = work.make_solver

    def small(recipe):
        solver = real(recipe)
        run = solver.run

        def tight(designs):
            if len(designs) > most:
                raise RuntimeError("Failed to allocate 999 bytes on device 'cuda:0'")
            return run(designs)

        solver.run = tight
        return solver

    monkeypatch.setattr(work, "make_solver", small)
    monkeypatch.setattr(work, "_SOLVERS", type(work._SOLVERS)())
    solver, expected = SpreadSolver(Here(), made, "cpu"), PlateSolver(made, "cpu").run(drives)
    run = solver.run(drives)
    if most:
        assert_same(run, expected)
        assert not solver.lost
    else:
        why = "block given up: out of memory (Failed to allocate 999 bytes on device 'cuda:0')"
        assert dict(solver.lost) == {why: PLATES}
        assert run.node_steps == 0


def test_lost_plates_are_in_the_result(tmp_path, two, scene, small_blocks, monkeypatch):
    """They count as worst, and the file says how many and why, also after a checkpoint."""
    made, real = searched(scene, iterations=2), blocks.Blocks.__iter__
    monkeypatch.setattr(blocks, "run_block", poisoned)
    monkeypatch.setattr("warp_plate.cluster.spread.ATTEMPTS", 1)

    def first_block_is_poison(blocks):
        for task in real(blocks):
            if task.place == slice(0, 64) and len(blocks) > 1:
                task.payload["drives"] = np.full((64, 1), 7)
            yield task

    monkeypatch.setattr(blocks.Blocks, "__iter__", first_block_is_poison)
    file = CheckpointFile(tmp_path / "panel.checkpoint.h5", 0.0)
    result = localize(made, device="cpu", estimate=False, pool=two, checkpoints=file)
    (why,) = result.lost
    assert result.lost[why] == 2 * 64
    assert load_checkpoint(tmp_path / "panel.checkpoint.h5").lost[why] >= 64
    assert result.evaluations == 2 * PLATES
    assert result.cases["best"].localization_factor > 0
    assert load_result(save_result(result, tmp_path / "panel.h5")).lost == result.lost


class Ends(Here):
    """A pool whose workers are gone after some tasks."""

    def __init__(self, tasks):
        super().__init__()
        self.left = tasks

    def wait(self, seconds):
        self.left -= 1
        if self.left < 0:
            raise WorkersGone("no worker is left: of a test")
        return super().wait(seconds)


def test_a_search_whose_workers_are_gone_can_go_on(tmp_path, scene, small_blocks):
    made, path = searched(scene), tmp_path / "panel.checkpoint.h5"
    expected = localize(made, device="cpu", estimate=False)
    with pytest.raises(WorkersGone, match="of a test"):
        localize(made, device="cpu", estimate=False, pool=Ends(10), checkpoints=CheckpointFile(path, np.inf))
    begun = load_checkpoint(path)
    assert 0 < begun.iterations < 4
    assert_same_result(resume(begun, "cpu", estimate=False, pool=Here()), expected)


def test_the_command_says_how_to_go_on_without_workers(tmp_path, scene, small_blocks, monkeypatch, capsys):
    @contextmanager
    def ends(*options):
        yield Ends(10)

    monkeypatch.chdir(tmp_path)
    Path("panel.toml").write_text(dump_scene(searched(scene)), encoding="utf-8")
    monkeypatch.setattr(pool, "open_pool", ends)
    with pytest.raises(SystemExit) as left:
        main(["localize", "panel.toml", "--device", "cpu", "--no-pictures", "--no-estimate"])
    assert left.value.code == 2
    told = capsys.readouterr().err
    assert "no worker is left: of a test; there is a checkpoint after" in told
    assert "localize --resume panel-localize.checkpoint.h5" in told


def test_workers_that_cannot_start(scene, monkeypatch):
    monkeypatch.setattr(processes, "START", "import sys; sys.exit(5)")
    with closing(Processes(["cpu"])) as one, pytest.raises(WorkersGone, match=r"as they started.*status 5"):
        SpreadSolver(one, scene((9, 9)), "cpu").run([[1, 1, 1]])


def test_a_solver_that_cannot_be_made_on_a_worker_is_one_line(scene):
    one = Here()
    one.device = "cuda:99"
    with pytest.raises(SceneError, match="device = 'cuda:99': not on this machine"):
        SpreadSolver(one, scene((9, 9)), "cpu").run([[1, 1, 1]])


@pytest.mark.parametrize("name", ["kind", "warp", "warp_plate"])
def test_workers_must_be_alike(name, scene, monkeypatch):
    solver = SpreadSolver(Here(), scene((9, 9)), "cpu")
    solver.run([[1, 1, 1]])
    solver._made[name] = "cuda" if name == "kind" else "0.0"
    with pytest.raises(SceneError, match=f"workers: {name} is"):
        solver.run([[1, 1, 1]])

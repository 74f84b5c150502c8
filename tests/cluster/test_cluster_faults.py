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
from test_cluster import PLATES, assert_same, assert_same_result, doubled, drives_of, searched

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
from warp_plate.cli.workers import lost_lines
from warp_plate.cluster import blocks, processes
from warp_plate.cluster import tasks as work
from warp_plate.cluster.opening import open_pool
from warp_plate.cluster.pool import Answer, Here, Task, WorkersGone, fittest
from warp_plate.cluster.processes import Processes
from warp_plate.cluster.scheduler import ATTEMPTS, spread
from warp_plate.cluster.solver import SpreadSolver
from warp_plate.scene.dump import dump_scene


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
def test_a_worker_that_stands_still_holds_nobody(scene, random, small_blocks, monkeypatch):
    """The slowest host that there can be: its block is given to another, and its answer counts for nothing."""
    made, drives = scene((21, 21), damping=20.0, precision="float32"), drives_of(random, 600)
    expected = PlateSolver(made, "cpu").run(drives)
    with closing(Processes(["cpu", "cpu"])) as workers:
        solver = SpreadSolver(workers, made, "cpu")
        solver.run(drives)
        while workers.idle() < 2:
            workers.wait(0.1)
        os.kill(workers.processes[0], signal.SIGSTOP)
        assert_same(solver.run(drives), expected)
        os.kill(workers.processes[0], signal.SIGCONT)
        assert_same(solver.run(drives), expected)
        assert solver.node_steps == 3 * expected.node_steps
        # Of a single block what blocks took before says that it takes long, and nothing else could.
        while workers.idle() < 2:
            workers.wait(0.1)
        os.kill(workers.processes[0], signal.SIGSTOP)
        with monkeypatch.context() as only:
            only.setattr("warp_plate.cluster.scheduler.FIRST_SECONDS", np.inf)
            assert_same(solver.run(drives[:64]), PlateSolver(made, "cpu").run(drives[:64]))
        os.kill(workers.processes[0], signal.SIGCONT)
        # Nor does what is too large for its pipe hold who writes it.
        while workers.idle() < 2:
            workers.wait(0.1)
        standing, started = workers.processes[0], time.perf_counter()
        os.kill(standing, signal.SIGSTOP)
        timer = threading.Timer(10, os.kill, (standing, signal.SIGCONT))
        timer.start()
        large = np.arange(processes.PIPE_BYTES / 2)
        found = list(spread(workers, [Task(doubled, {"value": large + one}, one) for one in range(5)]))
        assert time.perf_counter() - started < 8
        timer.cancel()
        os.kill(standing, signal.SIGCONT)
        assert sorted(task.place for task, _ in found) == list(range(5))
        assert all(np.array_equal(answer.value["twice"], 2 * (large + task.place)) for task, answer in found)


def replaced(workers, before):
    """Whether one of these processes is another after some time."""
    for _ in range(100):
        if set(workers.processes) != set(before):
            return True
        workers.wait(0.1)
    return False


def both_idle(workers):
    while workers.idle() < 2:
        workers.wait(0.1)


def test_a_task_under_which_a_worker_ended_has_the_next_for_itself(two):
    """Which may have begun two tasks as it ends: who is to blame is known of one alone."""
    both_idle(two)
    assert (two.free(), two.free(Task(doubled, {}, attempts=1))) == (4, 2)
    two.submit(Task(doubled, {"value": 1}, attempts=1))
    assert (two.free(), two.free(Task(doubled, {}, attempts=1))) == (2, 1)
    both_idle(two)
    assert two.free() == 4


def test_small_tasks_take_less_room_and_go_to_who_has_least_work(two):
    both_idle(two)
    for size in (1.0, 0.25, 0.5, 0.25, 0.75, 0.5):
        two.submit(Task(doubled, {"value": 1}, size=size))
    assert [list(worker.tickets.values()) for worker in two._workers] == [[1.0, 0.75], [0.25, 0.5, 0.25, 0.5]]
    assert two.free() == 0
    both_idle(two)


def test_what_is_half_said_is_never_waited_for(two, monkeypatch):
    """Ctrl-C as a worker is given its first task, and a frame that is none: that worker is started again."""
    real, before = two.submit, two.processes

    def interrupted(task):
        real(task)
        raise KeyboardInterrupt

    monkeypatch.setattr(two, "submit", interrupted)
    with pytest.raises(KeyboardInterrupt):
        list(spread(two, [Task(doubled, {"value": 1})]))
    monkeypatch.undo()
    assert replaced(two, before)
    before = two.processes
    two._workers[0].outbox.put([b"\1" + bytes(7) + b"{"])
    assert replaced(two, before)
    ((_, answer),) = spread(two, [Task(doubled, {"value": 2})])
    assert answer.value["twice"] == 4


LINE = "RuntimeError: CUDA error 700: an illegal memory access"


def failing(payload):
    """As a task is whose GPU has no context any more, or that meets a mistake of this program's."""
    if payload["value"] == 3:
        raise RuntimeError("CUDA error 700: an illegal memory access\nmore of it")
    return doubled(payload)


def test_an_error_that_no_task_should_raise_is_tried_elsewhere_and_named(two, monkeypatch):
    """The process that it was in is another's, since it may be good for nothing; what waited there is not to blame."""
    monkeypatch.setattr("warp_plate.cluster.scheduler.ATTEMPTS", 2)
    before = two.processes
    tasks = [Task(failing, {"value": value}, value) for value in range(8)]
    found = {task.place: answer for task, answer in spread(two, tasks)}
    assert (found[3].fault, found[3].text) == ("lost", LINE)
    assert [found[at].value.get("twice") for at in range(8)] == [0, 2, 4, None, 8, 10, 12, 14]
    assert [task.attempts for task in tasks] == [0, 0, 0, 2, 0, 0, 0, 0]
    assert set(two.processes) != set(before)
    both_idle(two)
    tickets, answers = [two.submit(Task(failing, {"value": value})) for value in (3, 1, 2, 4)], {}
    while len(answers) < 4:
        answers |= dict(two.wait(0.1))
    assert [answers[ticket].fault for ticket in tickets] == ["lost", "", "waiting", ""]
    assert answers[tickets[0]].text == LINE
    with pytest.raises(RuntimeError, match="illegal memory access"):  # in this process there is nobody else to try
        list(spread(Here(), tasks))


def test_what_is_done_again_is_told():
    told = []
    with open_pool("cpu", None, tell=told.append) as pool:
        assert len(list(spread(pool, [Task(failing, {"value": 3}), Task(failing, {"value": 1})]))) == 2
    assert told == [f"2 tasks done again: {LINE}"]


def poisoned(payload):
    """``run_block`` on a worker that ends under every block whose first drive is 7."""
    if len(payload.get("drives", ())) and payload["drives"][0, 0] == 7:
        os._exit(3)
    return work.run_block(payload)


def test_a_block_that_no_worker_survives_is_named(two, scene, random, small_blocks, monkeypatch):
    monkeypatch.setattr(blocks, "run_block", poisoned)
    made, drives = scene((9, 9), damping=20.0), drives_of(random)
    solver, lost = SpreadSolver(two, made, "cpu"), slice(PLATES - 64, PLATES)  # the last block
    drives[lost.start] = 7
    found = np.zeros((PLATES, 2))
    run, expected = solver.run(drives, each=found.__setitem__), PlateSolver(made, "cpu").run(drives)
    assert found.tobytes() == run.energy.tobytes()
    (why,) = solver.lost
    assert why == f"block given up after {ATTEMPTS} attempts: its worker on cpu ended (status 3)"
    assert solver.lost[why] == 64
    assert set(run.status[lost]) == {why}
    assert np.isnan(run.energy[lost]).all()
    kept = slice(0, lost.start)
    assert run.energy[kept].tobytes() == expected.energy[kept].tobytes()
    assert run.node_steps == lost.start * solver.node_steps_per_plate


def starved(payload):
    """``run_block`` where the worker has no memory whose process the first drive names."""
    if len(payload["drives"]) and payload["drives"][0, 0].real == os.getpid():
        raise RuntimeError("Failed to allocate 999 bytes on device 'cuda:0'")
    return work.run_block(payload)


def test_a_worker_without_memory_costs_no_plate_where_another_has_it(two, scene, random, small_blocks, monkeypatch):
    """Though it is the quickest to answer."""
    monkeypatch.setattr(blocks, "run_block", starved)
    made, drives = scene((9, 9), damping=20.0), drives_of(random, 600)
    both_idle(two)
    drives[:, 0] = two.processes[0]
    solver, expected = SpreadSolver(two, made, "cpu"), PlateSolver(made, "cpu").run(drives)
    assert_same(solver.run(drives), expected)
    assert not solver.lost


def test_who_gets_a_task_that_workers_failed():
    names = ("a", "b", "c")
    for failed, expected in (("", "abc"), ("a", "bc"), ("ab", "c"), ("abc", "a"), ("bca", "b"), ("xc", "ab")):
        assert fittest(names, Task(doubled, {}, avoid=tuple(failed))) == set(expected)
    assert fittest(names, None) == set(names)
    assert fittest((), Task(doubled, {}, avoid=("a",))) == set()


class Standing(Here):
    """A worker that has no memory at first, and another, for which all would wait, that stands still."""

    short = True

    def free(self, task=None):
        return 0 if task is not None and task.avoid else super().free()

    def wait(self, seconds):
        if not (self.short and self._tasks):
            return super().wait(seconds)
        self.short = False
        return [(self._tasks.popleft()[0], Answer(fault="memory", worker="a"))]


def test_nobody_waits_for_ever_for_a_worker_with_memory(monkeypatch):
    monkeypatch.setattr("warp_plate.cluster.scheduler.FIRST_SECONDS", 0.1)
    ((_, answer),) = spread(Standing(), [Task(doubled, {"value": 2})])
    assert answer.value["twice"] == 4


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
    monkeypatch.setattr("warp_plate.cluster.scheduler.ATTEMPTS", 1)

    def last_block_is_poison(blocks):
        for task in real(blocks):
            if task.place == slice(PLATES - 64, PLATES):
                task.payload["drives"] = np.full((64, 1), 7)
            yield task

    monkeypatch.setattr(blocks.Blocks, "__iter__", last_block_is_poison)
    file = CheckpointFile(tmp_path / "panel.checkpoint.h5", 0.0)
    result = localize(made, device="cpu", estimate=False, pool=two, checkpoints=file)
    (why,) = result.lost_plates
    assert result.lost_plates[why] == 2 * 64
    assert load_checkpoint(tmp_path / "panel.checkpoint.h5").lost_plates[why] >= 64
    assert result.evaluations == 2 * PLATES
    assert result.cases["best"].localization_factor > 0
    assert load_result(save_result(result, tmp_path / "panel.h5")).lost_plates == result.lost_plates
    assert lost_lines(result.lost_plates) == [f"128 plates of the search without energies, taken as worst: {why}"]
    assert lost_lines({"gone": 1})[0].startswith("1 plate of the search ")


class Ends(Here):
    """A pool whose workers are gone after some tasks."""

    def __init__(self, tasks, error=WorkersGone):
        super().__init__()
        self.left, self.error = tasks, error

    def wait(self, seconds):
        self.left -= 1
        if self.left < 0:
            raise self.error("no worker is left: of a test")
        return super().wait(seconds)


@pytest.mark.parametrize("error", [WorkersGone, RuntimeError])
def test_a_search_whose_workers_are_gone_can_go_on(error, tmp_path, scene, small_blocks):
    """Whatever it was that ended it."""
    made, path = searched(scene), tmp_path / "panel.checkpoint.h5"
    expected = localize(made, device="cpu", estimate=False)
    with pytest.raises(error, match="of a test"):
        localize(made, device="cpu", estimate=False, pool=Ends(10, error), checkpoints=CheckpointFile(path, np.inf))
    begun = load_checkpoint(path)
    assert 0 < begun.iterations < 4
    assert_same_result(resume(begun, "cpu", estimate=False, pool=Here()), expected)


def test_the_command_says_how_to_go_on_without_workers(tmp_path, scene, small_blocks, monkeypatch, capsys):
    @contextmanager
    def ends(*options):
        yield Ends(10)

    monkeypatch.chdir(tmp_path)
    Path("panel.toml").write_text(dump_scene(searched(scene)), encoding="utf-8")
    monkeypatch.setattr("warp_plate.cluster.opening.open_pool", ends)
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

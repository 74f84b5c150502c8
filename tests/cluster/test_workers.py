"""Plates on processes of this machine: the same bits as in one process, whatever happens to the workers."""

import multiprocessing
import os
import signal
import sys
import threading
import time
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import numpy as np
import pytest

from support.commands import start_program
from support.inline_pool import InlinePool
from support.worker_tasks import doubled, poisoned
from support.workers import PLATES, assert_same_history, assert_same_run, random_phasors, small_search
from warp_plate import CheckpointFile, PlateSolver, SceneError, load_checkpoint, load_result, localize, resume
from warp_plate.cli.tables import failure_lines
from warp_plate.cluster import evaluator as evaluators
from warp_plate.cluster import pool as pools
from warp_plate.cluster import tasks
from warp_plate.cluster.evaluator import block_size, make_evaluator
from warp_plate.cluster.opening import open_pool
from warp_plate.cluster.pool import ATTEMPTS, Task, WorkersGone, run_tasks
from warp_plate.plate.designs import Designs, per_plate_of
from warp_plate.problem.uncertainty import draw_scenarios, simulate_scenarios
from warp_plate.resolve import resolve
from warp_plate.result.model import save_result
from warp_plate.studies.compare import compare

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")


@pytest.fixture(scope="module")
def pool():
    """Two processes, started once for all tests here."""
    with open_pool("cpu,cpu", None) as made:
        yield made


def random_designs(scene, random):
    """Designs that differ in all that the scene's search frees."""
    per_plate, whole = per_plate_of(scene), np.ones((1, 3))
    return Designs(
        random_phasors(random),
        random.uniform(250, 300, (PLATES, 1)) * whole if per_plate.frequency else None,
        random.uniform(0.09, 0.11, (PLATES, 3, 2)) if per_plate.centre else None,
        random.uniform(0, 1e-3, (PLATES, 1)) * whole if per_plate.delay else None,
    )


SCENES = {
    "stretching": {"effects": {"stretching": {}, "damping": {"viscous": 20.0}}},
    "signal": {"damping": 20.0, "drive": {"frequency": 290.0, "signal": {"file": "pulse.csv"}}},
    "designs": {
        "precision": "float32",
        "drive": {"frequency": 290.0, "burst": {"duration": 2e-3, "ramp": 5e-4}},
        "search": {"frequency": {"range": [250.0, 300.0]}, "position": {}, "delay": {"range": [0.0, 1e-3]}},
    },
}


@pytest.mark.parametrize("name", SCENES)
def test_workers_give_the_bits_of_one_process(name, pool, scene, random, tmp_path):
    """Also of a plate that fails, by its number in the batch, and of a signal in a file that workers cannot read."""
    (tmp_path / "pulse.csv").write_text("time,value\n0,0\n0.002,1\n0.004,0\n", encoding="utf-8")
    made = scene((9, 9), window=(0.002, 0.004), **SCENES[name]).in_folder(tmp_path)
    options = {"per_plate": per_plate_of(made), "areas": {"left": (0, 0.1, 0, 0.2)}}
    if name == "signal":
        options["quantity"] = "displacement"
    designs = random_designs(made, random)
    designs.drives[70] = np.nan
    solver = PlateSolver(made, "cpu", **options)
    expected, none = solver.run(designs), solver.run(designs[:0])
    evaluator = make_evaluator(made, "cpu", pool=pool, **options)
    (tmp_path / "pulse.csv").unlink()
    assert expected.faults.keys() == {70}
    assert_same_run(evaluator.run(designs), expected)
    assert_same_run(evaluator.run(designs[:0]), none)
    assert evaluator.node_steps == expected.node_steps
    assert not evaluator.lost
    if designs.frequency is not None:
        designs.frequency[70] = -1.0
        with pytest.raises(SceneError, match=r"designs\.frequency: -1\.0 of actuator .* on plate 70;"):
            evaluator.run(designs)


@pytest.mark.parametrize(
    ("plates", "workers", "node_steps", "kind", "size"),
    [
        (2048, 2, 781250, "cpu", 512),  # two for each worker
        (300, 4, 781250, "cpu", 128),  # not less than is worth sending
        (131072, 2, 781250, "cuda", 32768),
        (4224, 2, 781250, "cuda", 2112),  # fills an H200 once
        (1, 3, 1, "cpu", 10**8),
    ],
)
def test_how_many_plates_a_block_has(plates, workers, node_steps, kind, size, monkeypatch):
    monkeypatch.undo()
    assert block_size(plates, workers, node_steps, kind) == size


def test_searches_give_the_same_on_workers(pool, scene, random):
    objectives = [{"kind": "localization"}, {"kind": "displacement", "weight": 1e3}]
    made = small_search(scene, objectives=objectives, magnitude={"range": [0.0, 1.0]})
    result = localize(made, device="cpu", estimate=False, pool=pool)
    assert_same_history(result, localize(made, device="cpu", estimate=False))
    assert pool.description in result.device
    robust = small_search(scene, robust={"young_modulus": 0.1, "scenarios": 3})
    scenarios, phasors = draw_scenarios(robust, 3, 0), random_phasors(random)
    here, there = (simulate_scenarios(scenarios, resolve(scenarios[0].scene, "cpu"), run_by) for run_by in (None, pool))
    assert there.losses(Designs(phasors)).tobytes() == here.losses(Designs(phasors)).tobytes()
    one, two = (
        compare(small_search(scene), methods=["pso"], seeds=1, device="cpu", evaluator="direct", pool=run)
        for run in (None, pool)
    )
    assert [trial.loss.tobytes() for trial in one.trials] == [trial.loss.tobytes() for trial in two.trials]


def test_tasks_of_any_function(pool):
    """Whoever leaves early can come again; a task that is refused ends them all."""
    progress = []
    pool.on_progress = lambda done, total: progress.append((done, total))
    found = {task.key: outcome.value for task, outcome in run_tasks(pool, [Task(doubled, at, at) for at in range(9)])}
    pool.on_progress = None
    assert found == {at: 2 * at for at in range(9)}
    assert progress == [(done, 9) for done in range(1, 10)]
    for _ in run_tasks(pool, [Task(doubled, 1) for _ in range(50)]):
        break
    with pytest.raises(SceneError, match="a worker: value = 13: no"):
        list(run_tasks(pool, [Task(doubled, at) for at in range(14)]))
    with pytest.raises(SceneError, match="a worker cannot import absent: install the same warp-plate on every worker"):
        list(run_tasks(pool, [Task(doubled, 14)]))
    outcomes = run_tasks(pool, [Task(doubled, at, at) for at in range(100, 110)])
    assert {task.key: outcome.value for task, outcome in outcomes} == {at: 2 * at for at in range(100, 110)}


@pytest.mark.parametrize(
    ("devices", "cluster", "line"),
    [
        ("cpu,", None, "--devices cpu,: must be devices with commas between"),
        ("cpu,cuda:99", None, "--devices cpu,cuda:99: device = 'cuda:99': not on this machine"),
        ("cpu", "local:2", "--devices, --cluster: give one of them"),
        (None, "local:0", "--cluster local:0: must be local:COUNT"),
        (None, "missing.json", "--cluster missing.json: no such file"),
        (None, "local:2", r"pip install 'warp-plate\[cluster\]'"),
    ],
)
def test_pools_that_cannot_be(devices, cluster, line, monkeypatch):
    if "pip" in line:
        monkeypatch.setitem(sys.modules, "distributed", None)
    elif devices is None:
        pytest.importorskip("distributed")
    with pytest.raises(SceneError, match=line), open_pool(devices, cluster):
        pass


@POSIX
def test_workers_that_are_killed_cost_no_plate(pool, scene, random):
    """Workers are killed at random moments of their work, and while idle."""
    made, phasors = scene((9, 9), window=(0.002, 0.02), damping=20.0), random_phasors(random, 1000)
    expected = PlateSolver(made, "cpu").run(phasors)

    def kill_some_worker():
        if children := multiprocessing.active_children():
            os.kill(children[random.integers(len(children))].pid, signal.SIGKILL)

    evaluator = make_evaluator(made, "cpu", pool=pool)
    evaluator.run(phasors[:1])
    killer = threading.Timer(random.uniform(0, 0.1), kill_some_worker)
    killer.start()
    assert_same_run(evaluator.run(phasors), expected)
    killer.join()
    kill_some_worker()
    time.sleep(0.2)
    assert_same_run(evaluator.run(phasors), expected)
    assert not evaluator.lost


@POSIX
def test_a_pool_ends_workers_that_hang():
    others = set(multiprocessing.active_children())
    with open_pool("cpu", None) as made:
        assert made.submit(doubled, 4).result() == 8
        (worker,) = set(multiprocessing.active_children()) - others
        os.kill(worker.pid, signal.SIGSTOP)
    assert not worker.is_alive()


def test_a_block_that_no_worker_survives_is_named(pool, scene, random, monkeypatch):
    monkeypatch.setattr(evaluators, "run_block", poisoned)
    monkeypatch.setattr(pools, "ATTEMPTS", 2)
    made, phasors, first = scene((9, 9), damping=20.0), random_phasors(random), 64
    phasors[first] = 7
    evaluator, expected = make_evaluator(made, "cpu", pool=pool), PlateSolver(made, "cpu").run(phasors)
    found = evaluator.run(phasors)
    fault = "block given up after 2 attempts: its worker ended"
    assert evaluator.lost == {fault: 64}
    assert found.faults.keys() == set(range(first, first + 64))
    assert {word for word, _ in found.faults.values()} == {fault}
    assert np.isnan(found.energy[first : first + 64]).all()
    rest = np.r_[0:first, first + 64 : PLATES]
    assert found.energy[rest].tobytes() == expected.energy[rest].tobytes()
    assert found.node_steps == len(rest) * evaluator.solver.node_steps_per_plate


def test_an_error_of_the_program_is_tried_again_and_named(pool, monkeypatch):
    """The process is replaced, since after an error of CUDA nothing works in one any more."""
    monkeypatch.setattr(pools, "ATTEMPTS", 2)
    list(run_tasks(pool, [Task(doubled, at) for at in range(4)]))
    before = {process.pid for process in multiprocessing.active_children()}
    found = {task.key: outcome for task, outcome in run_tasks(pool, [Task(doubled, at, at) for at in (12, 17)])}
    line = "RuntimeError: CUDA error 700: an illegal memory access"
    assert (found[12].value, found[17].failure) == (24, f"given up after 2 attempts: {line}")
    list(run_tasks(pool, [Task(doubled, at) for at in range(4)]))
    assert {process.pid for process in multiprocessing.active_children()} - before


class Failing(InlinePool):
    """A worker that ends under blocks of one size, has room for few plates, or does so many tasks and no more."""

    def __init__(self, tasks_left=10**9, under=None, room=10**9):
        super().__init__()
        self.tasks_left, self.under, self.room = tasks_left, under, room

    def worker_count(self):
        if self.tasks_left <= 0:
            raise WorkersGone("no worker is left: of a test")
        return 1

    def run(self, function, argument):
        self.tasks_left -= 1
        plates = len(argument[1])
        if plates == self.under:
            raise BrokenProcessPool
        return super().run(too_large if plates > self.room else function, argument)


def too_large(block):
    raise RuntimeError("Failed to allocate 999 bytes on device 'cuda:0'")


@pytest.mark.parametrize("room", [20, 0])
def test_a_block_is_halved_until_memory_holds_it(room, scene, random):
    """Plates are given up by name if not even one has room."""
    made, phasors = scene((9, 9), damping=20.0), random_phasors(random)
    evaluator = make_evaluator(made, "cpu", pool=Failing(room=room))
    found = evaluator.run(phasors)
    if room:
        assert_same_run(found, PlateSolver(made, "cpu").run(phasors))
    else:
        why = "out of memory (Failed to allocate 999 bytes on device 'cuda:0')"
        assert evaluator.lost == {f"block given up after {ATTEMPTS} attempts: {why}": PLATES}
        assert found.node_steps == 0


def test_lost_plates_are_in_the_result(tmp_path, scene):
    """They count as worst, and the file says how many and why, also after a checkpoint."""
    file = CheckpointFile(tmp_path / "panel.checkpoint.h5", 0.0)
    made = small_search(scene, iterations=2)
    result = localize(made, device="cpu", estimate=False, pool=Failing(under=22), checkpoints=file)
    (why,) = result.lost_plates
    assert result.lost_plates[why] == 2 * 22
    assert load_checkpoint(tmp_path / "panel.checkpoint.h5").lost_plates[why] >= 22
    assert result.evaluations == 2 * PLATES
    assert result.cases["best"].localization_factor > 0
    assert load_result(save_result(result, tmp_path / "panel.h5")).lost_plates == result.lost_plates
    (line,) = failure_lines(result.lost_plates)
    assert "44 plates" in line
    assert why in line


def test_a_search_whose_workers_are_gone_can_go_on(tmp_path, scene):
    made, path = small_search(scene), tmp_path / "panel.checkpoint.h5"
    expected = localize(made, device="cpu", estimate=False)
    with pytest.raises(WorkersGone, match="of a test"):
        localize(made, device="cpu", estimate=False, pool=Failing(10), checkpoints=CheckpointFile(path, np.inf))
    begun = load_checkpoint(path)
    assert 0 < begun.iterations < 4
    assert_same_history(resume(begun, "cpu", estimate=False, pool=InlinePool()), expected)


SLEEPING = """
import multiprocessing, time
from warp_plate.cluster.opening import open_pool
from warp_plate.cluster.pool import Task, run_tasks

if __name__ == "__main__":
    with open_pool("cpu,cpu", None) as pool:
        print(*(child.pid for child in multiprocessing.active_children()), flush=True)
        list(run_tasks(pool, [Task(time.sleep, 1000), Task(time.sleep, 1000)]))
"""


def alive(process):
    """True while a process runs; one that has ended may still stand in the system's table."""
    try:
        return "Z" not in Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False


@pytest.mark.skipif(not Path("/proc").exists(), reason="needs /proc")
def test_workers_end_with_the_program(tmp_path):
    """Though they are at work, and in a moment, even if it is killed."""
    (tmp_path / "sleeping.py").write_text(SLEEPING, encoding="utf-8")
    process = start_program("sleeping.py", cwd=tmp_path)
    workers = [int(number) for number in process.stdout.readline().split()]
    assert len(workers) == 2
    time.sleep(0.5)
    process.kill()
    process.communicate(timeout=60)
    ends = time.monotonic() + 10
    while any(map(alive, workers)) and time.monotonic() < ends:
        time.sleep(0.1)
    assert not any(map(alive, workers))


@POSIX
def test_ctrl_c_ends_a_command_with_workers_by_its_best(tmp_path, scene, command):
    """All processes of the command receive the signal, as from a terminal."""
    file = tmp_path / "panel.toml"
    file.write_text(small_search(scene, iterations=10**6).to_toml(), encoding="utf-8")
    refused = command("localize", file, "--devices", "cpu,cpu", "--device", "cpu")
    assert refused[0] == 2
    assert "--device cpu: --devices cpu,cpu already says where plates run" in refused[2]
    options = ["--devices", "cpu,cpu", "--no-pictures", "--no-estimate", "--checkpoint-every", "0"]
    process = start_program("-m", "warp_plate", "localize", file, *options, cwd=tmp_path, start_new_session=True)
    while not (tmp_path / "panel-localize.checkpoint.h5").exists() and process.poll() is None:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 0
    assert errors.startswith("warp-plate: interrupted after ")
    assert errors.count("\n") == 1
    result = load_result(tmp_path / "panel-localize.h5")
    assert result.interrupted
    assert result.device.endswith("plates of the search on 2 processes (cpu, cpu)")


def test_workers_must_be_alike_and_have_their_device(scene, monkeypatch):
    """Their kind and versions must agree; their processors may differ."""
    with pytest.raises(SceneError, match="a worker: device = 'cuda:99': not on this machine"):
        make_evaluator(scene((9, 9)), "cpu", pool=InlinePool("cuda:99")).run([[1, 1, 1]])
    evaluator = make_evaluator(scene((9, 9)), "cpu", pool=InlinePool())
    real = tasks.worker_identity
    evaluator.run([[1, 1, 1]])
    monkeypatch.setattr(tasks, "worker_identity", lambda device: {**real(device), "processor": "0.0"})
    evaluator.run([[1, 1, 1]])
    for name in ("warp", "warp_plate"):
        monkeypatch.setattr(tasks, "worker_identity", lambda device, name=name: {**real(device), name: "0.0"})
        for made in (evaluator, make_evaluator(scene((9, 9)), "cpu", pool=InlinePool())):
            with pytest.raises(SceneError, match=f"workers: {name} is 0.0 on one"):
                made.run([[1, 1, 1]])


def test_workers_that_cannot_start_are_one_line(scene, monkeypatch):
    monkeypatch.setattr("warp_plate.cluster.opening._start_worker", os._exit)
    monkeypatch.setattr(pools, "ATTEMPTS", 2)
    line = "a worker: given up after 2 attempts: its worker ended"
    with open_pool("cpu", None) as pool, pytest.raises(SceneError, match=line):
        make_evaluator(scene((9, 9)), "cpu", pool=pool).run([[1, 1, 1]])

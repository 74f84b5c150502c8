"""Plates on workers: the same bits whatever runs them, and the right answer whatever happens to who runs them."""

import json
import os
import signal
import sys
import threading
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from warp_plate import CheckpointFile, PlateSolver, SceneError, load_checkpoint, load_result, localize, resume
from warp_plate.cli.main import main
from warp_plate.cluster import blocks, processes, work
from warp_plate.cluster.pool import Here, Task, WorkersGone, open_pool
from warp_plate.cluster.processes import Processes
from warp_plate.cluster.solver import SpreadSolver
from warp_plate.cluster.spread import ATTEMPTS, spread
from warp_plate.plate.designs import Designs, own_of
from warp_plate.scene.load import dump_scene
from warp_plate.search.compare import compare
from warp_plate.search.panels import solve_directly
from warp_plate.search.scenarios import draw_scenarios

PLATES = 150  # blocks of 64, 64 and 22


@pytest.fixture(scope="module")
def pools():
    """Pools of 1, 2 and 3 processes, each started once for all tests here."""
    made = {count: Processes(["cpu"] * count) for count in (1, 2, 3)}
    yield made
    for pool in made.values():
        pool.close()


@pytest.fixture
def small_blocks(monkeypatch):
    """Of the fewest plates that a block has."""
    monkeypatch.setitem(blocks.BLOCK_NODE_STEPS, "cpu", 1.0)


def drives_of(random, plates=PLATES, actuators=3):
    return random.normal(size=(plates, actuators)) + 1j * random.normal(size=(plates, actuators))


def designs_for(scene, random, plates=PLATES):
    """Random ones of all that the scene's search frees."""
    own, drives = own_of(scene), drives_of(random, plates)
    frequency = np.repeat(random.uniform(250, 300, (plates, 1)), 3, axis=1) if own.frequency else None
    delay = np.repeat(random.uniform(0, 1e-3, (plates, 1)), 3, axis=1) if own.delay else None
    centre = random.uniform(0.09, 0.11, (plates, 3, 2)) if own.centre else None
    return Designs(drives, frequency, centre, delay)


def assert_same(run, expected):
    for name in ("energy", "caught", "masses"):
        assert getattr(run, name).tobytes() == getattr(expected, name).tobytes(), name
    assert run.status.tolist() == expected.status.tolist()
    assert (run.node_steps, run.regions) == (expected.node_steps, expected.regions)


SCENES = {
    "float32": {"precision": "float32", "damping": 20.0},
    "float64": {"damping": 20.0, "order": 4, "load": "moments"},
    "stretching": {"effects": {"stretching": {}, "damping": {"viscous": 20.0}}},
    "own": {
        "precision": "float32",
        "drive": {"frequency": 290.0, "burst": {"duration": 2e-3, "ramp": 5e-4}},
        "search": {"frequency": {"range": [250.0, 300.0]}, "position": {}, "delay": {"range": [0.0, 1e-3]}},
    },
}


@pytest.mark.parametrize("name", SCENES)
def test_plates_have_the_same_bits_on_any_number_of_workers(name, pools, scene, random, small_blocks):
    """And on the threads of this process, whose batch is one: plates know nothing of each other."""
    made = scene((9, 9), window=(0.002, 0.004), **SCENES[name])
    own = own_of(made)
    designs = designs_for(made, random)
    designs.drives[70] = np.nan
    expected = PlateSolver(made, "cpu", own=own, areas={"left": (0, 0.1, 0, 0.2)}).run(designs)
    assert expected.status[70] != "ok"
    for count, pool in pools.items():
        solver = SpreadSolver(pool, made, "cpu", own=own, areas={"left": (0, 0.1, 0, 0.2)})
        told = []
        run = solver.run(designs, progress=lambda done, total, told=told: told.append((done, total)))
        assert_same(run, expected)
        assert solver.node_steps == expected.node_steps, count
        assert [total for _, total in told] == [expected.node_steps] * 3
        assert told[-1][0] == expected.node_steps


def test_displacements_and_what_is_recorded(pools, scene, random, small_blocks):
    """Energies of displacements come from workers too; fields and traces of few plates from this process."""
    made, drives = scene((9, 9), damping=20.0), drives_of(random)
    expected = PlateSolver(made, "cpu", quantity="displacement").run(drives)
    assert_same(SpreadSolver(pools[2], made, "cpu", quantity="displacement").run(drives), expected)
    kept = SpreadSolver(pools[2], made, "cpu").run(drives[:2], times=[0.005], points=[(0.1, 0.1)])
    assert kept.displacement.tobytes() == PlateSolver(made, "cpu").run(drives[:2], [0.005]).displacement.tobytes()
    assert kept.trace.shape[:2] == (2, 1)


def test_files_that_a_scene_names_go_with_it(tmp_path, pools, scene, random):
    (tmp_path / "pulse.csv").write_text("time,value\n0,0\n0.002,1\n0.004,0\n", encoding="utf-8")
    drive = {"frequency": 290.0, "signal": {"file": "pulse.csv"}}
    made = scene((9, 9), window=(0.002, 0.004), damping=20.0, drive=drive)
    made, drives = made.in_folder(tmp_path), drives_of(random)
    solver, expected = SpreadSolver(pools[1], made, "cpu"), PlateSolver(made, "cpu").run(drives)
    (tmp_path / "pulse.csv").unlink()
    assert_same(solver.run(drives), expected)


def searched(scene, **search):
    """A scene whose search has several blocks a generation."""
    keys = {"particles": PLATES, "iterations": 4, **search}
    return scene((9, 9), window=(0.002, 0.004), damping=20.0, precision="float32", search=keys)


def assert_same_result(result, expected):
    for name, values in expected.history.items():
        assert result.history[name].tobytes() == values.tobytes(), name
    assert result.cases["best"].drive.tobytes() == expected.cases["best"].drive.tobytes()
    assert (result.node_steps, result.evaluations) == (expected.node_steps, expected.evaluations)


def test_a_search_is_the_same_on_workers(pools, scene, small_blocks):
    objectives = [{"kind": "localization"}, {"kind": "displacement", "weight": 1e3}]
    made = searched(scene, objectives=objectives, magnitude={"range": [0.0, 1.0]})
    expected = localize(made, device="cpu", estimate=False)
    for pool in pools.values():
        result = localize(made, device="cpu", estimate=False, pool=pool)
        assert_same_result(result, expected)
        assert not result.lost
        assert pool.words in result.device


def test_robust_searches_and_comparisons_are_the_same_on_workers(pools, scene, small_blocks):
    robust = scene(
        (9, 9), damping=20.0, precision="float32",
        search={"robust": {"young_modulus": 0.1, "place": 0.002, "scenarios": 3}},
    )  # fmt: skip
    scenarios, areas = draw_scenarios(robust, 3, 0), np.array([one.area for one in robust.actuators])
    middles = areas.reshape(-1, 2, 2).mean(axis=2)
    designs = Designs(drives_of(np.random.default_rng(1)), centre=np.tile(middles, (PLATES, 1, 1)))
    here, there = solve_directly(scenarios, "cpu"), solve_directly(scenarios, "cpu", pool=pools[2])
    assert there.losses(designs).tobytes() == here.losses(designs).tobytes()
    assert there.node_steps == here.node_steps
    made = searched(scene)
    one, two = (compare(made, "", ["pso", "cma"], 1, "cpu", "auto", "direct", pool=pool) for pool in (None, pools[2]))
    assert [trial.loss.tobytes() for trial in one.trials] == [trial.loss.tobytes() for trial in two.trials]


def killed_at_random(pool, solver, drives, expected, random, longest):
    """A run of plates while one of its workers is killed at some moment."""
    victim = random.choice(pool.processes)

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
    with closing(Processes(["cpu", "cpu"])) as pool:
        solver = SpreadSolver(pool, made, "cpu")
        started = time.perf_counter()
        solver.run(drives)
        longest = time.perf_counter() - started
        for _ in range(runs):
            killed_at_random(pool, solver, drives, expected, random, longest)
        assert solver.node_steps == (runs + 1) * expected.node_steps
        assert not solver.lost


@pytest.mark.skipif(sys.platform == "win32", reason="Windows cannot stop a process")
def test_a_worker_that_stands_still_holds_nobody(scene, random, small_blocks):
    """The slowest host that there can be: its block is given to another, and its answer counts for nothing."""
    made, drives = scene((21, 21), damping=20.0, precision="float32"), drives_of(random, 600)
    expected = PlateSolver(made, "cpu").run(drives)
    with closing(Processes(["cpu", "cpu"])) as pool:
        solver = SpreadSolver(pool, made, "cpu")
        solver.run(drives)
        while pool.idle < 2:
            pool.wait(0.1)
        os.kill(pool.processes[0], signal.SIGSTOP)
        assert_same(solver.run(drives), expected)
        os.kill(pool.processes[0], signal.SIGCONT)
        assert_same(solver.run(drives), expected)
        assert solver.node_steps == 3 * expected.node_steps


def poisoned(payload):
    """``run_block`` on a worker that ends under every block whose first drive is 7."""
    if len(payload["drives"]) and payload["drives"][0, 0] == 7:
        os._exit(3)
    return work.run_block(payload)


def test_a_block_that_no_worker_survives_is_named(pools, scene, random, small_blocks, monkeypatch):
    monkeypatch.setattr(blocks, "run_block", poisoned)
    made, drives = scene((9, 9), damping=20.0), drives_of(random)
    drives[64] = 7
    solver = SpreadSolver(pools[2], made, "cpu")
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


def test_lost_plates_are_in_the_result(tmp_path, pools, scene, small_blocks, monkeypatch):
    """They count as worst, and the file says how many and why, also after a checkpoint."""
    made, real = searched(scene, iterations=2), blocks._task
    monkeypatch.setattr(blocks, "run_block", poisoned)
    monkeypatch.setattr("warp_plate.cluster.spread.ATTEMPTS", 1)

    def first_block_is_poison(designs, place, others):
        drives = designs.drives.copy()
        drives[0, 0] = 7 if place.start == 0 and len(drives) == 64 else drives[0, 0]
        return real(Designs(drives), place, others)

    monkeypatch.setattr(blocks, "_task", first_block_is_poison)
    file = CheckpointFile(tmp_path / "panel.checkpoint.h5", 0.0)
    result = localize(made, device="cpu", estimate=False, pool=pools[2], checkpoints=file)
    (why,) = result.lost
    assert result.lost[why] == 2 * 64
    assert load_checkpoint(tmp_path / "panel.checkpoint.h5").lost[why] >= 64
    assert result.evaluations == 2 * PLATES
    assert result.cases["best"].localization_factor > 0
    from warp_plate import save_result

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
    from contextlib import contextmanager

    from warp_plate.cluster import pool

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
    with closing(Processes(["cpu"])) as pool, pytest.raises(WorkersGone, match=r"as they started.*status 5"):
        SpreadSolver(pool, scene((9, 9)), "cpu").run([[1, 1, 1]])


def test_a_solver_that_cannot_be_made_on_a_worker_is_one_line(scene):
    pool = Here()
    pool.device = "cuda:99"
    with pytest.raises(SceneError, match="device = 'cuda:99': not on this machine"):
        SpreadSolver(pool, scene((9, 9)), "cpu").run([[1, 1, 1]])


@pytest.mark.parametrize("name", ["kind", "warp", "warp_plate"])
def test_workers_must_be_alike(name, scene, monkeypatch):
    solver = SpreadSolver(Here(), scene((9, 9)), "cpu")
    solver.run([[1, 1, 1]])
    solver._made[name] = "cuda" if name == "kind" else "0.0"
    with pytest.raises(SceneError, match=f"workers: {name} is"):
        solver.run([[1, 1, 1]])


def doubled(payload):
    """A task of anybody's."""
    return {"twice": 2 * payload["value"]}


def refused(payload):
    raise SceneError(f"value = {payload['value']}: no")


def test_tasks_of_any_function(pools):
    """What a task is wrong about is its own affair; the others are done."""
    tasks = [Task(refused if value == 3 else doubled, {"value": value}, value) for value in range(9)]
    told = []
    pools[3].told = lambda done, total: told.append((done, total))
    found = {task.place: answer for task, answer in spread(pools[3], tasks)}
    pools[3].told = None
    assert {at: answer.value["twice"] for at, answer in found.items() if at != 3} == {
        at: 2 * at for at in range(9) if at != 3
    }
    assert (found[3].fault, found[3].text) == ("wrong", "value = 3: no")
    assert told[-1] == (9, 9)
    assert [done for done, _ in told] == list(range(1, 10))


def test_whoever_leaves_early_can_come_again(pools):
    """What was under way is given up, and no answer of it is taken for another's."""
    for _ in spread(pools[2], [Task(doubled, {"value": value}) for value in range(50)]):
        break
    tasks = [Task(doubled, {"value": np.full(3, value)}, value) for value in range(100, 120)]
    for task, answer in spread(pools[2], tasks):
        assert answer.value["twice"].tolist() == [2 * task.place] * 3


@pytest.mark.parametrize(
    ("devices", "cluster", "line"),
    [
        ("cpu,", None, "--devices cpu,: must be devices with commas between"),
        ("cpu,cuda:99", None, "--devices cpu,cuda:99: device = 'cuda:99': not on this machine"),
        ("cpu", "local:2", "--devices, --cluster: give one of them"),
        (None, "local:0", "--cluster local:0: must be local:COUNT"),
        (None, "missing.json", "--cluster missing.json: no such file"),
    ],
)
def test_pools_that_cannot_be(devices, cluster, line):
    if cluster is not None and devices is None:
        pytest.importorskip("distributed")
    with pytest.raises(SceneError, match=line), open_pool(devices, cluster):
        pass


def test_without_dask_a_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(SceneError, match=r"pip install 'warp-plate\[cluster\]'"), open_pool(None, "local:2"):
        pass


def test_the_command_on_two_processes(tmp_path, scene, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("panel.toml").write_text(dump_scene(searched(scene)), encoding="utf-8")
    common = ["localize", "panel.toml", "--no-pictures", "--no-estimate", "--json"]
    found = []
    for options in (["--device", "cpu", "--out", "one.h5"], ["--devices", "cpu,cpu", "--out", "two.h5"]):
        main([*common, *options])
        found.append(json.loads(capsys.readouterr().out))
    one, two = found
    for name in ("history", "drive", "localization_factor", "node_steps", "evaluations", "lost"):
        assert one[name] == two[name], name
    assert two["device"].endswith("plates of the search on 2 processes (cpu, cpu)")
    with pytest.raises(SystemExit) as left:
        main([*common, "--devices", "cpu,cpu", "--device", "cpu"])
    assert left.value.code == 2
    assert "--device cpu: --devices cpu,cpu says where plates run" in capsys.readouterr().err

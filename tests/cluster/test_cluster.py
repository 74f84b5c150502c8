"""Plates on workers: the same bits whatever runs them, and the right answer whatever happens to who runs them."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from warp_plate import PlateSolver, SceneError, localize
from warp_plate.cli.main import main
from warp_plate.cluster import blocks
from warp_plate.cluster.opening import open_pool
from warp_plate.cluster.pool import Here, Task
from warp_plate.cluster.processes import Processes
from warp_plate.cluster.scheduler import spread
from warp_plate.cluster.solver import SpreadSolver
from warp_plate.plate.designs import Designs, per_plate_of
from warp_plate.problem.scenario_losses import simulate_scenarios
from warp_plate.problem.uncertainty import draw_scenarios
from warp_plate.scene.dump import dump_scene
from warp_plate.studies.compare import compare

PLATES = 150  # blocks of 64, 22 and 64


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
    own, drives = per_plate_of(scene), drives_of(random, plates)
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
    own = per_plate_of(made)
    designs = designs_for(made, random)
    designs.drives[70] = np.nan
    expected = PlateSolver(made, "cpu", per_plate=own, areas={"left": (0, 0.1, 0, 0.2)}).run(designs)
    assert expected.status[70] != "ok"
    for count, pool in pools.items():
        solver = SpreadSolver(pool, made, "cpu", per_plate=own, areas={"left": (0, 0.1, 0, 0.2)})
        told = []
        run = solver.run(designs, progress=lambda done, total, told=told: told.append((done, total)))
        assert_same(run, expected)
        assert solver.node_steps == expected.node_steps, count
        assert [total for _, total in told] == [expected.node_steps] * 3
        assert told[-1][0] == expected.node_steps


@pytest.mark.parametrize("plates", [0, 1, 63, 64, 2112, 4000, 4224, 20000, 131072, 10**6 + 7])
@pytest.mark.parametrize(("most", "least"), [(8448, 2112), (64, 64)])
def test_blocks_are_small_at_both_ends(plates, most, least):
    """Where all workers wait for the first ones, and everybody for the last; the cut knows nothing of workers."""
    places = blocks.cut(plates, most, least)
    cuts = [0, *(place.stop for place in places)]
    assert [place.start for place in places] == cuts[:-1]
    assert cuts[-1] == plates
    sizes = np.diff(cuts)
    assert sum(size % least > 0 for size in sizes) <= 1
    for place, size in zip(places, sizes, strict=True):
        assert 0 < size <= max(least, min(place.start / 2, (plates - place.stop) / 4))
    if plates > 2 * least:
        assert {sizes[0], sizes[-1]} == {least}
    if plates >= 8 * most:
        assert max(sizes) == most


@pytest.mark.parametrize("kind", ["cpu", "cuda"])
@pytest.mark.parametrize("node_steps", [1, 10**4, 781250, 10**8, 10**11])
def test_a_block_has_its_work_or_the_fewest_plates(kind, node_steps):
    most, least = blocks.plates_of_block(node_steps, kind)
    assert least % blocks.FEWEST == 0
    assert most in {least << doubled for doubled in range(4)}
    assert most * node_steps <= max(blocks.BLOCK_NODE_STEPS[kind], blocks.FEWEST * node_steps)
    assert 2 * most * node_steps > min(blocks.BLOCK_NODE_STEPS[kind], 2 * blocks.FEWEST * node_steps)


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
    made = scene(
        (9, 9), window=(0.002, 0.004), damping=20.0, drive={"frequency": 290.0, "signal": {"file": "pulse.csv"}}
    )
    made, drives = made.in_folder(tmp_path), drives_of(random)
    solver, expected = SpreadSolver(pools[1], made, "cpu"), PlateSolver(made, "cpu").run(drives)
    (tmp_path / "pulse.csv").unlink()
    assert_same(solver.run(drives), expected)


def test_a_design_that_is_refused_has_its_number_in_the_batch(scene, random, small_blocks):
    made = scene((9, 9), **SCENES["own"])
    designs = designs_for(made, random)
    designs.frequency[70] = -1.0
    per_plate = per_plate_of(made)
    here = SpreadSolver(Here(), made, "cpu", per_plate=per_plate)
    for solver in (PlateSolver(made, "cpu", per_plate=per_plate), here):
        with pytest.raises(SceneError, match=r"designs\.frequency: -1\.0 of actuator .* on plate 70;"):
            solver.run(designs)


def searched(scene, **search):
    """A scene whose search has several blocks a generation."""
    keys = {"particles": PLATES, "iterations": 4, **search}
    return scene((9, 9), window=(0.002, 0.004), damping=20.0, precision="float32", search=keys)


def assert_same_result(result, expected):
    for name, values in expected.history.items():
        assert result.history[name].tobytes() == values.tobytes(), name
    assert result.cases["best"].phasors.tobytes() == expected.cases["best"].phasors.tobytes()
    assert (result.node_steps, result.evaluations) == (expected.node_steps, expected.evaluations)


def test_a_search_is_the_same_on_workers(pools, scene, small_blocks):
    objectives = [{"kind": "localization"}, {"kind": "displacement", "weight": 1e3}]
    made = searched(scene, objectives=objectives, magnitude={"range": [0.0, 1.0]})
    expected = localize(made, device="cpu", estimate=False)
    for pool in pools.values():
        result = localize(made, device="cpu", estimate=False, pool=pool)
        assert_same_result(result, expected)
        assert not result.lost_plates
        assert pool.words in result.device


def test_robust_searches_and_comparisons_are_the_same_on_workers(pools, scene, small_blocks):
    robust = scene(
        (9, 9), damping=20.0, precision="float32",
        search={"robust": {"young_modulus": 0.1, "place": 0.002, "scenarios": 3}},
    )  # fmt: skip
    scenarios, areas = draw_scenarios(robust, 3, 0), np.array([one.area for one in robust.actuators])
    middles = areas.reshape(-1, 2, 2).mean(axis=2)
    designs = Designs(drives_of(np.random.default_rng(1)), centre=np.tile(middles, (PLATES, 1, 1)))
    here, there = simulate_scenarios(scenarios, "cpu"), simulate_scenarios(scenarios, "cpu", pool=pools[2])
    assert there.losses(designs).tobytes() == here.losses(designs).tobytes()
    assert there.node_steps == here.node_steps
    made = searched(scene)
    one, two = (compare(made, "", ["pso", "cma"], 1, "cpu", "auto", "direct", pool=pool) for pool in (None, pools[2]))
    assert [trial.loss.tobytes() for trial in one.trials] == [trial.loss.tobytes() for trial in two.trials]


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

"""Same scene, seed and device: same bits, in whatever pieces and on however many threads the work is done.

What a plate does alone or in a batch is in ``test_solver.py`` and ``test_moment_form_paths.py``;
here are whole searches.
"""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from warp_plate import PlateSolver, localize
from warp_plate.plate.scheme import make_scheme
from warp_plate.scene.dump import dump_scene
from warp_plate.solve import solver as solver_module
from warp_plate.solve.response import measure_response

ROOT = Path(__file__).parents[2]
SEARCH = {"search": {"particles": 21, "iterations": 4, "seed": 7}, "record": {"points": ((0.1, 0.07),)}}
EFFECTS = {
    "damping": {"viscous": 60.0},
    "material_damping": {"time": 1e-6},
    "tension": {"x": 5.0, "y": 2.0},
    "foundation": {"stiffness": 1e4, "damping": 10.0},
    "layers": [{"area": (0.03, 0.08, 0.03, 0.08), "thickness": 1e-4, "young_modulus": 2e9, "density": 1500.0}],
    "oscillators": [{"area": (0.1, 0.15, 0.1, 0.15), "mass": 1e-3, "stiffness": 500.0, "damping": 0.1}],
}
SCENES = {
    "plain": {"damping": 88.5, "precision": "float32"},
    "fourth order": {"damping": 88.5, "precision": "float32", "order": 4, "load": "moments"},
    "effects": {"effects": EFFECTS, "edges": ("clamped", "supported", "free", "clamped"), "precision": "float32"},
    "stretching": {"effects": {"damping": {"viscous": 60.0}, "stretching": {}}},
}


def digest(result):
    """Of all numbers that a search finds."""
    found = hashlib.sha256(repr((result.bound, result.evaluations, result.node_steps)).encode())
    for values in result.history.values():
        found.update(np.ascontiguousarray(values).tobytes())
    for name in sorted(result.cases):
        case = result.cases[name]
        found.update(repr((name, sorted(case.energy.items()))).encode())
        for values in (case.phasors, case.displacement, case.trace):
            found.update(np.ascontiguousarray(values).tobytes())
    return found.hexdigest()


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("evaluator", ["direct", "response"])
def test_in_any_pieces_on_any_threads(name, evaluator, device, path, scene, monkeypatch):
    made = scene(**SCENES[name], **SEARCH)
    if evaluator == "response" and not made.linear:
        evaluator = "direct"
    found = set()
    for threads, plates in ((1, None), (2, None), (3, 5), (5, 1)):
        monkeypatch.setenv("WARP_PLATE_THREADS", str(threads))
        if plates is not None:
            monkeypatch.setattr(PlateSolver, "_plates_at_once", lambda _, asked, nodes, most=plates: min(most, asked))
        result = localize(made, "", device, None, evaluator, path, estimate=False)
        assert np.isfinite(result.history["best"]).all()
        found.add(digest(result))
    assert len(found) == 1


@pytest.mark.parametrize("segment", [1.0, 3e4])
def test_in_launches_of_any_length(segment, device, path, scene, phasors, monkeypatch):
    made = scene(**SCENES["plain"], **SEARCH)
    drives = phasors(5, 3)
    whole = PlateSolver(made, device, path).run(drives, (0.007,))
    monkeypatch.setattr(solver_module, "SEGMENT_NODE_STEPS", {"cpu": segment, "cuda": segment})
    run = PlateSolver(made, device, path).run(drives, (0.007,))
    np.testing.assert_array_equal(run.energy, whole.energy)
    np.testing.assert_array_equal(run.displacement, whole.displacement)


@pytest.mark.parametrize("nodes", [(13, 13), (97, 89)], ids=["small", "shared by threads"])
def test_threads_of_plates_with_effects(nodes, scene, phasors):
    free = make_scheme(scene(nodes, **SCENES["effects"])).limit
    made = scene(nodes, **SCENES["effects"], time_step=0.9 * free, window=(10 * free, 50 * free))
    drives = phasors(3, 3)
    alone = PlateSolver(made, "cpu", threads=1).run(drives, (20 * free,))
    assert alone.energy.min() > 0
    for threads in (2, 3, 5):
        run = PlateSolver(made, "cpu", threads=threads).run(drives, (20 * free,))
        np.testing.assert_array_equal(run.energy, alone.energy)
        np.testing.assert_array_equal(run.displacement, alone.displacement)


def test_gram_matrices_give_a_drive_the_same_energy_in_any_batch(scene, phasors):
    """A matrix product would not: its library sums in another order for another number of rows."""
    response = measure_response(PlateSolver(scene(damping=88.5), "cpu"))
    drives = phasors(1001, 3)
    whole = response.energy(drives)
    for first, count in ((0, 1), (500, 1), (3, 2), (10, 7), (100, 64), (1, 1000)):
        some = slice(first, first + count)
        np.testing.assert_array_equal(response.energy(drives[some]), whole[some])


ONCE = """
import sys
sys.path.insert(0, {tests!r})
from test_reproducible import digest
from warp_plate import Scene, localize
for evaluator in ("direct", "response"):
    print(digest(localize(Scene.load("panel.toml"), "", "cpu", None, evaluator, estimate=False)))
"""


def test_in_another_process(tmp_path, scene):
    """With other threads, of NumPy's library too, and another seed of Python's hashes."""
    made = scene(**SCENES["effects"], **SEARCH)
    (tmp_path / "panel.toml").write_text(dump_scene(made), encoding="utf-8")
    expected = [digest(localize(made, "", "cpu", None, name, estimate=False)) for name in ("direct", "response")]
    threads = {"WARP_PLATE_THREADS": "3", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONHASHSEED": "77"}
    answer = subprocess.run(
        [sys.executable, "-c", ONCE.format(tests=str(ROOT / "tests"))],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env={**os.environ, **threads, "PYTHONPATH": str(ROOT)},
        check=True,
    )
    assert answer.stdout.split() == expected

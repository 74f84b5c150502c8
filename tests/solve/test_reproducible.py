"""Same scene, seed and device: the same bits, on any number of threads, in pieces of any size, in any process.

Single plates and batches are in ``test_solver.py`` and ``test_moment_form_paths.py``; here are whole searches.
"""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from warp_plate import localize
from warp_plate.scene.dump import dump_scene

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
    "fourth order": {"damping": 88.5, "precision": "float32", "order": 4, "load": "moments"},
    "effects": {"effects": EFFECTS, "edges": ("clamped", "supported", "free", "clamped"), "precision": "float32"},
}


def digest(result):
    """Return a hash of all numbers that a search found."""
    found = hashlib.sha256(repr((result.bound, result.evaluations, result.node_steps)).encode())
    for values in result.history.values():
        found.update(np.ascontiguousarray(values).tobytes())
    for name in sorted(result.cases):
        case = result.cases[name]
        found.update(repr((name, sorted(case.energy.items()))).encode())
        for values in (case.phasors, case.displacement, case.trace):
            found.update(np.ascontiguousarray(values).tobytes())
    return found.hexdigest()


@pytest.mark.parametrize(("name", "evaluator"), [("fourth order", "direct"), ("effects", "response")])
def test_on_any_number_of_threads_in_pieces_of_any_size(name, evaluator, device, path, scene, monkeypatch):
    made, found = scene(**SCENES[name], **SEARCH), set()
    for threads, node_steps in ((1, 1e9), (2, 1e4), (5, 1.0)):
        monkeypatch.setenv("WARP_PLATE_THREADS", str(threads))
        monkeypatch.setattr(
            "warp_plate.solve.batching.SEGMENT_NODE_STEPS", {"cpu": node_steps, "cuda": max(1e5, node_steps)}
        )
        result = localize(made, "", device, None, evaluator, path, estimate=False)
        assert np.isfinite(result.history["best"]).all()
        found.add(digest(result))
    assert len(found) == 1


ONCE = """
import sys
sys.path.insert(0, {tests!r})
from test_reproducible import digest
from warp_plate import Scene, localize
print(digest(localize(Scene.load("panel.toml"), "", "cpu", None, "response", estimate=False)))
"""


def test_in_another_process(tmp_path, scene):
    """With other threads, of NumPy's library too, and another seed of Python's hashes."""
    made = scene(**SCENES["effects"], **SEARCH)
    (tmp_path / "panel.toml").write_text(dump_scene(made), encoding="utf-8")
    threads = {"WARP_PLATE_THREADS": "3", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONHASHSEED": "77"}
    answer = subprocess.run(
        [sys.executable, "-c", ONCE.format(tests=str(Path(__file__).parent))],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env={**os.environ, **threads},
        check=True,
    )
    assert answer.stdout.split() == [digest(localize(made, "", "cpu", None, "response", estimate=False))]

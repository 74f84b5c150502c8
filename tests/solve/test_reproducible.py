"""Same scene, seed and device: the same bits of a search, on any number of threads and in any process."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from support.oracle import FOUR_EDGES, LINEAR
from support.searches import digest
from warp_plate import localize

SEARCH = {"search": {"particles": 21, "iterations": 4, "seed": 7}, "record": {"points": ((0.1, 0.07),)}}
SCENES = {
    "fourth order": {"damping": 60.0, "order": 4, "load": "moments"},
    "effects": {"effects": LINEAR, "edges": FOUR_EDGES, "precision": "float32"},
}


@pytest.mark.parametrize(("name", "evaluator"), [("fourth order", "direct"), ("effects", "response")])
def test_on_any_number_of_threads(name, evaluator, device, path, scene, monkeypatch):
    made, found = scene(**SCENES[name], **SEARCH), set()
    for threads in (1, 5):
        monkeypatch.setenv("WARP_PLATE_THREADS", str(threads))
        result = localize(made, device=device, evaluator=evaluator, path=path, estimate=False)
        assert np.isfinite(result.history["best"]).all()
        found.add(digest(result))
    assert len(found) == 1


ONCE = """
from support.searches import digest
from warp_plate import Scene, localize
print(digest(localize(Scene.load("panel.toml"), device="cpu", evaluator="response", estimate=False)))
"""


def test_in_another_process(tmp_path, scene):
    """Runs use other numbers of threads, of NumPy's library too, and another seed of Python's hashes."""
    made = scene(**SCENES["effects"], **SEARCH)
    (tmp_path / "panel.toml").write_text(made.to_toml(), encoding="utf-8")
    threads = {"WARP_PLATE_THREADS": "3", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONHASHSEED": "77"}
    path = os.pathsep.join([str(Path(__file__).parents[1]), os.environ["PYTHONPATH"]])
    environment = {**os.environ, **threads, "PYTHONPATH": path}
    answer = subprocess.check_output([sys.executable, "-c", ONCE], cwd=tmp_path, text=True, env=environment)
    assert answer.split() == [digest(localize(made, device="cpu", evaluator="response", estimate=False))]

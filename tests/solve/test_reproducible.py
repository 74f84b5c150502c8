"""Same scene, seed and device: the same bits of a search in any process, on any number of threads."""

import os
import subprocess
import sys
from pathlib import Path

from support.oracle import FOUR_EDGES, LINEAR
from support.searches import digest
from warp_plate import localize

ONCE = """
from support.searches import digest
from warp_plate import Scene, localize
print(digest(localize(Scene.load("panel.toml"), device="cpu", evaluator="response", estimate=False)))
"""


def test_in_another_process(tmp_path, scene):
    """Runs use other numbers of threads, of NumPy's library too, and another seed of Python's hashes."""
    made = scene(
        effects=LINEAR, edges=FOUR_EDGES, precision="float32", record={"points": ((0.1, 0.07),)},
        search={"particles": 21, "iterations": 4, "seed": 7},
    )  # fmt: skip
    (tmp_path / "panel.toml").write_text(made.to_toml(), encoding="utf-8")
    threads = {"WARP_PLATE_THREADS": "3", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONHASHSEED": "77"}
    path = os.pathsep.join([str(Path(__file__).parents[1]), os.environ["PYTHONPATH"]])
    environment = {**os.environ, **threads, "PYTHONPATH": path}
    answer = subprocess.check_output([sys.executable, "-c", ONCE], cwd=tmp_path, text=True, env=environment)
    assert answer.split() == [digest(localize(made, device="cpu", evaluator="response", estimate=False))]

"""Same scene, seed and device: the same bits in any process, on any number of threads, and in threads that share a
solver."""

import copy
import os
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from support.oracle import FOUR_EDGES, LINEAR
from support.searches import digest
from warp_plate import PlateSolver, localize
from warp_plate.modal.solver import ModalSolver

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


def test_threads_that_share_a_solver(device, path, scene, phasors):
    """They run plates and step others by hand at the same time."""
    made = scene(damping=88.5, precision="float32")
    solver = PlateSolver(made, device, path)
    batches = [phasors(plates, len(made.actuators)) for plates in (4, 5, 33)]
    expected = [solver.run(drives).energy for drives in batches]
    solver.setup(batches[0])
    with ThreadPoolExecutor(len(batches)) as threads:
        runs = [threads.submit(lambda at: solver.run(batches[at]).energy, at) for at in [0, 1, 2] * 40]
        while solver.time < 0.9 * made.window.end:
            solver.step(3)
    for index, run in enumerate(runs):
        np.testing.assert_array_equal(run.result(), expected[index % 3])
    solver.step(solver.scheme.steps)
    np.testing.assert_array_equal(solver.energy, expected[0])


def test_threads_that_make_solvers(scene, phasors):
    """Warp makes and loads kernels in one thread at a time, and standard error is that of before."""
    made = [scene((19 + index, 21), damping=88.5, precision="float32") for index in range(6)]
    drives, error = phasors(5, len(made[0].actuators)), os.fstat(2)
    expected = [PlateSolver(each, "cpu").run(drives).energy for each in made]
    with ThreadPoolExecutor(len(made)) as threads:
        found = list(threads.map(lambda each: PlateSolver(each, "cpu").run(drives).energy, made * 4))
    np.testing.assert_array_equal(found, expected * 4)
    assert os.path.samestat(os.fstat(2), error)


def test_progress_cannot_run_plates_of_its_own_solver(scene, phasors):
    made = scene(damping=88.5, precision="float32")
    solver, drives = PlateSolver(made, "cpu"), phasors(3, len(made.actuators))
    with pytest.raises(RuntimeError, match="make another solver for it"):
        solver.run(drives, progress=lambda done, total: solver.run(drives))
    assert solver.run(drives).energy.all()


@pytest.mark.parametrize("solver_class", [PlateSolver, ModalSolver])
def test_solvers_are_neither_pickled_nor_copied(solver_class, scene):
    solver = solver_class(scene(), "cpu")
    for duplicate in (pickle.dumps, copy.copy, copy.deepcopy):
        with pytest.raises(TypeError, match=f"{solver_class.__name__}: make it again from its scene"):
            duplicate(solver)

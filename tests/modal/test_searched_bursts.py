"""Plates under bursts, sweeps and files that differ in drives, frequencies, places and delays, by modes."""

import numpy as np
import pytest

from support.scenes import areas_of, scene_of
from warp_plate.modal.gram import Means, gram_matrices
from warp_plate.modal.solver import ModalSolver
from warp_plate.optimize.quadratic import quadratic_forms
from warp_plate.plate.designs import Designs, PerPlate

TARGET = {"disc": (0.13, 0.11, 0.03)}
CHIRP = {"frequency": 200.0, "chirp": {"end_frequency": 350.0, "duration": 0.005}}
BURSTS = {
    "single": {"start": 0.001, "ramp": 0.0015, "duration": 0.004},
    "repeated and abrupt": {"ramp": 0.0, "duration": 0.0025, "period": 0.004},
}


def areas_at(scene, centre):
    """Return the rectangles (..., actuators, 4) of the actuators around centres (..., actuators, 2) [m]."""
    half = np.diff(areas_of(scene), axis=2)[..., 0] / 2
    return np.stack([centre - half, centre + half], axis=-1).reshape(*centre.shape[:-1], 4)


def coarse(scene):
    """Return a scene whose modes are few."""
    return scene.with_tables(grid={"nodes": (13, 13), "modal_density": 0.5})


@pytest.mark.parametrize("damping", [pytest.param(None, marks=pytest.mark.slow), 60.0])
@pytest.mark.parametrize("name", ["single", pytest.param("repeated and abrupt", marks=pytest.mark.slow)])
def test_energies_are_those_of_the_closed_form(name, damping, random):
    """Gram matrices by intervals, which have exponentials and nothing else, are exact."""
    scene = coarse(scene_of(damping=damping, target=TARGET, drive={"frequency": 290.0, "burst": BURSTS[name]}))
    per_plate = PerPlate(frequency=True, delay=True, centre=True, per_actuator=True)
    solver, shape = ModalSolver(scene, per_plate=per_plate), (2, 3)
    drives = random.normal(size=shape) + 1j * random.normal(size=shape)
    centre = random.uniform([0.04, 0.04], [0.16, 0.16], (*shape, 2))
    designs = Designs(drives, random.uniform(200, 400, shape), centre, random.uniform(0, 0.006, shape))
    forces = np.stack([solver.plate.patch_forces(areas) for areas in areas_at(scene, centre)])
    regions = [solver.plate.kinetic_matrix(region) for region in ("plate", scene.target)]
    exact = gram_matrices(Means(solver.plate, regions, scene.window), forces, designs.frequency, designs.delay)
    size = np.abs(exact).max(axis=(2, 3), keepdims=True)
    assert np.allclose(solver.gram_matrices(designs) / size, exact / size, rtol=0, atol=3e-4)
    expected = [quadratic_forms(*pair)[0] for pair in zip(exact, drives[:, None], strict=True)]
    assert np.allclose(solver.run(designs).energy, expected, rtol=2e-3)


def test_places_under_sweeps(random):
    """Plates with other places are those of a scene with its actuators there."""
    scene = coarse(scene_of(damping=60.0, target=TARGET, window=(0.002, 0.006), drive=CHIRP))
    centre = random.uniform([0.04, 0.04], [0.16, 0.16], (1, 3, 2))
    pairs = zip(scene.actuators, areas_at(scene, centre[0]).tolist(), strict=True)
    rows = [{**actuator.model_dump(), "area": tuple(area)} for actuator, area in pairs]
    drives = random.normal(size=(1, 3)) + 1j * random.normal(size=(1, 3))
    moved = ModalSolver(scene, per_plate=PerPlate(centre=True)).run(Designs(drives, centre=centre)).energy
    assert np.allclose(moved, ModalSolver(scene.with_tables(actuators=rows)).run(drives).energy, rtol=1e-3)

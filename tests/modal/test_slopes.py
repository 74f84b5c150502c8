"""Slopes of energies by formula, against central differences of the Gram matrices' quadratic forms."""

from dataclasses import replace

import numpy as np
import pytest

from support.scenes import scene_of
from warp_plate.modal.gram import Means, gram_matrices
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.slopes import energy_slopes
from warp_plate.modal.solver import ModalSolver
from warp_plate.optimize.quadratic import quadratic_forms
from warp_plate.plate.designs import Designs
from warp_plate.scene.errors import SceneError

OSCILLATOR = {"area": (0.05, 0.09, 0.1, 0.12), "mass": 2e-3, "stiffness": 3e3, "damping": 0.5}
LOSSY = {"loss_factor": {"eta": 0.02}}
BURST = {"start": 0.0, "ramp": 0.0015, "duration": 0.004}
CASES = {
    "tones": {"damping": 40.0},
    "coupled": {"damping": 40.0, "effects": {"oscillators": [OSCILLATOR]}},
    "steady": {"effects": LOSSY},
    "steady and coupled": {"effects": {**LOSSY, "oscillators": [OSCILLATOR]}},
    "bursts": {"damping": 40.0, "drive": {"frequency": 290.0, "burst": BURST}},
    "abrupt bursts": {"drive": {"frequency": 290.0, "burst": {**BURST, "ramp": 0.0, "period": 0.005}}},
}
SLOW = ("coupled", "bursts", "abrupt bursts")
# Steps h of differences: errors of h⁴, after extrapolation, and of rounding are below 1e-7.
STEPS = {"real": 1e-2, "imaginary": 1e-2, "frequency": 0.05, "x": 1e-4, "y": 1e-4, "delay": 1e-5}
SIDES = np.array([[-0.5, 0.5, 0, 0], [0, 0, -0.5, 0.5]]) * [0.014, 0.014, 0.02, 0.02]


def areas_around(centre):
    """Return x0, x1, y0, y1 (..., 4) of patches around centres (..., 2)."""
    return np.repeat(centre, 2, axis=-1) + SIDES.sum(axis=0)


@pytest.mark.parametrize("alike", [True, False], ids=["one frequency", "own frequencies"])
@pytest.mark.parametrize("quantity", ["velocity", pytest.param("displacement", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.slow if name in SLOW else ()) for name in CASES])
def test_slopes_are_those_of_differences(name, quantity, alike, random):
    scene = scene_of(window=(0.003, 0.008), target={"disc": (0.13, 0.11, 0.03)}, **CASES[name])
    plate = replace(solve_modes(scene, density=0.8), negligible=0.0)
    regions = [plate.kinetic_matrix(), plate.kinetic_matrix(scene.target)]
    means = Means(plate, regions, None if scene.steady else scene.window, quantity == "velocity")
    shape = (2, 3)
    shared = (2, 1) if alike else shape
    base = {
        "real": random.normal(size=shape),
        "imaginary": random.normal(size=shape),
        "frequency": random.uniform(200, 400, shared) * np.ones(shape),
        "x": random.uniform(0.02, 0.18, shape),
        "y": random.uniform(0.02, 0.18, shape),
        "delay": random.uniform(5e-4, 4e-3, shared) * np.ones(shape) if scene.drive.burst else None,
    }

    def energies(values):
        areas = areas_around(np.stack([values["x"], values["y"]], axis=-1))
        forces = np.stack([plate.patch_forces(each) for each in areas])
        matrices = gram_matrices(means, forces, values["frequency"], values["delay"])
        phasors = values["real"] + 1j * values["imaginary"]
        return np.stack([quadratic_forms(*pair)[0] for pair in zip(matrices, phasors[:, None], strict=True)])

    areas = areas_around(np.stack([base["x"], base["y"]], axis=-1))
    phasors = base["real"] + 1j * base["imaginary"]
    found = energy_slopes(means, phasors, base["frequency"], areas, base["delay"])
    assert np.allclose(found.energy, energies(base), rtol=1e-7, atol=0)
    slopes = {
        "real": found.drives[..., :3],
        "imaginary": -found.drives[..., 3:],
        "frequency": found.frequency,
        "x": found.centre[..., 0],
        "y": found.centre[..., 1],
        "delay": found.delay,
    }
    for kind, step in STEPS.items():
        if base[kind] is None:
            continue
        together = kind == "frequency" and alike and scene.steady  # apart they would no longer interfere
        direction = np.ones(shape) if together else random.uniform(0.5, 1, shape) * random.choice([-1, 1], shape)
        coarse, fine = (
            (
                energies({**base, kind: base[kind] + h * direction})
                - energies({**base, kind: base[kind] - h * direction})
            )
            / (2 * h)
            for h in (step, step / 2)
        )
        expected, size = (4 * fine - coarse) / 3, np.abs(slopes[kind]).sum(axis=2).max()
        along = (slopes[kind] * direction[:, None]).sum(axis=2)
        assert np.allclose(along, expected, rtol=0, atol=1e-6 * size), kind


def test_solver_refuses_slopes_of_sweeps():
    solver = ModalSolver(scene_of(drive={"frequency": 290.0, "chirp": {"end_frequency": 400.0, "duration": 0.01}}))
    with pytest.raises(SceneError, match=r"drive\.chirp"):
        solver.energy_slopes(Designs(np.ones((1, 3))))

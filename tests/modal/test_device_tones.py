"""Gram matrices of batches under tones by the Warp kernels, against those by NumPy."""

import numpy as np
import pytest
import warp as wp

from support.scenes import scene_of
from warp_plate.modal.device_tones import DeviceToneMatrices
from warp_plate.modal.gram import Means, ToneMatrices, gram_matrices
from warp_plate.modal.modes import solve_modes
from warp_plate.solve.devices import find_device

SIZE, PLATES = (0.2, 0.15), 5
DISC = {"disc": (0.13, 0.06, 0.04)}
CASES = {
    "viscous": ({"damping": 88.3, "window": (0.06, 0.11)}, "velocity"),
    "free motions have died away": ({"damping": 88.3, "window": (2.0, 2.05)}, "velocity"),
    "light damping, a disc": ({"damping": 3.0, "target": DISC}, "displacement"),
    "rigid motions, overdamped": ({"damping": 400.0, "edges": ("free",) * 4, "target": DISC}, "velocity"),
    "steady": ({"effects": {"loss_factor": {"eta": 0.01}, "damping": {"viscous": 5.0}}}, "velocity"),
    "steady, a free edge": (
        {"effects": {"loss_factor": {"eta": 0.01}}, "edges": ("free", "supported", "free", "free")},
        "displacement",
    ),
    "piezo": ({"damping": 20.0}, "velocity"),
    "piezo, steady": ({"effects": {"loss_factor": {"eta": 0.02}}}, "velocity"),
}


@pytest.fixture(params=["cpu", "cuda:0"] if wp.is_cuda_available() else ["cpu"])
def device(request):
    return find_device(request.param)


@pytest.fixture(scope="module")
def damped_plate():
    return solve_modes(scene_of(size=SIZE, damping=20.0), highest=400.0, density=0.6)


def batch(random, many=True):
    """Return frequencies (plates, 3) [Hz] and areas (plates, 3, 4) [m] of patches of one size."""
    frequency = random.uniform(100, 400, (PLATES, 3 if many else 1)) * np.ones(3)
    low = random.uniform(0, 0.12, (PLATES, 3, 2))
    low[0, 0], low[0, 1] = 0.0, (SIZE[0] - 0.03, SIZE[1] - 0.02)  # up to the corners
    high = low + (0.03, 0.02)
    return frequency, np.stack([low[..., 0], high[..., 0], low[..., 1], high[..., 1]], axis=-1)


def patched(scene):
    """Return the scene with piezo patches in the places of its actuators."""
    piezo = {"kind": "piezo", "d31": -190e-12, "thickness": 1e-4, "young_modulus": 6e10}
    return scene.with_tables(
        actuators=[{"name": actuator.name, "area": actuator.area, **piezo} for actuator in scene.actuators]
    )


def both(plate, quantity, device, frequency, areas):
    """Return matrices by the kernels and by NumPy, each region's relative to its largest."""
    scene = plate.scene
    regions = [plate.kinetic_matrix(), plate.kinetic_matrix(scene.target)]
    means = Means(plate, regions, None if scene.steady else scene.window, quantity == "velocity")
    forces = np.stack([plate.drive_forces(row) for row in areas])
    exact = gram_matrices(means, forces, frequency) if scene.steady else ToneMatrices(means).matrices(frequency, forces)
    found = DeviceToneMatrices(means, device).matrices(frequency, areas)
    size = np.abs(exact).max(axis=(2, 3), keepdims=True)
    return found / size, exact / size


@pytest.mark.parametrize("name", CASES)
def test_kernels_have_the_matrices_of_numpy(random, device, name):
    """Every second case has a frequency for each actuator, the others one for each plate; piezo patches stay."""
    (tables, quantity), many = CASES[name], list(CASES).index(name) % 2 == 0
    scene, (frequency, areas) = scene_of(size=SIZE, **tables), batch(random, many)
    if "piezo" in name:
        scene, areas = patched(scene), np.array([[actuator.area for actuator in scene.actuators]])
    plate = solve_modes(scene, highest=400.0, density=0.6)
    found, exact = both(plate, quantity, device, frequency, areas)
    assert found.shape == exact.shape
    assert np.allclose(found, exact, rtol=0, atol=1e-10)


def test_undamped_plate_at_resonance(random, device):
    """Exponentials that nearly cancel leave five digits."""
    plate = solve_modes(scene_of(size=SIZE), highest=400.0, density=0.6)
    frequency, areas = batch(random)
    frequency[1:3] = plate.frequencies[1]
    found, exact = both(plate, "velocity", device, frequency, areas)
    assert np.allclose(found, exact, rtol=0, atol=1e-4)


def test_plates_do_not_feel_their_neighbours(random, device, damped_plate):
    """A plate has the same bits alone, in a batch, in blocks, and beside one that is not finite."""
    plate, (frequency, areas) = damped_plate, batch(random)
    means = Means(plate, [plate.kinetic_matrix(plate.scene.target)], plate.scene.window)
    tones = DeviceToneMatrices(means, device)
    together = tones.matrices(frequency, areas)
    for row in range(PLATES):
        assert np.array_equal(tones.matrices(frequency[row : row + 1], areas[row : row + 1])[0], together[row])
    frequency[2] = np.nan
    beside = DeviceToneMatrices(means, device, 2 * 6 * len(plate.frequencies)).matrices(frequency, areas)
    kept = [0, 1, 3, 4]
    assert np.array_equal(beside[kept], together[kept])
    assert np.isnan(beside[2]).any()

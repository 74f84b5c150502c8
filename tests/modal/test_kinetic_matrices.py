"""Kinetic-energy matrices of regions, against sums over many points."""

from itertools import pairwise

import numpy as np
import pytest

from support.scenes import MATERIAL, scene_of
from warp_plate.modal.assemble import make_galerkin, make_space
from warp_plate.modal.modes import solve_modes
from warp_plate.scene.target import Target

SIZE = (0.23, 0.17)
LAYER = {"area": (0.05, 0.11, 0.03, 0.08), "thickness": 3e-4, "young_modulus": 3e9, "density": 2000.0}
MODES, POINTS = 12, 240
POLYGON = [(0.02, 0.02), (0.2, 0.03), (0.12, 0.08), (0.19, 0.15), (0.03, 0.14), (0.09, 0.09)]
REGIONS = {
    "plate": "plate",
    "rectangle": (0.033, 0.141, 0.052, 0.11),
    "disc": Target(disc=(0.1, 0.08, 0.057)),
    "concave polygon": Target(polygon=POLYGON),
    "clockwise polygon": Target(polygon=POLYGON[::-1]),
    "mask": Target(mask="mask.csv"),
}
MASK = np.array([[0.0, 0.5, 1.0, 0.2], [1.0, 1.0, 0.3, 0.0], [0.4, 0.0, 0.7, 0.9]])


def middles(side):
    return (np.arange(POINTS) + 0.5) * side / POINTS


def inside(region, x, y):
    """Return the share of the region at points (y, x), 0 ... 1."""
    if isinstance(region, str):
        return np.ones((y.size, x.size))
    if isinstance(region, tuple):
        return np.outer((y > region[2]) & (y < region[3]), (x > region[0]) & (x < region[1]))
    if region.disc:
        return np.hypot(x - region.disc[0], y[:, None] - region.disc[1]) < region.disc[2]
    if region.mask:
        rows = [np.interp(x, np.linspace(0, SIZE[0], 4), row) for row in MASK]
        return np.array([np.interp(y, np.linspace(0, SIZE[1], 3), column) for column in np.array(rows).T]).T
    crossings = np.zeros((y.size, x.size), dtype=int)
    for (x0, y0), (x1, y1) in zip(region.polygon, np.roll(region.polygon, -1, axis=0), strict=True):
        ahead = x < (x0 + (x1 - x0) * (y - y0) / (y1 - y0))[:, None]
        crossings += ahead & ((y0 < y) != (y1 < y))[:, None]
    return crossings % 2


@pytest.fixture(scope="module")
def layered_plate(tmp_path_factory):
    """Modes of a plate with a layer and two oscillators, one of which has a mass."""
    folder = tmp_path_factory.mktemp("scene")
    np.savetxt(folder / "mask.csv", MASK, delimiter=",")
    oscillators = [
        {"area": (0.15, 0.18, 0.1, 0.13), "mass": 3e-3, "stiffness": 60.0, "damping": 0.05},
        {"area": (0.02, 0.04, 0.1, 0.12), "stiffness": 90.0},
    ]
    edges = ("clamped", "free", "supported", "free")
    effects = {"layers": [LAYER], "oscillators": oscillators}
    scene = scene_of(size=SIZE, edges=edges, effects=effects, target={"mask": "mask.csv"})
    return solve_modes(scene.in_folder(folder), highest=20.0, count=MODES, density=0.45)


@pytest.mark.parametrize("within", [None, (0.04, 0.15, 0.03, 0.12)])
@pytest.mark.parametrize("name", REGIONS)
def test_regions(layered_plate, name, within):
    region, (x, y) = REGIONS[name], (middles(side) for side in SIZE)
    shapes = layered_plate.displacement(np.eye(MODES, len(layered_plate.frequencies)), x, y).reshape(MODES, -1)
    density = MATERIAL["density"] * MATERIAL["thickness"] + 0.6 * inside(LAYER["area"], x, y)
    density = density * inside(region, x, y) * (1 if within is None else inside(within, x, y))
    cell = SIZE[0] * SIZE[1] / POINTS**2
    expected = (shapes * density.ravel()) @ shapes.T * cell
    matrix = layered_plate.kinetic_matrix(region, within)
    assert np.allclose(matrix, matrix.T, rtol=0, atol=1e-12)
    assert np.allclose(matrix[:MODES, :MODES], expected, rtol=0, atol=6e-3)
    assert np.linalg.eigvalsh(matrix[:MODES, :MODES]).min() > -1e-9


def test_parts_add_up(layered_plate):
    """∫ over all rectangles of a division, the whole as a rectangle, a polygon, and the identity less the masses."""
    lowest, (width, height) = (slice(300),) * 2, SIZE  # the highest are orthogonal but for rounding
    whole = layered_plate.kinetic_matrix()[lowest]
    cuts = [0.0, 0.06, 0.1, width], [0.0, 0.04, height]
    cells = [(*cuts[0][i : i + 2], *cuts[1][j : j + 2]) for i in range(3) for j in range(2)]
    assert np.allclose(sum(layered_plate.kinetic_matrix(cell)[lowest] for cell in cells), whole, rtol=0, atol=1e-9)
    outline = Target(polygon=[(0, 0), (width, 0), (width, height), (0, height)])
    assert np.allclose(layered_plate.kinetic_matrix(outline)[lowest], whole, rtol=0, atol=1e-9)
    motion = layered_plate.attached_motions[:300, 0]
    assert np.allclose(whole + 3e-3 * np.outer(motion, motion), np.eye(300), rtol=0, atol=1e-9)


@pytest.mark.parametrize("disc", [(0.1, 0.08, 0.057), (0.0505, 0.06, 0.004)], ids=["large", "small"])
def test_disc_across_a_layer(layered_plate, disc):
    """Chords by Gauss's rule, each in and beside the layer; between the angles at which they enter or leave it, too."""
    (left, right, bottom, top), (x0, y0, radius) = LAYER["area"], disc
    nodes, shares = np.polynomial.legendre.leggauss(14)
    shapes, expected = np.eye(MODES, len(layered_plate.frequencies)), 0.0
    across = np.arccos(np.clip(np.abs(np.array([left, right]) - x0) / radius, 0, 1))
    up = np.arcsin(np.clip([-1, (bottom - y0) / radius, (top - y0) / radius, 1], -1, 1))
    for low, high in pairwise(np.unique([*up, *across, *-across])):
        for angle, part in zip((low + high) / 2 + (high - low) / 2 * nodes, (high - low) / 2 * shares, strict=True):
            y, half = y0 + radius * np.sin(angle), radius * np.cos(angle)
            ends = np.clip([x0 - half, left, right, x0 + half], x0 - half, x0 + half)
            x = (ends[:-1, None] + np.diff(ends)[:, None] * (1 + nodes) / 2).ravel()
            weights = (np.diff(ends)[:, None] * shares / 2).ravel() * half * part
            mass = MATERIAL["density"] * MATERIAL["thickness"] + 0.6 * inside(LAYER["area"], x, np.array([y]))[0]
            values = layered_plate.displacement(shapes, x, np.array([y]))[:, 0]
            expected = expected + (values * weights * mass) @ values.T
    error = np.abs(layered_plate.kinetic_matrix(Target(disc=disc))[:MODES, :MODES] - expected).max()
    assert error < 1e-8 * np.abs(expected).max()


@pytest.mark.parametrize(("key", "expected"), [("young_modulus", 1.0), ("density", 1 + 0.1 / SIZE[0])])
def test_mass_of_a_disc_on_a_mapped_plate(key, expected):
    scene = scene_of(size=SIZE, edges=("free",) * 4, effects={"variation": {key: [[1.0, 2.0]]}})
    matrix = make_space(scene, (6, 6)).region_matrix(Target(disc=(0.1, 0.08, 0.05)))  # the functions' sum is 1
    mass = MATERIAL["density"] * MATERIAL["thickness"] * np.pi * 0.05**2
    assert np.isclose(matrix.sum(), expected * mass, rtol=1e-9)


@pytest.mark.parametrize("effects", [{}, {"layers": [LAYER], "variation": {"thickness": [[1.0, 1.2], [1.1, 0.9]]}}])
def test_bending_energies_are_those_of_the_matrix(random, effects):
    scene = scene_of(size=SIZE, edges=("clamped", "free", "supported", "free"), effects=effects)
    galerkin = make_galerkin(scene, make_space(scene, (25, 18)))
    vectors = random.normal(size=(galerkin.bending.shape[0], 5))
    expected = vectors.T @ (galerkin.bending.toarray() @ vectors)
    assert np.allclose(galerkin.space.bending_energies(vectors), expected, rtol=0, atol=1e-12 * np.abs(expected).max())

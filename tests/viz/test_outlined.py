"""Pictures of plates with an outline end at it, and exported fields are empty beyond it."""

import h5py
import matplotlib.pyplot as plt
import numpy as np
import pytest
import shapely

from warp_plate import Scene
from warp_plate.result.export import write_vtkhdf
from warp_plate.viz.fields import drawing_scale
from warp_plate.viz.outlined import OutlinedNodes, continued, on_plate, outlined_nodes
from warp_plate.viz.plots.frame import figure
from warp_plate.viz.plots.plan import draw_field
from warp_plate.viz.scene3d import PlateMeshes

pytest.importorskip("pyvista")

RADIUS, HOLE = 0.05, 0.012


@pytest.fixture(scope="module")
def ring():
    tables = Scene.load("paper").model_dump(exclude_none=True)
    del tables["plate"]["size"]
    tables["plate"] |= {"outline": {"disc": (RADIUS,) * 3}, "holes": [{"disc": (0.04, 0.035, HOLE)}]}
    tables["edges"] = {"outline": "free"}
    tables["grid"] = {"nodes": (41, 41)}
    tables["actuators"] = tables["actuators"][:1]
    tables["target"] = {"area": (0.0, 0.05, 0.0, 0.1)}
    return Scene.from_tables(tables)


@pytest.fixture(scope="module")
def plane():
    """A field linear in x and y, over the nodes."""
    x, y = np.meshgrid(*2 * [np.linspace(0, 2 * RADIUS, 41)])
    return 3 * x - 2 * y + 0.01


def test_fields_are_continued_along_straight_lines(ring, plane):
    nodes = outlined_nodes(ring, plane.shape)
    assert isinstance(nodes, OutlinedNodes)
    hidden = np.where(nodes.inside, plane, 0.0)
    rim = tuple(nodes.rim.T)
    np.testing.assert_allclose(continued(ring, hidden)[rim], plane[rim], atol=1e-12)
    moved = nodes.continued(np.stack([hidden, -hidden]), moved=True)
    there = 3 * nodes.moved[:, 0] - 2 * nodes.moved[:, 1] + 0.01
    np.testing.assert_allclose(moved[(0, *rim)], there, atol=6e-3)  # the points move up to half a spacing askew
    np.testing.assert_allclose(moved[1], -moved[0])
    middle = np.array([RADIUS, RADIUS])
    outer = np.abs(np.linalg.norm(nodes.moved - middle, axis=1) - RADIUS)
    inner = np.abs(np.linalg.norm(nodes.moved - [0.04, 0.035], axis=1) - HOLE)
    assert np.minimum(outer, inner).max() < 2e-4 * RADIUS


def test_parts_are_drawn_on_the_plate_alone(ring):
    """A rectangle from the middle of the disc to its lower left, and over a hole, loses what is beyond."""
    path = np.array([(0.0, 0.0), (0.05, 0.0), (0.05, 0.05), (0.0, 0.05), (0.0, 0.0)])
    (clipped,) = on_plate(ring, [path])
    x, y = clipped.T
    area = abs(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])) / 2
    quarter = np.pi * RADIUS**2 / 4
    covered = shapely.Point(0.04, 0.035).buffer(HOLE, 64).intersection(shapely.Polygon(path)).area
    assert area == pytest.approx(quarter - covered, rel=1e-3)
    assert on_plate(ring, [0.1 * path + (0.038, 0.033)]) == []  # inside the hole


def test_the_surface_ends_at_the_outline(ring, plane):
    meshes = PlateMeshes(ring, 1e-6 * plane, drawing_scale([1e-6 * plane], ring.plate.size))
    flat = meshes.surface.copy()
    flat.points[:, 2] = 0
    assert flat.area == pytest.approx(np.pi * (RADIUS**2 - HOLE**2), rel=0.01)
    x, y = meshes.lines["grid"].mesh.points[:, :2].T
    assert np.hypot(x - RADIUS, y - RADIUS).max() <= RADIUS * (1 + 1e-6)
    assert np.hypot(x - 0.04, y - 0.035).min() >= HOLE * (1 - 1e-6)


def test_images_are_clipped_to_the_plate(ring, plane, tmp_path):
    with figure(tmp_path / "field.png", (3, 3)) as fig:
        axes = fig.subplots()
        draw_field(axes, ring, plane, drawing_scale([plane], ring.plate.size))
        axes.set_axis_off()
    pixels = plt.imread(tmp_path / "field.png")[..., :3].min(axis=-1) < 0.97  # all that is not paper
    rows, columns = np.flatnonzero(pixels.any(axis=1)), np.flatnonzero(pixels.any(axis=0))
    drawn = pixels[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    assert drawn.mean() == pytest.approx(np.pi * (RADIUS**2 - HOLE**2) / (2 * RADIUS) ** 2, rel=0.03)


def test_exported_fields_are_empty_beyond_the_outline(ring, plane, tmp_path):
    write_vtkhdf(ring, np.array([0.0, 1.0]), {"displacement": np.stack([plane, plane])}, tmp_path / "ring.vtkhdf")
    with h5py.File(tmp_path / "ring.vtkhdf") as file:
        field, hidden = file["VTKHDF/PointData/displacement"][1], file["VTKHDF/PointData/vtkGhostType"][0]
    inside = outlined_nodes(ring, plane.shape).inside
    np.testing.assert_array_equal(np.isfinite(field), inside)
    np.testing.assert_array_equal(hidden == 0, inside)

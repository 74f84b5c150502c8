"""Scales and meshes of plates, as data."""

import itertools

import numpy as np
import pytest

from warp_plate.scene import Scene
from warp_plate.viz.fields import FIELDS, DrawingScale, drawing_scale
from warp_plate.viz.meshes import SCALARS, PlateMeshes

pytest.importorskip("pyvista", reason="PyVista is not installed: pip install 'warp-plate[viz]'")

PAPER = Scene.load("paper")


def meshes_of(field, scene=PAPER):
    return PlateMeshes(scene, field, drawing_scale([field], scene.plate.size))


def segments(mesh):
    """(segments, 2, 3) ends of the pieces of lines."""
    return mesh.points[mesh.lines.reshape(-1, 3)[:, 1:]].astype(float)


@pytest.mark.parametrize(
    ("name", "largest", "unit", "low", "high"),
    [
        ("displacement", 2.31e-13, "nm", -0.00024, 0.00024),
        ("displacement", 9.95e-7, "µm", -1, 1),
        ("displacement", -5e-3, "mm", -5, 5),
        ("displacement", 2e3, "m", -2000, 2000),
        ("energy", 4.2e-11, "pJ/m²", 0, 42),
        ("rms-velocity", 3.9e-4, "µm/s", 0, 390),
        ("phase", 1.0, "°", -180, 180),
    ],
)
def test_scales_have_a_short_limit_in_a_suitable_unit(name, largest, unit, low, high):
    values = [np.array([[0.0, largest / 50]]), np.array([[0.0, largest]])]
    scale = drawing_scale([1e-7 * array / abs(largest) for array in values], (0.2, 0.3), FIELDS[name], values)
    assert scale.unit == unit
    assert scale.clim == pytest.approx((low, high))
    # Heights are drawn up to 12 % of the shorter side.
    assert 0.1 * 0.2 < scale.warp_factor * 1e-7 <= 0.12 * 0.2 * 1.05


def test_plates_at_rest_and_plates_that_are_not_finite_can_be_drawn():
    assert drawing_scale([np.zeros((5, 5))], (0.2, 0.2)) == DrawingScale(1e-6, 1.0, "µm", 1e6)
    field = np.full((27, 27), 1.9e-7)
    field[3, 4], field[5, 6] = np.inf, np.nan
    assert drawing_scale([field], (0.2, 0.2)).limit == pytest.approx(1.9e-7)
    heights = meshes_of(field).surface.points[:, 2].reshape(27, 27)
    assert np.isfinite(heights).all()
    assert heights[3, 4] == heights[5, 6] == 0


def test_nodes_stand_at_the_warp_factor_times_their_displacement(random):
    field = random.normal(size=(9, 13)) * 1e-7
    surface, factor = meshes_of(field).surface, drawing_scale([field], PAPER.plate.size).warp_factor
    x, y = np.meshgrid(np.linspace(0, 0.2, 13), np.linspace(0, 0.2, 9))
    np.testing.assert_allclose(surface.points, np.column_stack([x.flat, y.flat, factor * field.ravel()]), atol=1e-7)
    np.testing.assert_allclose(surface.point_data[SCALARS], field.ravel() * 1e9, rtol=1e-12)
    # Two triangles per cell cover the plate once.
    assert surface.n_cells == 2 * 8 * 12
    surface.points[:, 2] = 0
    assert surface.area == pytest.approx(0.04)


def test_polylines_lie_on_the_warped_surface(random):
    from matplotlib.tri import LinearTriInterpolator, Triangulation

    meshes = meshes_of(random.normal(size=(11, 14)) * 1e-7)
    points = meshes.surface.points.astype(float)
    triangles = Triangulation(points[:, 0], points[:, 1], meshes.surface.faces.reshape(-1, 4)[:, 1:])
    height = LinearTriInterpolator(triangles, points[:, 2])
    assert np.abs(points[:, 2]).max() > 0.01
    for lines in meshes.lines.values():
        on_line = np.concatenate([np.linspace(*ends, 7)[1:-1] for ends in segments(lines.mesh)])
        # Rounding may put points on the edge outside of all triangles.
        inside = np.clip(on_line[:, :2], 1e-7, 0.2 - 1e-7)
        np.testing.assert_allclose(on_line[:, 2], height(*inside.T).filled(np.nan), atol=2e-6)


def test_lines_follow_target_actuators_and_edges(scene):
    mixed = scene(edges=("clamped", "free", {"translation": 1e6, "rotation": 1.0}, "supported"))
    drawn = meshes_of(np.zeros((9, 11)), mixed).lines
    places = {"clamped": (0, 0), "supported": (1, 0.2), "springs": (0, 0.2), "free": (1, 0)}
    for kind, (axis, position) in places.items():
        points = drawn[kind].mesh.points
        np.testing.assert_allclose(points[:, axis], position, atol=1e-7)
        assert np.ptp(points[:, 1 - axis]) == pytest.approx(0.2)
    for name, areas in (("target", [mixed.target.area]), ("actuators", [part.area for part in mixed.actuators])):
        length = np.hypot(*np.diff(segments(drawn[name].mesh), axis=1)[:, 0, :2].T).sum()
        assert length == pytest.approx(sum(2 * (x1 - x0 + y1 - y0) for x0, x1, y0, y1 in areas), rel=1e-5)
        for corner in itertools.chain(*(itertools.product(area[:2], area[2:]) for area in areas)):
            assert np.hypot(*(drawn[name].mesh.points[:, :2] - corner).T).min() < 1e-7

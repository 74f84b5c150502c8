"""Scales and meshes of plates, as data."""

import itertools

import numpy as np
import pytest

from warp_plate.scene import Scene
from warp_plate.viz.captions import caption
from warp_plate.viz.edge_styles import EDGE_STYLES, edges_by_kind
from warp_plate.viz.fields import FIELDS, DrawingScale, drawing_scale
from warp_plate.viz.meshes import SCALARS, plate_meshes

pytest.importorskip("pyvista", reason="PyVista is not installed: pip install 'warp-plate[viz]'")


@pytest.fixture
def paper():
    return Scene.load("paper")


def segments(lines):
    """(segments, 2, 3) ends of all straight pieces of a mesh of polylines."""
    pieces, at = [], 0
    while at < len(lines.lines):
        pieces += itertools.pairwise(lines.points[lines.lines[at + 1 : at + 1 + lines.lines[at]]].astype(float))
        at += 1 + lines.lines[at]
    return np.array(pieces)


# Scales -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("largest", "unit", "end"),
    [
        (2.31e-13, "nm", 0.00024),
        (2.27e-7, "nm", 230),
        (9.95e-7, "µm", 1),
        (-3.2e-4, "µm", 320),
        (5e-3, "mm", 5),
        (2e3, "m", 2000),
    ],
)
def test_displacement_scales_are_symmetric_with_a_short_limit(largest, unit, end):
    scale = drawing_scale([np.array([[0.0, largest / 50]]), np.array([[0.0, largest]])], (0.2, 0.3))
    assert scale.unit == unit
    assert scale.clim == pytest.approx((-end, end))
    assert scale.limit * scale.unit_factor == pytest.approx(end)
    # Heights are drawn up to 12 % of the shorter side.
    assert 0.1 * 0.2 < scale.warp_factor * abs(largest) <= 0.12 * 0.2 * 1.05


def test_units_of_other_fields():
    energy, speed = FIELDS["energy"], FIELDS["rms-velocity"]
    field = [np.array([1e-7])]
    assert drawing_scale(field, (1, 1), energy, [np.array([4.2e-11])]).unit == "pJ/m²"
    assert drawing_scale(field, (1, 1), energy, [np.array([4.2e-8])]).title == "kinetic energy\ndensity\n[nJ/m²]"
    assert drawing_scale(field, (1, 1), speed, [np.array([3.9e-4])]).clim == (0.0, pytest.approx(390))
    assert drawing_scale(field, (1, 1), speed, [np.array([5.0])]).unit == "m/s"
    assert drawing_scale(field, (1, 1), FIELDS["phase"]).clim == (-180.0, 180.0)


def test_plates_at_rest_and_plates_that_are_not_finite_can_be_drawn(paper):
    assert drawing_scale([np.zeros((5, 5))], (0.2, 0.2)) == DrawingScale(1e-6, 1.0, "µm", 1e6)
    field = np.full((27, 27), 1.9e-7)
    field[3, 4], field[5, 6] = np.inf, np.nan
    scale = drawing_scale([field], (0.2, 0.2))
    assert scale.limit == pytest.approx(1.9e-7)
    heights = plate_meshes(paper, field, scale).surface.points[:, 2].reshape(27, 27)
    assert np.isfinite(heights).all()
    assert heights[3, 4] == heights[5, 6] == 0


def test_captions():
    assert caption("equal drive", 0.0464, 0.25) == "equal drive, t = 0.0464 s\nlocalization factor 25.00 %"
    assert caption("drive", 0.0464, 0.25, decimals=2).startswith("drive, t = 0.05 s")
    assert "not defined" in caption("given drive", 0.0464, float("nan"))


# Meshes -----------------------------------------------------------------------------------------------------


def test_nodes_stand_at_the_warp_factor_times_their_displacement(paper, random):
    field = random.normal(size=(9, 13)) * 1e-7
    scale = drawing_scale([field], paper.plate.size)
    surface = plate_meshes(paper, field, scale).surface
    x, y = np.meshgrid(np.linspace(0, 0.2, 13), np.linspace(0, 0.2, 9))
    expected = np.column_stack([x.ravel(), y.ravel(), scale.warp_factor * field.ravel()])
    np.testing.assert_allclose(surface.points, expected, atol=1e-7)
    np.testing.assert_allclose(surface.point_data[SCALARS], field.ravel() * 1e9, rtol=1e-12)
    # Two triangles per cell cover the plate once.
    assert surface.n_cells == 2 * 8 * 12
    flat = surface.copy()
    flat.points[:, 2] = 0
    assert flat.area == pytest.approx(0.04)


def test_polylines_lie_on_the_warped_surface(paper, random):
    from matplotlib.tri import LinearTriInterpolator, Triangulation

    field = random.normal(size=(11, 14)) * 1e-7
    meshes = plate_meshes(paper, field, drawing_scale([field], paper.plate.size))
    points = meshes.surface.points.astype(float)
    triangles = Triangulation(points[:, 0], points[:, 1], meshes.surface.faces.reshape(-1, 4)[:, 1:])
    height = LinearTriInterpolator(triangles, points[:, 2])
    assert np.abs(points[:, 2]).max() > 0.01
    for lines in meshes.polylines:
        on_line = np.concatenate([np.linspace(*ends, 7)[1:-1] for ends in segments(lines.mesh)])
        # Rounding may put points on the edge outside of all triangles.
        inside = np.clip(on_line[:, :2], 1e-7, 0.2 - 1e-7)
        np.testing.assert_allclose(on_line[:, 2], height(*inside.T).filled(np.nan), atol=2e-6)


def test_outlines_follow_edges_target_and_actuators(paper):
    field = np.zeros((27, 27))
    meshes = plate_meshes(paper, field, drawing_scale([field], paper.plate.size))
    drawn = {"clamped": meshes.edges["clamped"], "target": meshes.target, "actuators": meshes.actuators}
    lengths = {
        name: np.hypot(*np.diff(segments(lines.mesh), axis=1)[:, 0, :2].T).sum() for name, lines in drawn.items()
    }
    assert lengths == pytest.approx({"clamped": 0.8, "target": 0.4, "actuators": 4 * 4 * 0.012}, rel=1e-5)
    for x0, x1, y0, y1 in (actuator.area for actuator in paper.actuators):
        for corner in ((x0, y0), (x0, y1), (x1, y0), (x1, y1)):
            assert np.hypot(*(meshes.actuators.mesh.points[:, :2] - corner).T).min() < 1e-7


def test_edges_are_drawn_by_their_support(scene):
    supports = ("clamped", "free", {"translation": 1e6, "rotation": 1.0}, "supported")
    mixed = scene(edges=supports)
    assert edges_by_kind(mixed) == {"clamped": ["left"], "supported": ["top"], "springs": ["right"], "free": ["bottom"]}
    field = np.zeros((9, 11))
    edges = plate_meshes(mixed, field, drawing_scale([field], mixed.plate.size)).edges
    places = {"clamped": (0, 0), "supported": (1, 0.2), "springs": (0, 0.2), "free": (1, 0)}
    for kind, (axis, position) in places.items():
        points = edges[kind].mesh.points
        np.testing.assert_allclose(points[:, axis], position, atol=1e-7)
        along = points[:, 1 - axis]
        assert (along.min(), along.max()) == (pytest.approx(0, abs=1e-7), pytest.approx(0.2, abs=1e-6))
        # Dashes are lines of their own with gaps in between.
        drawn = sum(np.ptp(along[cell.point_ids]) for cell in edges[kind].mesh.cell)
        dashes = EDGE_STYLES[kind].dashes
        assert drawn / 0.2 == pytest.approx(1.0 if dashes is None else dashes[0] / sum(dashes), abs=0.03)

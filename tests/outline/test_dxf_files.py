"""Written DXF files: read back by ezdxf, loops have their layers, areas and boxes in millimetres."""

import io
import math

import ezdxf
import numpy as np
import pytest
from ezdxf.path import make_path

from warp_plate.outline.dxf_files import dxf_of
from warp_plate.outline.outline import Outline, bounds
from warp_plate.outline.pieces import Arc
from warp_plate.scene.target import PlateRegion

SHAPES = {
    "rectangle": {"area": (0.01, 0.03, 0.02, 0.05)},
    "disc": {"disc": (0.05, 0.04, 0.02)},
    "rounded": {"rectangle": (0.06, 0.03), "angle": 0.4, "corner_radius": 0.008, "centre": (0.05, 0.05)},
    "ellipse": {"ellipse": (0.05, 0.04, 0.01, 0.02, 0.3)},
    "polygon": {"polygon": ((0.01, 0.0), (0.08, 0.02), (0.03, 0.07))},
}


def corners_of(entity):
    """Return the (corners, 2) x, y [mm] of an entity by ezdxf's own paths."""
    return np.array([tuple(point)[:2] for point in make_path(entity).flattening(1e-4)])


def area_of(corners):
    x, y = corners.T
    return abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def test_loops_are_those_that_ezdxf_reads():
    loops = {name: PlateRegion(**shape).loop() for name, shape in SHAPES.items()}
    data = dxf_of({name: [loop] for name, loop in loops.items()})
    assert data == dxf_of({name: [loop] for name, loop in loops.items()})
    document = ezdxf.read(io.StringIO(data.decode()))
    assert document.units == ezdxf.units.MM
    assert not document.audit().errors
    entities = {entity.dxf.layer: entity for entity in document.modelspace()}
    assert entities.keys() == loops.keys()
    assert entities["disc"].dxftype() == "CIRCLE"
    for name, loop in loops.items():
        corners = corners_of(entities[name])
        assert area_of(corners) == pytest.approx(1e6 * Outline((tuple(loop),)).area, rel=5e-4)  # of curves by Bézier
        x0, x1, y0, y1 = bounds(loop)
        box = corners[:, 0].min(), corners[:, 0].max(), corners[:, 1].min(), corners[:, 1].max()
        assert box == pytest.approx(np.array([x0, x1, y0, y1]) * 1e3, abs=2e-2)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("angles", [(0.3, 2.0), (2.5, -1.5)])
def test_arcs_of_ellipses_keep_their_ends(mirrored, angles, random):
    turn = random.uniform(0, 2 * math.pi)
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    axes = rotation @ np.diag([0.02, -0.05 if mirrored else 0.05])
    arc = Arc(None, "", "", np.array([0.1, 0.2]), axes, angles)
    document = ezdxf.read(io.StringIO(dxf_of({"arc": [[arc]]}).decode()))
    (entity,) = document.modelspace()
    corners, points = corners_of(entity), 1e3 * arc.points(np.linspace(0, 1, 400))
    assert entity.dxftype() == "ELLIPSE"
    apart = np.linalg.norm(corners[:, None] - points, axis=2)
    assert max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 3.0  # in mm: both cover the same part of the curve
    ends = {tuple(point) for point in np.round(corners[[0, -1]], 6)}
    assert ends == {tuple(point) for point in np.round(points[[0, -1]], 6)}


def test_polygons_are_closed():
    polygon = np.array([[0.0, 0.0], [0.01, 0.0], [0.0, 0.02]])
    (entity,) = ezdxf.read(io.StringIO(dxf_of({"thickness 0.5 mm": [polygon]}).decode())).modelspace()
    assert entity.is_closed
    assert [tuple(row) for row in entity.get_points("xy")] == [(0.0, 0.0), (10.0, 0.0), (0.0, 20.0)]

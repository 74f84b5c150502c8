"""Regression images; other files test what is drawn as data.

After an intended change: pytest tests/viz/test_pictures.py -n 0 --reset_image_cache, and look at tests/pictures.
"""

import math

import numpy as np
import pytest

from warp_plate.result.motion import Motion
from warp_plate.viz.pictures import make_plotter
from warp_plate.viz.scene3d import SideBySide, plate_subplots

pytest.importorskip("pytest_pyvista", reason="pytest-pyvista is not installed: pip install 'warp-plate[test]'")

# Width of a plate, height of the picture, and font size [pixels].
WIDTH, HEIGHT, FONT_SIZE = 200, 180, 8
EDGES = ("clamped", "free", {"translation": 1e6, "rotation": 1.0}, "supported")
# Error of pytest-pyvista: below 1 for the same picture on the same machine, about 130 without actuators, 400 with
# another colour map, 700 without texts.
TOLERANCE = 120.0


def travelling_wave(name, size, mode=False):
    """A wave along x on 21 × 21 nodes."""
    x, y = np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 1, 21))
    turn = 2 * math.pi * (np.arange(8)[:, None, None] / 8 - 1.5 * x)
    hill = size * 16 * x * (1 - x) * y * (1 - y)
    times = np.arange(8) / 8 / 200
    mass, share = np.full(x.shape, 0.5), None if mode else 0.3
    return Motion(name, 200.0, (0.0, 0.005), times, np.cos(turn) * hill, -1257 * np.sin(turn) * hill, mass, share)


DRIVES = [travelling_wave("single", 1e-7), travelling_wave("best", 2e-7)]


@pytest.mark.parametrize(
    ("motions", "quantity", "supports"),
    [
        *((DRIVES, quantity, EDGES[:1] * 4) for quantity in ("displacement", "energy", "rms-velocity", "phase")),
        (DRIVES[1:], "displacement", EDGES),
        ([travelling_wave("mode 1, 200 Hz", 1.0, mode=True)], "displacement", EDGES[:1] * 4),
    ],
    ids=["displacement", "energy", "rms-velocity", "phase", "edges", "mode"],
)
def test_picture(drawing, scene, verify_image_cache, motions, quantity, supports):
    verify_image_cache.error_value = verify_image_cache.warning_value = TOLERANCE
    columns = plate_subplots(len(motions), WIDTH, FONT_SIZE)
    plotter = make_plotter((sum(columns["col_weights"]), HEIGHT), off_screen=True, **columns)
    SideBySide(plotter, scene(edges=supports), motions, quantity, FONT_SIZE).show(1)
    plotter.show()

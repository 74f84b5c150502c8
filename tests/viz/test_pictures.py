"""Pictures as they were when somebody looked at them: smoke tests. What is drawn, as data, is in other files.

After a change that is wanted: pytest tests/viz/test_pictures.py -n 0 --reset_image_cache, and look at tests/pictures.
"""

import math

import numpy as np
import pytest

from warp_plate import viz
from warp_plate.result.motion import Motion
from warp_plate.viz.availability import off_screen
from warp_plate.viz.comparison import Comparison, layout
from warp_plate.viz.pictures import make_plotter

pytest.importorskip("pytest_pyvista", reason="pytest-pyvista is not installed: pip install 'warp-plate[test]'")

# Two plates of this width, and the height of the picture [pixels].
WIDTH, HEIGHT, FONT_SIZE = 200, 180, 8
EDGES = ("clamped", "free", {"translation": 1e6, "rotation": 1.0}, "supported")
# pytest-pyvista's measure of difference. The same picture on the same machine differs by less than 1; one without
# actuators by some 130, with another colour map by 400, without its texts by 700.
WRONG = 120.0


def waves(name, size, mode=False):
    """A wave that runs along x, on 21 × 21 nodes."""
    x, y = np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 1, 21))
    turn = 2 * math.pi * (np.arange(8)[:, None, None] / 8 - 1.5 * x)
    hill = size * 16 * x * (1 - x) * y * (1 - y)
    times = np.arange(8) / 8 / 200
    mass, share = np.full(x.shape, 0.5), None if mode else 0.3
    return Motion(name, 200.0, (0.0, 0.005), times, np.cos(turn) * hill, -1257 * np.sin(turn) * hill, mass, share)


@pytest.fixture
def drawn(scene, verify_image_cache):
    """Draws motions, and compares the picture with the one that is kept."""
    if (problem := viz.missing()) is not None:
        verify_image_cache.skip = True
        pytest.skip(problem)
    verify_image_cache.error_value = verify_image_cache.warning_value = WRONG

    def draw(motions, quantity="displacement", frame=1, **options):
        with off_screen():
            columns = layout(len(motions), WIDTH, FONT_SIZE)
            plotter = make_plotter((sum(columns["col_weights"]), HEIGHT), off_screen=True, **columns)
            Comparison(plotter, scene(**options), motions, quantity, FONT_SIZE).show(frame)
            plotter.show()

    return draw


@pytest.mark.parametrize("quantity", ["displacement", "energy", "rms-velocity", "phase"])
def test_two_drives(drawn, quantity):
    drawn([waves("single", 1e-7), waves("best", 2e-7)], quantity)


def test_sides_of_every_kind(drawn):
    drawn([waves("best", 2e-7)], edges=EDGES)


def test_a_natural_shape(drawn):
    drawn([waves("mode 1, 200 Hz", 1.0, mode=True)])

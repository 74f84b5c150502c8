"""Pictures of plates on supports."""

import numpy as np

from support.scenes import scene_of
from warp_plate.viz.outlined import continued
from warp_plate.viz.plots.modes import refined


def test_a_rectangle_on_supports_is_drawn_as_one_without():
    plain = scene_of(size=(0.2, 0.2))
    held = scene_of(size=(0.2, 0.2), supports=[{"line": ((0.0, 0.0), (0.2, 0.2))}])
    shape = np.random.default_rng(1).normal(size=(31, 31))
    np.testing.assert_array_equal(continued(held, shape), shape)
    np.testing.assert_array_equal(refined(held, shape)[2], refined(plain, shape)[2])

"""Plates that move as pistons."""

import numpy as np


def rigid_motion(plate, points):
    """Return the amplitudes (modes,) of the rigid motion u = 1 of a free plate, from some of its points."""
    rigid, amplitudes = plate.frequencies == 0, np.zeros(len(plate.frequencies))
    amplitudes[rigid] = np.linalg.lstsq(plate.at_points(points)[rigid].T, np.ones(len(points)), rcond=None)[0]
    return amplitudes

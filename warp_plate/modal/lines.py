"""Lines across which the section of a plate or its load is not smooth, and the degree of splines that follow them.

Where the rigidity jumps, at the edges of layers, only the slope is continuous; where it has a kink, at the columns of a
map of thickness, the curvature; and where the load jumps, at the edges of an oscillator's patch, the third derivative.
"""

from __future__ import annotations

import numpy as np

from warp_plate.plate.section import factor_arrays
from warp_plate.scene.model import Scene

# Degree of the splines, of those of a section with jumps or up to FEW_KINKS kinks along a side, and with more: each
# repeats knots, fewer of a low degree.
DEGREE, DEGREE_OF_JUMPS, DEGREE_OF_KINKS, FEW_KINKS = 7, 5, 4, 10
# Up to so many oscillators, splines near the edges of their patches, across which the load jumps.
MOST_PATCHES = 8
# The curvature alone is continuous across a line of a map where the slope of a factor changes by more than KINK times
# its value over the columns' distance, if there are no more than MOST_KINKS of them along either side.
KINK, MOST_KINKS = 0.01, 36


def lines(scene: Scene, axis: int, degree: int = DEGREE) -> list[tuple[float, int]]:
    """Return where section or load are not smooth along x (0) or y (1) [m], and the derivatives of splines there."""
    found = []
    if len(scene.effects.oscillators) <= MOST_PATCHES:
        for oscillator in scene.effects.oscillators:
            found += [(position, degree - 2) for position in oscillator.area[2 * axis : 2 * axis + 2]]
    for layer in scene.effects.layers:
        found += [(position, 1) for position in layer.area[2 * axis : 2 * axis + 2]]
    kinks = _kinks(scene)
    followed = _most(kinks) <= MOST_KINKS
    return found + [(place, 2 if sharp and followed else degree) for place, sharp in kinks[axis].items()]


def _kinks(scene: Scene) -> tuple[dict[float, bool], dict[float, bool]]:
    """Return the inner lines of the scene's maps along x and along y [m], and whether each is a kink that counts."""
    kinks: tuple[dict[float, bool], dict[float, bool]] = {}, {}
    for array in factor_arrays(scene).values():
        for axis, rows in enumerate((array.T, array)):
            sharp: np.ndarray = np.any(np.abs(np.diff(rows, 2, axis=0)) > KINK * rows[1:-1], axis=1)
            for index, counts in enumerate(sharp.tolist(), 1):
                place = scene.plate.size[axis] * index / (len(rows) - 1)
                kinks[axis][place] = kinks[axis].get(place, False) or counts
    return kinks


def _most(kinks: tuple[dict[float, bool], dict[float, bool]]) -> int:
    """Return the number of kinks along the side that has more of them."""
    return max(sum(sharp.values()) for sharp in kinks)


def spline_degree(scene: Scene) -> int:
    """Return the degree of a scene's splines."""
    most = _most(_kinks(scene))
    if scene.effects.layers or 0 < most <= FEW_KINKS or most > MOST_KINKS:
        return DEGREE_OF_JUMPS
    return DEGREE_OF_KINKS if most else DEGREE

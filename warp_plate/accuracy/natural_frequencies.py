"""Natural frequencies of the plate as the differences have it."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from warp_plate.plate import modes, operator
from warp_plate.plate.scheme import make_scheme
from warp_plate.scene.model import Scene


def biharmonic(scene: Scene) -> scipy.sparse.csc_array:
    """Square sparse matrix of ∇⁴ [1/m⁴] of a plain plate on the nodes that move, row by row; symmetric.

    Raises:
        SceneError: see ``make_scheme``.
    """
    scheme = make_scheme(scene)
    return operator.biharmonic(scheme.taps_x, scheme.taps_y, scheme.spacing, scheme.order)


def natural_frequencies(scene: Scene, count: int) -> np.ndarray:
    """(count,) first natural frequencies [Hz] of the scene's grid, continuous in time.

    Raises:
        SceneError: see ``make_scheme``.
    """
    return modes.natural_modes(scene, count).frequencies

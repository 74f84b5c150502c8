"""A second solution for modes, with which errors are estimated."""

import math
from dataclasses import replace

from warp_plate.modal.modes import ModalPlate, solve_modes


def coarser_modes(plate: ModalPlate, density: float) -> ModalPlate:
    """Return the modes of a plate by fewer functions along each side, by a factor ``density`` below 1.

    Where the highest modes of many functions are left out, it has fewer modes too: else its responses would lack the
    same part, and not show how large it is.
    """
    scene, modes = plate.scene, len(plate.frequencies)
    coarser = solve_modes(scene, plate.highest / scene.grid.modal_density, density=density)
    if 2 * modes >= plate.space.unknowns:
        return coarser
    some = slice(math.ceil(density**2 * modes))
    return replace(
        coarser,
        frequencies=coarser.frequencies[some],
        vectors=coarser.vectors[:, some],
        damping=coarser.damping[some, some],
        hysteretic=coarser.hysteretic[some, some],
    )

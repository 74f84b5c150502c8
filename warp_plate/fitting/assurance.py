"""Modal assurance criterion between measured and computed shapes (Allemang, Brown, Proc. 1st IMAC, 1982)."""

from __future__ import annotations

import numpy as np

from warp_plate.fitting.measured_modes import MeasuredModes
from warp_plate.modal.continuous_modes import linear_part
from warp_plate.modal.modes import solve_modes
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

RIGID = 3  # modes of a free plate that are rigid motions


def assurance(scene: Scene, measured: MeasuredModes, numbers: np.ndarray) -> np.ndarray | None:
    """Return (n, n) MAC of measured shapes and of those of the scene's modes with these numbers, from 1; None without.

    Raises:
        SceneError: A point of the shapes is off the plate.
    """
    if measured.shapes is None or measured.points is None:
        return None
    check_points(scene, measured)
    plate = solve_modes(linear_part(scene), highest=0.0, count=int(numbers.max()) + RIGID)
    moving = np.flatnonzero(plate.frequencies > 0)[numbers - 1]
    return modal_assurance(measured.shapes, plate.at_points(measured.points)[moving])


def modal_assurance(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return (m, n) |a·b*|² / (a·a* b·b*) of shapes (m, points) and (n, points); 0 for a shape that does not move."""
    products = np.abs(first @ second.conj().T) ** 2
    sizes = np.outer(np.sum(np.abs(first) ** 2, axis=1), np.sum(np.abs(second) ** 2, axis=1))
    return np.divide(products, sizes, out=np.zeros_like(sizes), where=sizes > 0)


def check_points(scene: Scene, measured: MeasuredModes) -> None:
    """Raise a SceneError if a point of the shapes is off the plate."""
    if measured.points is not None and np.any((measured.points < 0) | (measured.points > scene.plate.size)):
        raise SceneError(f"{measured.source}: a point of the shapes is off the plate of {list(scene.plate.size)} m")

"""Natural frequencies, damping and shapes of the plate itself, without a grid; see :mod:`warp_plate.plate.modes`."""

from __future__ import annotations

import math

import numpy as np

from warp_plate.modal.modes import ModalPlate, solve_modes
from warp_plate.plate.modes import NaturalModes, normalised_shapes, separated
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene, SceneSource

# Points along the longer and least along the shorter side at which shapes are returned.
LONGER, SHORTER = 121, 31
# Functions along each side of the modes that frequencies are compared with, relative to the others. The error of a
# frequency is FACTOR times the largest change of it and of lower ones, and at least LEAST. Where rigidity jumps, it
# falls as the first power of the spacing, so that it is 3.5 times the change.
FINER, FACTOR, LEAST = 1.4, 4.0, 1e-6
# Further modes that are solved for, so that no group of equal frequencies is cut.
SPARE = 4
MOST_MODES = 500


def modes(scene: SceneSource, count: int | None = None, highest: float | None = None) -> ModalPlate:
    """Return the lowest modes of a linear scene, with their frequencies, damping and shapes.

    Args:
        scene: Scene; its grid, time steps and drive are not used.
        count: Number of modes (default: all that responses up to ``highest`` need, which are many more).
        highest: Frequency up to which responses are accurate [Hz] (default: the highest of the scene's drive).

    Raises:
        SceneError: ``count`` is below 1, ``highest`` is no frequency, or see :func:`solve_modes`.
    """
    if highest is not None and not 0 < highest < math.inf:
        raise SceneError(f"highest = {highest:g}: must be a frequency above 0 (hertz)")
    if count is None:
        return solve_modes(scene, highest)
    if count < 1:
        raise SceneError(f"count = {count}: must be at least 1")
    return solve_modes(scene, 0.0 if highest is None else highest, count).part(np.arange(count))


def continuous_modes(scene: Scene, count: int, nodes: tuple[int, int] | None = None) -> NaturalModes:
    """Return the first ``count`` undamped modes of a scene's linear part, and their loss factors; grid and drive are
    not used.

    Modes of one frequency are turned as those of the grid are. ``nodes`` (nx, ny) from edge to edge are the points at
    which the shapes are returned (default: as fine as a picture).

    Raises:
        SceneError: count is below 1 or above MOST_MODES, the plate buckles, or a file of the scene cannot be read.
    """
    if not 1 <= count <= MOST_MODES:
        raise SceneError(f"count = {count}: must be from 1 to {MOST_MODES} modes")
    plate = solve_modes(linear_part(scene), highest=0.0, count=count + SPARE)
    plate = plate.part(np.arange(count + SPARE))
    nearly_square = [max(SHORTER, 1 + round((LONGER - 1) * side / max(scene.plate.size))) for side in scene.plate.size]
    nx, ny = nodes or nearly_square
    x, y = np.linspace(-1, 1, nx), np.linspace(-1, 1, ny)
    (width, height), masses = scene.plate.size, plate.attached_motions
    shapes = plate.shapes((1 + x) / 2 * width, (1 + y) / 2 * height).reshape(len(masses), -1)
    weight = np.append((x**2 + (y**2)[:, None] / 2).ravel(), np.zeros(masses.shape[1]))
    vectors = separated(plate.angular_frequencies**2, np.hstack([shapes, masses]).T, weight)
    fields, motions = normalised_shapes(scene, vectors[:, :count], np.ones((ny, nx), dtype=bool))
    return NaturalModes(plate.frequencies[:count], fields, motions, loss_factors=plate.loss_factors[:count])


def errors_of_frequencies(scene: Scene, frequencies: np.ndarray) -> np.ndarray:
    """Return (count,) relative errors of the lowest frequencies [Hz] of :func:`continuous_modes`.

    They come from a second solution with more functions: 0 for rigid motions, NaN if these functions are too many.
    """
    try:
        finer = solve_modes(linear_part(scene), highest=0.0, count=frequencies.size + SPARE, density=FINER)
    except SceneError:
        return np.full(frequencies.shape, math.nan)
    reference = finer.frequencies[: frequencies.size]
    moving = (frequencies > 0) & (reference > 0)
    changes = np.abs(np.divide(reference, frequencies, out=np.ones_like(frequencies), where=moving) - 1)
    return np.where(frequencies > 0, FACTOR * np.maximum.accumulate(changes) + LEAST, 0.0)


def linear_part(scene: Scene) -> Scene:
    """Return the scene for small motion: without effects and forces that are not linear, and with masses that only a
    damper holds at rest."""
    drive = scene.drive.model_copy(update={"electrostatic": None})
    return scene.model_copy(update={"effects": scene.effects.linearized(), "drive": drive})

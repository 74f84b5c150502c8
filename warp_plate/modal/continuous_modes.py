"""Natural frequencies, damping and shapes of the plate itself, without a grid."""

import math
from dataclasses import dataclass

import numpy as np

from warp_plate.effects.effect import attachments
from warp_plate.modal.modes import UNCUT, ModalPlate, solve_modes
from warp_plate.scene.errors import SceneError, check_whole
from warp_plate.scene.model import Scene, SceneSource

# Points along the longer and least along the shorter side at which shapes are returned.
LONGER, SHORTER = 121, 31
MOST_MODES = 500
# Frequencies of a relative difference below this are equal.
SAME = 1e-7
# Half-waves are counted in shapes whose share PRODUCT is a product X(x)·Y(y), where they exceed ABOVE of their peak.
PRODUCT, ABOVE = 0.8, 0.03


@dataclass(frozen=True, eq=False)
class NaturalModes:
    """The lowest modes of a scene's plate, by rising frequency."""

    frequencies: np.ndarray  # (count,) [Hz], 0 for rigid motions
    shapes: np.ndarray  # (count, ny, nx) displacements, edges included, the largest being 1
    # (count, oscillators) motion of the oscillators' masses in the same unit; NaN without a mass
    oscillators: np.ndarray
    loss_factors: np.ndarray  # (count,) twice the damping ratios

    def half_waves(self) -> list[tuple[int, int] | None]:
        """Return the numbers of lobes of each shape along x and y, one more than the nodal lines across them; None if
        nodal lines run askew. Between clamped or supported edges they are half-waves."""
        return [_half_waves(shape) for shape in self.shapes]


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
    check_whole("count", count)
    return solve_modes(scene, 0.0 if highest is None else highest, count).part(np.arange(count))


def continuous_modes(scene: Scene, count: int, nodes: tuple[int, int] | None = None) -> NaturalModes:
    """Return the first ``count`` undamped modes of a scene's linear part, and their loss factors; grid and drive are
    not used.

    Modes of one frequency are turned so that a weight of x² + y²/2 about the middle does not couple them: sides stay
    recognizable and every machine gives the same. The peak of a shape is positive. ``nodes`` (nx, ny) from edge to edge
    are the points at which the shapes are returned (default: as fine as a picture).

    Raises:
        SceneError: count is below 1 or above MOST_MODES, the plate buckles, or a file of the scene cannot be read.
    """
    if not 1 <= count <= MOST_MODES:
        raise SceneError(f"count = {count}: must be from 1 to {MOST_MODES} modes")
    plate = solve_modes(linear_part(scene), highest=0.0, count=count + UNCUT)
    plate = plate.part(np.arange(count + UNCUT))
    nearly_square = [max(SHORTER, 1 + round((LONGER - 1) * side / max(scene.plate.size))) for side in scene.plate.size]
    nx, ny = nodes or nearly_square
    x, y = np.linspace(-1, 1, nx), np.linspace(-1, 1, ny)
    (width, height), masses = scene.plate.size, plate.attached_motions
    shapes = plate.shapes((1 + x) / 2 * width, (1 + y) / 2 * height).reshape(len(masses), -1)
    weight = np.append((x**2 + (y**2)[:, None] / 2).ravel(), np.zeros(masses.shape[1]))
    vectors = separated(plate.angular_frequencies**2, np.hstack([shapes, masses]).T, weight)
    fields, motions = normalised_shapes(scene, vectors[:, :count], np.ones((ny, nx), dtype=bool))
    return NaturalModes(plate.frequencies[:count], fields, motions, plate.loss_factors[:count])


def linear_part(scene: Scene) -> Scene:
    """Return the scene for small motion: without effects and forces that are not linear, and with masses that only a
    damper holds at rest."""
    drive = scene.drive.model_copy(update={"electrostatic": None})
    return scene.model_copy(update={"effects": scene.effects.linearized(), "drive": drive})


def separated(squares: np.ndarray, vectors: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the vectors, those of one frequency turned among each other so that the weight does not couple them."""
    groups = np.split(vectors, 1 + np.flatnonzero(squares[1:] > squares[:-1] * (1 + 2 * SAME)), axis=1)
    return np.hstack([
        group if group.shape[1] == 1 else group @ np.linalg.eigh(group.T @ (weight[:, None] * group))[1]
        for group in groups
    ])  # fmt: skip


def normalised_shapes(scene: Scene, vectors: np.ndarray, moving: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return shapes (modes, ny, nx) and motions of attached masses (modes, attachments), the largest displacement 1, of
    vectors (unknowns, modes) over the moving nodes (ny, nx), then over the masses on springs."""
    nodes, count = np.count_nonzero(moving), vectors.shape[1]
    shapes = np.zeros((count, *moving.shape))
    shapes[:, moving] = vectors[:nodes].T
    attached = attachments(scene.terms)
    motions = np.tile([0.0 if attachment.mass > 0 else math.nan for attachment in attached], (count, 1))
    swinging = [attachment.mass > 0 and attachment.stiffness > 0 for attachment in attached]
    motions[:, swinging] = vectors[nodes:].T
    for shape, motion in zip(shapes, motions, strict=True):
        peak = _peak(shape)
        # A mass on a patch at rest oscillates by itself.
        if abs(peak) < 1e-9 * np.nanmax(np.abs(motion), initial=0):
            peak = _peak(motion[swinging])
        shape /= peak
        motion /= peak
    return shapes, motions


def _peak(values: np.ndarray) -> float:
    """Return the value of the largest magnitude; of several equal up to rounding, the first."""
    sizes = np.abs(values)
    return float(values.flat[np.argmax(sizes >= (1 - 1e-6) * sizes.max())])


def _half_waves(shape: np.ndarray) -> tuple[int, int] | None:
    along_y, sizes, along_x = np.linalg.svd(shape, full_matrices=False)
    if sizes[0] ** 2 < PRODUCT * (sizes**2).sum() or sizes[0] == 0:
        return None
    lines = (line[np.abs(line) > ABOVE * np.abs(line).max()] for line in (along_x[0], along_y[:, 0]))
    count_x, count_y = (1 + int(np.count_nonzero(np.diff(np.sign(line)))) for line in lines)
    return count_x, count_y

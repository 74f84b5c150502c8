"""Figures of merit of a focus: its area, and its contrast to the rest of the plate."""

from __future__ import annotations

import math

import numpy as np
import scipy

from warp_plate.modal.modes import ModalPlate

# Cells of the raster between two lines of the plate's splines, which follow its shortest waves; a picture takes the
# middle of each square of PICTURED² of them.
CELLS, PICTURED = 6, 3
HALF = 0.5  # −6 dB


def field_at_end(plate: ModalPlate, amplitudes: np.ndarray) -> np.ndarray:
    """Return the (ny, nx) field of amplitudes (modes,) in the middles of equal cells."""
    rows, columns = plate.space.shape
    x, y = (
        side * (np.arange(CELLS * count) + 0.5) / (CELLS * count)
        for side, count in zip(plate.scene.plate.size, (columns, rows), strict=True)
    )
    return plate.displacement(amplitudes, x, y)


def measure_focus(
    field: np.ndarray, size: tuple[float, float], point: tuple[float, float], peak: float
) -> tuple[float, float]:
    """Return the area of the focus [m²], and its contrast [dB].

    The focus is the part of the plate around the point that moves at least half as far as the point does; its contrast
    is that of the point's motion to the root mean square over the rest of the plate.

    Args:
        field: (ny, nx) field in the middles of equal cells.
        size: Sides of the plate [m].
        point: The focus x, y [m].
        peak: Motion of the point.
    """
    cell = [
        min(int(at / side * count), count - 1) for at, side, count in zip(point, size, field.shape[::-1], strict=True)
    ]
    inside = np.abs(field) >= HALF * abs(peak)
    inside[cell[1], cell[0]] = True  # the point itself, which the middle of its cell may just miss
    parts, _ = scipy.ndimage.label(inside)
    focus = parts == parts[cell[1], cell[0]]
    rest = math.sqrt(float(np.mean(field[~focus] ** 2))) if not focus.all() else 0.0
    contrast = 20 * math.log10(abs(peak) / rest) if peak and rest else math.nan
    return float(focus.mean()) * math.prod(size), contrast


def misfit(motion: np.ndarray, wished: np.ndarray) -> np.ndarray:
    """Return (foci,) relative differences of motion (foci, samples) from the nearest multiples of wished ones."""
    factor = (motion * wished).sum(axis=1) / (wished**2).sum(axis=1)
    nearest = factor[:, None] * wished
    size = np.linalg.norm(nearest, axis=1)
    return np.divide(np.linalg.norm(motion - nearest, axis=1), size, out=np.full_like(size, np.nan), where=size > 0)


def crosstalk(motion: np.ndarray, peak: np.ndarray) -> np.ndarray:
    """Return (foci,) largest motion of the other foci over a focus's own peak [dB]; −∞ if there is one focus."""
    others = np.abs(motion).max(axis=2) * (1 - np.eye(len(motion)))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(20 * np.log10(others.max(axis=1) / np.abs(peak)))

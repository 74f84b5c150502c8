"""Scaling of each plate by its own largest pressure, and from the kernels' sums back to joules."""

from __future__ import annotations

import numpy as np

from warp_plate.plate.signals import Signals
from warp_plate.solve.specialize import Specialized

# Sizes of drives [N/m²] whose energies, which go with the square, keep full precision.
SMALLEST_DRIVE, LARGEST_DRIVE = 1e-130, 1e130


def scaled_coefficients(
    signals: Signals, phasors: np.ndarray, sizes: np.ndarray, least: float, coefficients: np.ndarray
) -> np.ndarray:
    """Write the coefficients of plates, each in units of the plate's largest pressure, and return the pressures.

    Args:
        phasors: (plates, actuators) drives.
        sizes: (1 or plates, terms) factors that the waves were divided by.
        least: Pressure of the moving load, which all plates have [N/m²].
        coefficients: (capacity, terms, actuators), written.

    Returns:
        (plates,) pressure [N/m²] of each plate; NaN where its energies would not keep full precision.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # a drive that is not finite spoils its own plate alone
        # Plates innermost: NumPy is slow along short rows.
        columns = signals.coefficients(phasors).transpose(1, 2, 0)
        columns *= sizes.T[:, None]
        scale: np.ndarray = np.maximum(np.abs(columns).max(axis=(0, 1)), least)
        scale[(scale != 0) & ~((scale >= SMALLEST_DRIVE) & (scale <= LARGEST_DRIVE))] = np.nan
        columns /= np.where(scale == 0, 1, scale)
        coefficients[: len(phasors)] = columns.transpose(2, 0, 1)
    return scale


def speed_unit(specialized: Specialized) -> float:
    """Return the velocity [m/s] of a rate of one under a pressure of 1 N/m²; the displacement [m] for displacements."""
    scheme = specialized.scheme
    return scheme.load_scale / (scheme.time_step if specialized.quantity == "velocity" else 1.0)


def energy_unit(specialized: Specialized) -> float:
    """Return the energy, averaged over the window, of a sum of rate² of one: ½ρH·hx·hy·speed²/steps [J]."""
    scheme = specialized.scheme
    (hx, hy), (first, last) = scheme.spacing, scheme.window
    return 0.5 * scheme.surface_density * hx * hy * speed_unit(specialized) ** 2 / (last - first)

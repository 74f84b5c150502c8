"""From phasors to the factors of the waves, each plate scaled by its own largest pressure; and back to joules."""

from __future__ import annotations

import numpy as np

from warp_plate.plate.row_blocks import over_blocks
from warp_plate.plate.signals import Signals
from warp_plate.solve.specialize import Specialized

# Sizes of drives [N/m²] whose energies, which go with the square, are numbers of full precision.
SMALLEST_DRIVE, LARGEST_DRIVE = 1e-130, 1e130


def scaled_coefficients(
    signals: Signals, phasors: np.ndarray, sizes: np.ndarray, least: float, into: np.ndarray
) -> np.ndarray:
    """(plates,) the pressure [N/m²] that each plate is scaled by; NaN where its energies would be no full numbers.

    phasors: (plates, actuators); sizes: (1 or plates, terms) by which the waves were divided; least: pressure of a
    load that moves, which all plates have; into: (room for plates, terms, actuators), takes the coefficients.
    """
    scale = np.empty(len(phasors))

    def fill(rows: slice) -> None:
        with np.errstate(over="ignore", invalid="ignore"):  # a drive that is not finite harms its own plate alone
            # Plates innermost: NumPy is slow along short rows.
            columns = signals.coefficients(phasors[rows]).transpose(1, 2, 0)
            columns *= (sizes if len(sizes) == 1 else sizes[rows]).T[:, None]
            pressure = np.maximum(np.abs(columns).max(axis=(0, 1)), least)
            pressure[(pressure != 0) & ~((pressure >= SMALLEST_DRIVE) & (pressure <= LARGEST_DRIVE))] = np.nan
            scale[rows] = pressure
            columns /= np.where(pressure == 0, 1, pressure)
            into[rows] = columns.transpose(2, 0, 1)

    over_blocks(fill, len(phasors))
    return scale


def energy_unit(specialized: Specialized) -> float:
    """½ρH·hx·hy·(load_scale/Δt)²/steps [J], of displacements without Δt [kg·m²]: turns weighted sums of rate² into
    energy averaged over the window."""
    scheme = specialized.scheme
    (hx, hy), (first, last) = scheme.spacing, scheme.window
    speed = scheme.load_scale / (scheme.time_step if specialized.quantity == "velocity" else 1.0)
    return 0.5 * scheme.surface_density * hx * hy * speed**2 / (last - first)

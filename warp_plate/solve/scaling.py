"""From phasors to the factors of the waves, each plate scaled by its own largest pressure, for large batches."""

from __future__ import annotations

import numpy as np

from warp_plate.plate.blocks import over_blocks
from warp_plate.plate.signals import Signals

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

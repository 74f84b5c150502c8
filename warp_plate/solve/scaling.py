"""From phasors to the factors of the waves, each plate scaled by its own largest pressure, for large batches."""

from __future__ import annotations

from functools import reduce

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
            coefficients = signals.coefficients(phasors[rows])
            coefficients *= (sizes if len(sizes) == 1 else sizes[rows])[..., None]
            # Column by column: NumPy is slow along short rows.
            columns = np.abs(coefficients).reshape(len(coefficients), -1).T
            pressure = np.maximum(reduce(np.maximum, columns), least)
            pressure[(pressure != 0) & ~((pressure >= SMALLEST_DRIVE) & (pressure <= LARGEST_DRIVE))] = np.nan
            scale[rows] = pressure
            coefficients /= np.where(pressure == 0, 1, pressure)[:, None, None]
            into[rows] = coefficients

    over_blocks(fill, len(phasors))
    return scale

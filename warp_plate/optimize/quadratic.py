"""Losses that follow from energies that are quadratic forms of the drive, with their slopes.

With z in R^{2M} as in ``solve.response``, E_r = zᵀ A_r z and loss = L(E), position by position,

    ∂loss/∂x = Σ_r ∂L/∂E_r · 2 (A_r z) · ∂z/∂x

L and z(x) are formulas without any plate in them: their own derivatives are taken by central differences, to about
1e-10 of their size, which leaves the loss at its minimum exact to rounding (the error enters squared).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from warp_plate.solve.response import Response, real_parts

# The step of central differences, as a part of a number's own size: errors of h² and of rounding / h meet.
STEP = 6e-6


@dataclass(frozen=True)
class Quadratic:
    """A problem whose plates need not be run.

    matrices: (regions, 2M, 2M), energies zᵀ A z; drives: positions (n, dimension) → (n, M) phasors; positions: back
    again, as near as the space allows; losses_of: energies (n, regions) → (n,); localization: whether that is 1 − LF
    and nothing else.
    """

    matrices: np.ndarray
    drives: Callable[[np.ndarray], np.ndarray]
    positions: Callable[[np.ndarray], np.ndarray]
    losses_of: Callable[[np.ndarray], np.ndarray]
    localization: bool

    def energies(self, drives: np.ndarray) -> np.ndarray:
        """(n, regions) of drives (n, actuators)."""
        return Response(self.matrices).energy(drives)

    def losses(self, positions: np.ndarray) -> np.ndarray:
        """(n,) of positions (n, dimension)."""
        return self.losses_of(self.energies(self.drives(positions)))

    def losses_and_slopes(
        self, positions: np.ndarray, spans: np.ndarray, lower: np.ndarray, upper: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(n,) losses and (n, dimension) ∂loss/∂x; spans: (dimension,) typical sizes; no step leaves the limits."""
        with np.errstate(all="ignore"):  # what is no number there is no number here
            return self._losses_and_slopes(positions, spans, (lower, upper))

    def _losses_and_slopes(
        self, positions: np.ndarray, spans: np.ndarray, limits: tuple[np.ndarray, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        z = real_parts(self.drives(positions))
        products = np.einsum("rab,pb->pra", self.matrices, z)
        energy = np.einsum("pa,pra->pr", z, products)
        losses = self.losses_of(energy)
        turned = 2 * np.einsum("pr,pra->pa", _slopes(self.losses_of, energy), products)
        slopes = np.empty(positions.shape)
        for column, span in enumerate(spans):
            ends = []
            for step in (STEP * span, -STEP * span):
                moved = positions.copy()
                moved[:, column] = np.clip(moved[:, column] + step, limits[0][column], limits[1][column])
                ends.append((moved[:, column], real_parts(self.drives(moved))))
            (high, z_high), (low, z_low) = ends
            slopes[:, column] = ((z_high - z_low) * turned).sum(axis=1) / (high - low)
        return losses, slopes


def _slopes(losses_of: Callable[[np.ndarray], np.ndarray], energy: np.ndarray) -> np.ndarray:
    """(n, regions) ∂L/∂E of energies (n, regions); an energy of zero has none."""
    slopes = np.zeros(energy.shape)
    for region in range(energy.shape[1]):
        step = STEP * np.abs(energy[:, region])
        ends = []
        for sign in (1, -1):
            moved = energy.copy()
            moved[:, region] += sign * step
            ends.append(losses_of(moved))
        slopes[:, region] = (ends[0] - ends[1]) / np.where(step > 0, 2 * step, 1.0)
    return slopes

"""Losses that follow from energies that are quadratic forms of the drive, with their slopes.

With z = (Re Z₁ ... Re Z_M, −Im Z₁ ... −Im Z_M) of the phasors Z, E_r = zᵀ A_r z and loss = L(E), position by position,

    ∂loss/∂x = Σ_r ∂L/∂E_r · 2 (A_r z) · ∂z/∂x

L and z(x) are formulas without any plate in them: their own derivatives are taken by central differences, to about
1e-10 of their size, which leaves the loss at its minimum exact to rounding (the error enters squared).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from warp_plate.optimize.space import SearchSpace

# The step of central differences, as a part of a number's own size: errors of h² and of rounding / h meet.
STEP = 6e-6
# Drives whose plate energy is below this part of the largest are combinations that cancel out: two actuators in one
# place, for example. What is left of their energy is rounding, and no ratio of it means anything.
RANK_TOLERANCE = 1e-10


@dataclass(frozen=True)
class Quadratic:
    """A problem whose energies are quadratic forms of phasors, so that no plate need be run.

    Attributes:
        matrices: (regions, 2M, 2M) symmetric A_r.
        phasors: function from positions (n, dimension) to phasors (n, M).
        positions: function from phasors (n, M) to positions (n, dimension), as near as the space allows.
        losses_of: function from energies (n, regions) to losses (n,).
        ratio: indices of two regions where the loss is 1 − E_first / E_second and nothing else; None for other losses.
    """

    matrices: np.ndarray
    phasors: Callable[[np.ndarray], np.ndarray]
    positions: Callable[[np.ndarray], np.ndarray]
    losses_of: Callable[[np.ndarray], np.ndarray]
    ratio: tuple[int, int] | None = None

    def energies(self, phasors: np.ndarray) -> np.ndarray:
        """Return the energies (n, regions) of phasors (n, M)."""
        return quadratic_forms(self.matrices, phasors)

    def losses(self, positions: np.ndarray) -> np.ndarray:
        """Return the losses (n,) of positions (n, dimension)."""
        return self.losses_of(self.energies(self.phasors(positions)))

    def losses_and_slopes(self, positions: np.ndarray, space: SearchSpace) -> tuple[np.ndarray, np.ndarray]:
        """Return the losses (n,) and ∂loss/∂x (n, dimension) of positions (n, dimension) in a space."""
        with np.errstate(all="ignore"):  # what is no number there is no number here
            z = real_parts(self.phasors(positions))
            products = np.einsum("rab,pb->pra", self.matrices, z)
            energy = np.einsum("pa,pra->pr", z, products)
            losses = self.losses_of(energy)
            dloss_dz = 2 * np.einsum("pr,pra->pa", _slopes(self.losses_of, energy), products)
            slopes = np.empty(positions.shape)
            for column, span in enumerate(space.span):
                ends = []
                for step in (STEP * span, -STEP * span):
                    moved = positions.copy()
                    moved[:, column] = np.clip(moved[:, column] + step, space.lower[column], space.upper[column])
                    ends.append((moved[:, column], real_parts(self.phasors(moved))))
                (high, z_high), (low, z_low) = ends
                slopes[:, column] = ((z_high - z_low) * dloss_dz).sum(axis=1) / (high - low)
            return losses, slopes


def real_parts(phasors: np.ndarray) -> np.ndarray:
    """Return z = (Re Z, −Im Z), shape (n, 2M), of phasors Z (n, M)."""
    phasors = np.asarray(phasors, dtype=complex)
    return np.concatenate([phasors.real, -phasors.imag], axis=1)


def quadratic_forms(matrices: np.ndarray, phasors: np.ndarray) -> np.ndarray:
    """Return zᵀ A_r z, shape (n, regions), for matrices A (regions, 2M, 2M) and the z of phasors (n, M)."""
    z = real_parts(phasors)
    return np.einsum("pa,rab,pb->pr", z, matrices, z)


def _slopes(losses_of: Callable[[np.ndarray], np.ndarray], energy: np.ndarray) -> np.ndarray:
    """Return ∂L/∂E (n, regions) at energies (n, regions); zero for an energy of zero."""
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

"""The largest ratio of two quadratic forms without a search: an eigenvector of their matrices.

zᵀA z / zᵀB z has its maximum, the largest λ of A z = λ B z, at a z that may be scaled as one likes. Where every
magnitude and phase can be had, up to what all have in common, that z is a position; it is tried, and refused where a
limit, a range or a fixed number keeps it from reaching λ. z is sought within the space of all drives that positions can
have, so that a first phase fixed at 0 costs nothing but what it must.
"""

from __future__ import annotations

import numpy as np

from warp_plate.optimize.optimizer import MethodError, Optimizer, SearchSettings
from warp_plate.optimize.quadratic import RANK_TOLERANCE, Quadratic, real_parts
from warp_plate.optimize.space import SearchSpace

# Relative distance to λ within which a position is the maximum.
NEAR = 1e-9


class ExactSearch(Optimizer):
    """The best position, found without any evaluation, in the shape of a search with one iteration."""

    FORMAT = "exact 2"

    def __init__(self, space: SearchSpace, problem: Quadratic | None) -> None:
        """Find the position.

        Raises:
            MethodError: see :func:`best_position`.
        """
        super().__init__(space, SearchSettings())
        self.positions = best_position(space, problem)[None]

    def stop(self) -> dict[str, int]:
        """Return {"exact": 1} once the loss of the position is known."""
        return {"exact": self.iterations} if self.iterations else {}

    def _propose(self) -> np.ndarray:
        return self.positions

    def _learn(self, losses: np.ndarray) -> None:
        """Learn nothing: the position is the best."""


def best_position(space: SearchSpace, problem: Quadratic | None) -> np.ndarray:
    """Return the position (dimension,) with the largest ratio of all drives that positions can have.

    Raises:
        MethodError: the loss is another one, or no position reaches the maximum; says which method to use.
    """
    if problem is None:
        raise MethodError("needs energies that are quadratic forms of the drives; write 'cma'")
    if problem.ratio is None:
        raise MethodError("is for the localization factor alone; write 'gradient'")
    first, second = problem.ratio
    ratio, phasors = _eigen_phasors(space, problem, problem.matrices[first], problem.matrices[second])
    position = problem.positions(_scaled(space, problem, phasors)[None])[0]
    energy = problem.energies(problem.phasors(position[None]))[0]
    with np.errstate(invalid="ignore", divide="ignore"):
        reached = energy[first] / energy[second]
    if not reached >= ratio * (1 - NEAR):
        raise MethodError(
            "a range, a limit or a fixed number keeps the drive from the eigen-solution, which has a localization "
            f"factor of {ratio:.6g}; write 'gradient'"
        )
    return position


def _eigen_phasors(
    space: SearchSpace, problem: Quadratic, numerator: np.ndarray, denominator: np.ndarray
) -> tuple[float, np.ndarray]:
    """Return the largest ratio, and phasors (M,) that have it, in the span of all that positions can have."""
    drawn = np.random.default_rng(0).random((4 * len(denominator), space.dimension))
    z = real_parts(problem.phasors(space.initial_lower + (space.initial_upper - space.initial_lower) * drawn))
    # Actuators of very different size must not make each other look like rounding: units of equal energy first.
    size = np.sqrt(np.where(np.diag(denominator) > 0, np.diag(denominator), 1))
    _, strength, spanned = np.linalg.svd(z * size, full_matrices=False)
    spanned = spanned[strength > RANK_TOLERANCE * strength[0]] / size
    values, vectors = np.linalg.eigh(spanned @ denominator @ spanned.T)
    kept = values > RANK_TOLERANCE * values[-1]
    if not values[-1] > 0:
        raise MethodError("no drive moves the plate")
    basis = spanned.T @ (vectors[:, kept] / np.sqrt(values[kept]))
    ratios, directions = np.linalg.eigh(basis.T @ numerator @ basis)
    real, imaginary = np.split(basis @ directions[:, -1], 2)
    return float(ratios[-1]), real - 1j * imaginary


def _scaled(space: SearchSpace, problem: Quadratic, phasors: np.ndarray) -> np.ndarray:
    """Return the phasors as large as their magnitudes may be; numbers with an upper limit are magnitudes here."""
    limited = np.isfinite(space.upper)
    phasors = phasors / np.abs(phasors).max()
    if not limited.any():
        return phasors
    phasors = phasors * space.upper[limited].min()
    for _ in range(len(phasors)):  # a magnitude that its lower limit raised may have hidden how small it is
        magnitudes = problem.positions(phasors[None])[0][limited]
        room = (space.upper[limited] / np.where(magnitudes > 0, magnitudes, np.inf)).min(
            initial=np.inf, where=magnitudes > 0
        )
        if not np.isfinite(room) or room <= 1 + NEAR:
            break
        phasors = phasors * room
    return phasors

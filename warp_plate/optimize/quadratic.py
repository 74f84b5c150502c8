"""Losses that follow from energies that are quadratic forms of the drive: their slopes, and the best drive.

With z = (Re Z₁ ... Re Z_M, −Im Z₁ ... −Im Z_M) of the phasors Z, E_r = zᵀ A_r z and loss = L(E), position by position,

    ∂loss/∂x = Σ_r ∂L/∂E_r · 2 (A_r z) · ∂z/∂x

L and z(x) are formulas without any plate in them: their own derivatives are taken by central differences, to about
1e-10 of their size, which leaves the loss at its minimum exact to rounding (the error enters squared).

zᵀA z / zᵀB z has its maximum, the largest λ of A z = λ B z, at a z that may be scaled as one likes. If all magnitudes
and phases are free up to a common factor, that z is a position. It is evaluated, and rejected if a limit, a range or a
fixed value keeps it from reaching λ. z is sought among the drives that positions can represent, so that a first phase
fixed at 0 costs as little as possible. Other losses, and drives under limits, have the optimum of ``problem.bounds``
where that is known.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from warp_plate.optimize.optimizer import MethodError, Optimizer, SearchSettings, SearchSpace

# The step of central differences, as a part of a number's own size: errors of h² and of rounding / h meet.
STEP = 6e-6
# Drives whose plate energy is below this part of the largest are combinations that cancel out: two actuators in one
# place, for example. The remaining energy is rounding, and its ratios are meaningless.
RANK_TOLERANCE = 1e-10
# Relative distance to λ within which a position is the maximum.
NEAR = 1e-9


@dataclass(frozen=True)
class Quadratic:
    """A problem with energies that are quadratic forms of phasors, so that no plate needs to be run."""

    matrices: np.ndarray  # (regions, 2M, 2M) symmetric A_r
    phasors: Callable[[np.ndarray], np.ndarray]  # function from positions (n, dimension) to phasors (n, M)
    # function from phasors (n, M) to positions (n, dimension), as near as the space allows
    positions: Callable[[np.ndarray], np.ndarray]
    losses_of: Callable[[np.ndarray], np.ndarray]  # function from energies (n, regions) to losses (n,)
    # indices of two regions where the loss is 1 − E_first / E_second and nothing else; None for other losses
    ratio: tuple[int, int] | None = None
    # function that returns the phasors (M,) of the best permitted drive that is known without a search, None without
    # one, and whether no drive has less loss; None for other problems
    optimum: Callable[[], tuple[np.ndarray | None, bool]] | None = None

    def energies(self, positions: np.ndarray) -> np.ndarray:
        """Return the energies (n, regions) of positions (n, dimension)."""
        return quadratic_forms(self.matrices, self.phasors(positions))

    def losses(self, positions: np.ndarray) -> np.ndarray:
        """Return the losses (n,) of positions (n, dimension)."""
        return self.losses_of(self.energies(positions))

    def losses_and_slopes(self, positions: np.ndarray, space: SearchSpace) -> tuple[np.ndarray, np.ndarray]:
        """Return the losses (n,) and ∂loss/∂x (n, dimension) of positions (n, dimension) in a space."""
        with np.errstate(all="ignore"):  # NaN stays NaN
            z = real_parts(self.phasors(positions))
            products = np.einsum("rab,pb->pra", self.matrices, z)
            energy = np.einsum("pa,pra->pr", z, products)
            losses = self.losses_of(energy)
            by_drive = 2 * np.einsum("pr,pra->pa", slopes_by_energy(self.losses_of, energy), products)
            columns = range(space.dimension)
            slopes = [slopes_by_drive(self.phasors, positions, column, space, by_drive) for column in columns]
            return losses, np.stack(slopes, axis=1)


def slopes_by_drive(
    phasors: Callable[[np.ndarray], np.ndarray],
    positions: np.ndarray,
    column: int,
    space: SearchSpace,
    by_drive: np.ndarray,
) -> np.ndarray:
    """Return ∂loss/∂x (n,) by a number of positions on which only drives depend, from ∂loss/∂z (n, 2M)."""
    step, ends = STEP * space.span[column], (space.lower[column], space.upper[column])
    high, low = (np.clip(positions[:, column] + change, *ends) for change in (step, -step))
    z_high, z_low = (real_parts(phasors(_with_column(positions, column, values))) for values in (high, low))
    return np.asarray(((z_high - z_low) * by_drive).sum(axis=1) / (high - low))


def real_parts(phasors: np.ndarray) -> np.ndarray:
    """Return z = (Re Z, −Im Z), shape (n, 2M), of phasors Z (n, M)."""
    phasors = np.asarray(phasors, dtype=complex)
    return np.concatenate([phasors.real, -phasors.imag], axis=1)


def quadratic_forms(matrices: np.ndarray, phasors: np.ndarray) -> np.ndarray:
    """Return zᵀ A_r z, shape (n, regions), for matrices A (regions, 2M, 2M) and the z of phasors (n, M)."""
    z = real_parts(phasors)
    return np.einsum("pa,rab,pb->pr", z, matrices, z)


def slopes_by_energy(losses_of: Callable[[np.ndarray], np.ndarray], energy: np.ndarray) -> np.ndarray:
    """Return ∂L/∂E (n, regions) at energies (n, regions); zero for an energy of zero."""
    slopes = np.zeros(energy.shape)
    for region, values in enumerate(energy.T):
        step = STEP * np.abs(values)
        high, low = (losses_of(_with_column(energy, region, values + change)) for change in (step, -step))
        slopes[:, region] = (high - low) / np.where(step > 0, 2 * step, 1.0)
    return slopes


def _with_column(array: np.ndarray, column: int, values: np.ndarray) -> np.ndarray:
    copy = array.copy()
    copy[:, column] = values
    return copy


class ExactSearch(Optimizer):
    """Positions (n, dimension) of which one is the best or near it, in the shape of a search with one iteration."""

    FORMAT = "exact 2"

    def __init__(self, space: SearchSpace, positions: np.ndarray) -> None:
        super().__init__(space, SearchSettings())
        self.positions = positions

    def stop(self) -> dict[str, int]:
        """Return {"exact": 1} once the losses of the positions are known."""
        return {"exact": self.iterations} if self.iterations else {}

    def _propose(self) -> np.ndarray:
        return self.positions

    def _learn(self, losses: np.ndarray) -> None:
        """Learn nothing: the best of them is recorded."""


def best_position(space: SearchSpace, problem: Quadratic | None) -> np.ndarray:
    """Return the position (dimension,) with the least loss, or raise a MethodError that names another method."""
    if problem is None:
        raise MethodError("needs energies that are quadratic forms of the drives; write 'cma'")
    position = _eigen_position(space, problem)
    if position is not None:
        return position
    position, attained = _optimum_position(problem)
    if position is None or not attained:
        raise MethodError("no drive within the ranges and limits is known to reach the bound; write 'gradient'")
    return position


def starting_position(space: SearchSpace, problem: Quadratic) -> np.ndarray | None:
    """Return the best position (dimension,) that is known without a search; None where descents need none, or none is
    known."""
    return _optimum_position(problem)[0] if _eigen_position(space, problem) is None else None


def _optimum_position(problem: Quadratic) -> tuple[np.ndarray | None, bool]:
    """Return the position (dimension,) of the problem's optimum, if it is known, and whether it has the least loss."""
    phasors, attained = (None, False) if problem.optimum is None else problem.optimum()
    if phasors is None:
        return None, False
    position = problem.positions(phasors[None])[0]
    loss = problem.losses_of(quadratic_forms(problem.matrices, phasors[None]))[0]
    near = problem.losses(position[None])[0] <= loss + NEAR * abs(loss)
    return position, bool(attained and near)


def _eigen_position(space: SearchSpace, problem: Quadratic) -> np.ndarray | None:
    """Return the position (dimension,) with the largest ratio; None for other losses, and where a range, a limit or a
    fixed number keeps the drive from it."""
    if problem.ratio is None:
        return None
    first, second = problem.ratio
    ratio, phasors = _eigen_phasors(space, problem, *problem.matrices[[first, second]])
    position = problem.positions(_scaled(space, problem, phasors)[None])[0]
    energy = problem.energies(position[None])[0]
    with np.errstate(invalid="ignore", divide="ignore"):
        reached = energy[first] / energy[second]
    return position if reached >= ratio * (1 - NEAR) else None


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
    independent = values > RANK_TOLERANCE * values[-1]
    if not values[-1] > 0:
        raise MethodError("no drive moves the plate")
    basis = spanned.T @ (vectors[:, independent] / np.sqrt(values[independent]))
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
        magnitudes = problem.positions(phasors[None])[0]
        positive = limited & (magnitudes > 0)
        room = (space.upper[positive] / magnitudes[positive]).min(initial=np.inf)
        phasors = phasors * room if 1 + NEAR < room < np.inf else phasors
    return phasors

"""The best drive of all without a search: the eigenvector of the energies' matrices.

LF = zᵀA z / zᵀB z has its maximum, the largest λ of A z = λ B z, at a z that may be scaled as one likes. Where every
magnitude and phase can be had, up to what all have in common, that z is a position; it is tried, and what a limit, a
range or a held number keeps from reaching λ is refused. z is sought within the space of all drives that positions can
have, so that a first phase held at 0 costs nothing but what it must.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warp_plate.optimize.quadratic import Quadratic
from warp_plate.optimize.record import Record, Recorded, check_format, plain, shaped
from warp_plate.optimize.space import Space
from warp_plate.plate.weights import REGIONS
from warp_plate.scene.errors import SceneError
from warp_plate.solve.response import RANK_TOLERANCE, real_parts

STATE_FORMAT = "exact 1"
# A position is the maximum when it comes this near to λ.
NEAR = 1e-9
KEY = "search.method = 'exact'"


class ExactSearch(Recorded):
    """One position, told once, in the shape of a search.

    Raises:
        SceneError: something else than the localization factor is sought, or no position reaches the maximum; says
            which method to use.
    """

    def __init__(self, space: Space, problem: Quadratic | None) -> None:
        self.positions = best_position(space, problem)[None]
        self._record = Record(space.dimension)

    def ask(self) -> np.ndarray:
        """The best position, (1, dimension)."""
        return self.positions.copy()

    def tell(self, solutions: ArrayLike, losses: ArrayLike) -> None:
        """Take its loss. Raises ValueError if it is another position or was told before."""
        self._record.tell(None if self.iterations else self.positions, solutions, losses)

    def stop(self) -> dict[str, int]:
        """{"exact": 1} once its loss is told."""
        return {"exact": self.iterations} if self.iterations else {}

    def state(self, plain_numbers: bool = True) -> dict[str, Any]:
        """Position and record; strict JSON types, or with False arrays as arrays."""
        state = {"format": STATE_FORMAT, "positions": self.positions.copy(), **self._record.state()}
        return plain(state) if plain_numbers else state

    @classmethod
    def from_state(cls, space: Space, problem: Quadratic | None, state: dict[str, Any]) -> ExactSearch:
        """The search that ``state()`` was taken from. Raises ValueError for anything else."""
        search = cls(space, problem)
        try:
            check_format(state, STATE_FORMAT)
            search.positions = shaped(state, "positions", (1, space.dimension))
            search._record.load(state)
        except (KeyError, TypeError) as error:
            raise ValueError(f"search state: {error} is missing or of a wrong kind") from None
        return search


def best_position(space: Space, problem: Quadratic | None) -> np.ndarray:
    """(dimension,) the position with the largest localization factor of all drives that positions can have.

    Raises:
        SceneError: see :class:`ExactSearch`.
    """
    if problem is None:
        raise SceneError(f"{KEY}: needs energies that are quadratic forms of the drives; write 'cma'")
    if not problem.localization:
        raise SceneError(f"{KEY}: is for the localization factor alone; write 'gradient'")
    ratio, drive = _eigen_drive(space, problem)
    position = problem.positions(_scaled(space, problem, drive)[None])[0]
    energy = problem.energies(problem.drives(position[None]))[0]
    with np.errstate(invalid="ignore", divide="ignore"):
        reached = energy[REGIONS.index("target")] / energy[REGIONS.index("plate")]
    if not reached >= ratio * (1 - NEAR):
        raise SceneError(
            f"{KEY}: a range, a limit or a number that is held keeps the drive from the eigen-solution, which has a "
            f"localization factor of {ratio:.6g}; write 'gradient'"
        )
    return position


def _eigen_drive(space: Space, problem: Quadratic) -> tuple[float, np.ndarray]:
    """The largest localization factor, and a drive (M,) that has it, in the span of all that positions can have."""
    target, plate = problem.matrices[REGIONS.index("target")], problem.matrices[REGIONS.index("plate")]
    drawn = np.random.default_rng(0).random((4 * len(plate), space.dimension))
    z = real_parts(problem.drives(space.initial_lower + (space.initial_upper - space.initial_lower) * drawn))
    # Actuators of very different size must not make each other look like rounding: units of equal energy first.
    size = np.sqrt(np.where(np.diag(plate) > 0, np.diag(plate), 1))
    _, strength, spanned = np.linalg.svd(z * size, full_matrices=False)
    spanned = spanned[strength > RANK_TOLERANCE * strength[0]] / size
    values, vectors = np.linalg.eigh(spanned @ plate @ spanned.T)
    kept = values > RANK_TOLERANCE * values[-1]
    if not values[-1] > 0:
        raise SceneError(f"{KEY}: no drive moves the plate")
    basis = spanned.T @ (vectors[:, kept] / np.sqrt(values[kept]))
    ratios, directions = np.linalg.eigh(basis.T @ target @ basis)
    real, imaginary = np.split(basis @ directions[:, -1], 2)
    return float(ratios[-1]), real - 1j * imaginary


def _scaled(space: Space, problem: Quadratic, drive: np.ndarray) -> np.ndarray:
    """The drive as large as its magnitudes may be: numbers with an upper limit are magnitudes here."""
    limited = np.isfinite(space.upper)
    drive = drive / np.abs(drive).max()
    if not limited.any():
        return drive
    drive = drive * space.upper[limited].min()
    for _ in range(len(drive)):  # a magnitude that its lower limit raised may have hidden how small it is
        held = problem.positions(drive[None])[0][limited]
        room = (space.upper[limited] / np.where(held > 0, held, np.inf)).min(initial=np.inf, where=held > 0)
        if not np.isfinite(room) or room <= 1 + NEAR:
            break
        drive = drive * room
    return drive

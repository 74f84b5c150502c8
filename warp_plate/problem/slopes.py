"""Slopes of losses with respect to places, frequencies, delays and drives, from those of the modal energies.

    ∂loss/∂x = Σ_r ∂L/∂E_r (∂E_r/∂x + ∂E_r/∂z · ∂z/∂x)

with E_r and its slopes by :mod:`warp_plate.modal.slopes`, and z(x) and L(E) as in :mod:`warp_plate.optimize.quadratic`.
If each position has its best drive, the loss does not change with the drive to first order, so ∂z/∂x is not needed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from warp_plate.modal.solver import ModalSolver
from warp_plate.optimize.quadratic import slopes_by_drive, slopes_by_energy
from warp_plate.optimize.space import SearchSpace
from warp_plate.plate.designs import Designs
from warp_plate.problem.clearance import Clearance
from warp_plate.problem.parametrization import DRIVES, Parametrization


@dataclass(frozen=True)
class ModalSlopes:
    """Losses of positions and their slopes, by modes.

    Attributes:
        searched: design variables of a position.
        designs: function from positions (n, dimension) to designs with the drives that they have.
        solvers: solvers whose energies (n, regions) come one after the other.
        losses_of: function from these energies to losses (n,).
        clearance: distances that actuators keep.
    """

    searched: Parametrization
    designs: Callable[[np.ndarray], Designs]
    solvers: tuple[ModalSolver, ...]
    losses_of: Callable[[np.ndarray], np.ndarray]
    clearance: Clearance

    def losses_and_slopes(self, positions: np.ndarray, space: SearchSpace) -> tuple[np.ndarray, np.ndarray]:
        """Return the losses (n,) and ∂loss/∂x (n, dimension) of positions (n, dimension) in a space."""
        designs = self.designs(positions)
        found = [solver.energy_slopes(designs) for solver in self.solvers]
        energy = np.concatenate([each.energy for each in found], axis=1)
        by_energy = slopes_by_energy(self.losses_of, energy)

        def by(name: str) -> np.ndarray:
            values = np.concatenate([getattr(each, name) for each in found], axis=1)
            return np.einsum("nr,nr...->n...", by_energy, values)

        centre, by_drive, kinds = by("centre"), by("drives"), {"frequency": by("frequency"), "delay": by("delay")}
        losses = self.losses_of(energy)
        if designs.centre is not None:
            near = self.clearance.shortfall(designs.centre) > 0
            losses = self.clearance.losses(designs, losses)
            centre = np.where(near[:, None, None], self.clearance.slopes(designs.centre), centre)
        else:
            near = np.zeros(len(losses), dtype=bool)
        kinds |= {"x": centre[..., 0], "y": centre[..., 1]}
        slopes = np.zeros(positions.shape)
        for column, variable in enumerate(self.searched.variables):
            if variable.kind in DRIVES:
                slopes[:, column] = slopes_by_drive(self._phasors, positions, column, space, by_drive)
            else:
                slopes[:, column] = kinds[variable.kind][:, list(variable.actuators)].sum(axis=1)
            if variable.kind not in ("x", "y"):
                slopes[near, column] = 0.0
        return losses, slopes

    def _phasors(self, positions: np.ndarray) -> np.ndarray:
        return self.searched.designs(positions).drives

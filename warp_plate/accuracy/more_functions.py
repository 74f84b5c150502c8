"""Error bars of results by modes, from their change with more functions: expected before a run, printed after it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warp_plate.accuracy.reference_solution import LEAST_ERROR, solve_response
from warp_plate.modal.modes import ModalPlate
from warp_plate.scene.model import Scene
from warp_plate.solve.response import Response

# Modes are compared with those of a higher density, up to a frequency that is higher by another factor. Errors are at
# most so many times the change, which holds where they fall as density^-1.3 or faster, and LEAST_ERROR besides, for
# free motion that is left out.
FINER, HIGHER, CHANGE_FACTOR = 1.2, 2.0, 5.0
# They are at least this part of the change from fewer functions, since two densities may agree by chance.
COARSER, BEFORE_FACTOR = 0.7, 0.3


@dataclass(frozen=True)
class MoreFunctions:
    """Responses of a scene by the modes that are taken, by more and by fewer of them."""

    plate: ModalPlate  # modes of more functions
    response: Response  # response by the modes that are taken
    finer: Response  # response by those of more functions
    coarser: Response  # response by those of fewer functions

    def changes(self, phasors: np.ndarray) -> np.ndarray:
        """Return the relative changes (drives,) of the results of drives (drives, actuators).

        The error of a localization factor may pass through zero, so the changes of the drive's own energies count too,
        and a part of the changes from fewer functions.
        """
        after = _changes(phasors, self.finer, self.response)
        return np.maximum(after, BEFORE_FACTOR / CHANGE_FACTOR * _changes(phasors, self.response, self.coarser))

    def error(self, phasors: np.ndarray) -> float:
        """Return the largest error of drives (drives, actuators)."""
        return float(error_of(self.changes(phasors)).max())


def compare_with_more_functions(scene: Scene) -> MoreFunctions:
    """Solve for the modes that are taken, for more and for fewer of them.

    Raises:
        SceneError: An undamped plate is driven at resonance, or the plate has no modes.
    """
    (_, response), (plate, finer) = solve_response(scene, 1.0), solve_response(scene, FINER, HIGHER)
    return MoreFunctions(plate, response, finer, solve_response(scene, COARSER)[1])


def _changes(phasors: np.ndarray, finer: Response, coarser: Response) -> np.ndarray:
    """Return the largest relative changes (drives,) of the localization factors and the energies of drives."""
    results = [np.column_stack([each.localization_factors(phasors), each.energy(phasors)]) for each in (finer, coarser)]
    with np.errstate(divide="ignore", invalid="ignore"):
        largest: np.ndarray = np.nanmax(np.abs(results[1] / results[0] - 1), axis=1, initial=0)
    return largest


def error_of(change: np.ndarray) -> np.ndarray:
    """Return the error bar for a change with more functions."""
    return CHANGE_FACTOR * change + LEAST_ERROR

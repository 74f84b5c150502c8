"""Positions that take no search: that of the scene itself, frequencies that follow every resonance, and the best drive
that is known for given places."""

import numpy as np

from warp_plate.modal.poles import adaptive_frequencies
from warp_plate.modal.solver import ModalSolver
from warp_plate.plate.designs import Designs
from warp_plate.problem.allowed_drives import searches_only_frequency
from warp_plate.problem.bounds import bound_loss
from warp_plate.problem.objectives import Objectives
from warp_plate.problem.parametrization import Parametrization
from warp_plate.problem.plates import SearchPlates
from warp_plate.solve.response import Response
from warp_plate.solve.solver import PlateSolver

# Most steps of Brent's method from the best of the candidates of a frequency.
BRENT_STEPS = 40


def scene_position(parametrization: Parametrization) -> np.ndarray:
    """Return the position (dimension,) of the scene's own values, within their limits."""
    space, values = parametrization.space, np.array([[variable.fixed for variable in parametrization.variables]])
    space.wrap(values)
    return np.asarray(np.clip(values[0], space.lower, space.upper))


def candidate_frequencies(parametrization: Parametrization, solver: PlateSolver | ModalSolver) -> np.ndarray | None:
    """Return rising frequencies (n,) [Hz] that follow every resonance; None unless they are all that is searched, by
    modes and the method "exact"."""
    search = parametrization.scene.search
    if search.method != "exact" or search.frequency is None or not isinstance(solver, ModalSolver):
        return None
    if search.robust is not None or not searches_only_frequency(parametrization):
        return None
    return adaptive_frequencies(*solver.plate.resonances, *search.frequency.range)


def best_known_drive(
    parametrization: Parametrization, objectives: Objectives, plates: SearchPlates, design: Designs
) -> np.ndarray | None:
    """Return the phasors (actuators,) of the best permitted drive that is known without a search for the places,
    frequencies and delays of a design; None where Gram matrices would have to be simulated, or none is known."""
    drives = Parametrization(parametrization.scene, tuple(one for one in parametrization.variables if one.is_drive))
    responses, displacement = [plates.response], plates.displacement_response
    if not parametrization.only_drives and drives.variables:
        evaluators = [evaluator for evaluator in (plates.designs, plates.displacements) if evaluator is not None]
        solvers = [evaluator.solver for evaluator in evaluators]
        modal = [solver for solver in solvers if isinstance(solver, ModalSolver)]
        if len(modal) == len(solvers):
            responses = [Response(solver.gram_matrices(design)[0]) for solver in modal]
            displacement = responses[1] if len(responses) > 1 else None
    bound = bound_loss(drives, objectives, responses[0], displacement)
    return None if bound is None else bound.drive

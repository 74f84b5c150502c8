"""The plates of a search: evaluators of its drives and designs, and their Gram matrices."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from warp_plate.cluster.evaluator import Evaluator
from warp_plate.cluster.pool import WorkerPool
from warp_plate.modal.solver import MODAL, ModalSolver
from warp_plate.plate.designs import Designs, per_plate_of
from warp_plate.problem.objectives import Objectives
from warp_plate.problem.parametrization import Parametrization
from warp_plate.resolve import Resolved
from warp_plate.scene.errors import SceneError
from warp_plate.solve.response import Response, measure_response
from warp_plate.solve.solver import PlateSolver


@dataclass(frozen=True, eq=False)
class SearchPlates:
    """Plates that differ in what a search chooses."""

    drives: Evaluator  # plates that differ in their drives alone
    designs: Evaluator  # plates of the search; the same where only drives are searched
    displacements: Evaluator | None  # plates whose energies are ½ ∫ ρH u² dA [J s²]; None if no objective needs them
    # Gram matrices of ``drives``; None if energies are not quadratic forms of the phasors
    response: Response | None = None
    displacement_response: Response | None = None  # Gram matrices of ``displacements``; None as for ``response``
    direct: bool = False  # True if plates are simulated even where Gram matrices hold
    setup_cost: tuple[float, int] = (0.0, 0)  # seconds of compilation and node-steps before the search

    @property
    def evaluators(self) -> set[Evaluator]:
        """All evaluators."""
        return {evaluator for evaluator in (self.drives, self.designs, self.displacements) if evaluator is not None}

    @property
    def matrices(self) -> np.ndarray | None:
        """(regions, 2M, 2M) Gram matrices of ``response``, then of ``displacement_response``; None without them."""
        responses = [self.response, self.displacement_response]
        matrices = [response.matrices for response in responses if response is not None]
        return np.concatenate(matrices) if matrices else None

    def energies(self, designs: Designs) -> np.ndarray:
        """Return the energies (plates, regions) of designs [J]."""
        if designs.only_drives:
            return self.energies_of_phasors(designs.drives)
        return self.designs.run(designs).energy

    def energies_of_phasors(self, phasors: np.ndarray) -> np.ndarray:
        """Return the energies (plates, regions) of phasors (plates, actuators) at the scene's frequency and places."""
        if not self.direct and self.response is not None:
            return self.response.energy(phasors)
        return self.drives.run(phasors).energy

    def displacement_energies(self, designs: Designs) -> np.ndarray | None:
        """Return energies (plates, regions) of displacements [J s²], for objectives that need them."""
        if not self.direct and self.displacement_response is not None:
            return self.displacement_response.energy(designs.drives)
        return None if self.displacements is None else self.displacements.run(designs).energy


def make_plates(
    parametrization: Parametrization,
    resolved: Resolved,
    objectives: Objectives,
    evaluator: str,
    pool: WorkerPool | None,
    matrices: np.ndarray | None,
) -> SearchPlates:
    """Return the plates of a search; the arguments are those of ``make_problem``, with the scene's objectives."""
    evaluator_on = partial(resolved.plates, pool=pool, areas=objectives.regions)
    grid = varied = resolved.grid
    if not parametrization.only_drives:
        varied = resolved.grid_for(per_plate_of(resolved.scene))
    designs = evaluator_on(varied)
    # All designs share the modes of a plate; kernels are compiled for the quantities that differ between plates.
    drives = designs if varied is grid or evaluator == MODAL else evaluator_on(grid)
    displacements = evaluator_on(varied, quantity="displacement") if objectives.needs_displacement else None
    evaluators = [drives] if displacements is None else [drives, displacements]
    seconds, node_steps = 0.0, 0
    if matrices is None and parametrization.quadratic:
        matrices, seconds, node_steps = _measure_matrices(evaluators, objectives, resolved)
    regions = len(evaluators) * len(drives.solver.regions)
    if matrices is not None and len(matrices) != regions:
        raise SceneError(f"matrices: of {len(matrices)} regions; must be {regions}")
    responses = [None, None] if matrices is None else [*map(Response, np.split(matrices, len(evaluators))), None]
    return SearchPlates(
        drives, designs, displacements, responses[0], responses[1], evaluator == "direct", (seconds, node_steps)
    )


def _measure_matrices(
    evaluators: Iterable[Evaluator], objectives: Objectives, resolved: Resolved
) -> tuple[np.ndarray, float, int]:
    """Return Gram matrices, measured in double precision, and the compilation and node-steps of further solvers."""
    matrices, seconds, node_steps = [], 0.0, 0
    for evaluator in evaluators:
        solver = evaluator.solver
        if isinstance(solver, ModalSolver):
            matrices.append(solver.response.matrices)
            continue
        if solver.scene.grid.precision != "float64":
            quantity = solver.specialized.quantity
            grid = replace(solver.discretization, scene=solver.scene.in_float64())
            solver = PlateSolver(grid, resolved.device, resolved.path, areas=objectives.regions, quantity=quantity)
        matrices.append(measure_response(solver).matrices)
        if solver is not evaluator.solver:
            seconds, node_steps = seconds + solver.compile_seconds, node_steps + solver.node_steps
    return np.concatenate(matrices), seconds, node_steps

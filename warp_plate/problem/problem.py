"""The search of a scene: from positions, by way of designs and of the energies of their plates, to losses.

A robust search evaluates every drive on the same scenarios, and its loss is a measure of theirs:

    loss(position) = measure over s of the loss of panel s under gain_s · drive, its actuators off by offset_s

The scenarios are drawn once, from ``search.robust.seed``: all particles of all iterations meet the same ones, so that
their losses can be compared, and a search that goes on from a checkpoint draws them again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from warp_plate.cluster.evaluator import Evaluator
from warp_plate.cluster.pool import WorkerPool
from warp_plate.modal.solver import ModalSolver
from warp_plate.optimize.gradient import Slopes
from warp_plate.optimize.quadratic import Quadratic
from warp_plate.optimize.space import SearchSpace
from warp_plate.plate.designs import Designs
from warp_plate.problem.bounds import Bound, bound_loss
from warp_plate.problem.clearance import Clearance
from warp_plate.problem.design_variables import has_design_tables
from warp_plate.problem.objectives import Objectives, keeps_limit
from warp_plate.problem.parametrization import Parametrization
from warp_plate.problem.projection import best_drives, has_free_drives
from warp_plate.problem.scenario_losses import ScenarioLosses, apply_measure
from warp_plate.problem.slopes import ModalSlopes
from warp_plate.quantities.region_quantities import PLATE, TARGET
from warp_plate.result.model import BoundKind
from warp_plate.scene.model import Scene
from warp_plate.scene.search import Limits, Robust
from warp_plate.solve.response import Response
from warp_plate.solve.solver import PlateSolver

# Function from phasors (plates, actuators) to energies (plates, regions) [J].
Energies = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Problem:
    """A scene's search, compiled. In a robust search all but its losses and their bound is about the nominal plate.

    Attributes:
        parametrization: design variables.
        objectives: objectives on the scene's grid.
        drive_evaluator: plates of the scene that differ in their drives alone.
        design_evaluator: plates of the search; the same where only drives are searched.
        displacement_evaluator: plates whose energies are ½ ∫ ρH u² dA [J s²]; None if no objective needs them.
        response: Gram matrices of ``drive_evaluator``; None if energies are not quadratic forms of the phasors.
        displacement_response: Gram matrices of ``displacement_evaluator``; None as for ``response``.
        evaluator_name: "direct" simulates plates, "response" takes energies from their Gram matrices, "modal" computes
            energies from the modes of the plate.
        path: path of the kernels, as asked for.
        setup_cost: seconds of compilation and node-steps before the search.
        pool: workers that run batches; None if this process does.
        scenario_losses: losses over the scenarios of a robust search; None for other searches.
        projected: True if each design has its best drive, so that positions hold no magnitudes and phases, see
            :mod:`projection`.
    """

    parametrization: Parametrization
    objectives: Objectives
    drive_evaluator: Evaluator
    design_evaluator: Evaluator
    displacement_evaluator: Evaluator | None
    response: Response | None
    displacement_response: Response | None
    evaluator_name: str
    path: str
    setup_cost: tuple[float, int]
    pool: WorkerPool | None
    scenario_losses: ScenarioLosses | None = None
    projected: bool = False

    @property
    def drive_solver(self) -> PlateSolver | ModalSolver:
        """Solver of ``drive_evaluator``."""
        return self.drive_evaluator.solver

    @property
    def scene(self) -> Scene:
        """Scene with a grid and a time step that carry every position."""
        return self.parametrization.scene

    @cached_property
    def searched(self) -> Parametrization:
        """Design variables that the method chooses."""
        return self.parametrization.without_drives if self.projected else self.parametrization

    @property
    def space(self) -> SearchSpace:
        """Space of the positions that the method chooses."""
        return self.searched.space

    @cached_property
    def clearance(self) -> Clearance:
        """Distances that actuators keep."""
        return Clearance(self.scene)

    @property
    def robust(self) -> Robust:
        """The table ``[search.robust]`` of a robust search."""
        assert self.scene.search.robust is not None
        return self.scene.search.robust

    @cached_property
    def nominal(self) -> Problem:
        """The same search on the nominal plate only, with the same solvers."""
        projected = self.evaluator_name == "modal" and has_free_drives(self.parametrization, self.objectives)
        return replace(self, scenario_losses=None, projected=projected)

    @property
    def node_steps(self) -> int:
        """Node-steps of all plates so far."""
        return self.setup_cost[1] + sum(evaluator.node_steps for evaluator in self._evaluators)

    @property
    def compile_seconds(self) -> float:
        """Seconds of compilation of all solvers."""
        return self.setup_cost[0] + sum(evaluator.compile_seconds for evaluator in self._evaluators)

    @property
    def lost(self) -> Counter[str]:
        """Number of plates without energies because workers failed, by the reason."""
        return sum((evaluator.lost for evaluator in self._evaluators), Counter())

    @property
    def matrices(self) -> np.ndarray | None:
        """(regions, 2M, 2M) Gram matrices of ``response``, then of ``displacement_response``; None without them."""
        known = [each.matrices for each in (self.response, self.displacement_response) if each is not None]
        return np.concatenate(known) if known else None

    def energies(self, designs: Designs) -> np.ndarray:
        """Return the energies (plates, regions) of designs [J]."""
        if designs.only_drives:
            return self.energies_of_phasors(designs.drives)
        return self.design_evaluator.run(designs).energy

    def energies_of_phasors(self, phasors: np.ndarray) -> np.ndarray:
        """Return the energies (plates, regions) of phasors (plates, actuators) at the scene's frequency and places."""
        if self.evaluator_name != "direct" and self.response is not None:
            return self.response.energy(phasors)
        return self.drive_evaluator.run(phasors).energy

    def design_losses(self, designs: Designs) -> np.ndarray:
        """Return the losses (plates,) of designs; NaN where a plate has no energies."""
        if self.scenario_losses is not None:
            return apply_measure(self.scenario_losses.losses(designs), self.robust)
        return self.objectives.losses(self.energies(designs), self._displacement_energies(designs))

    def losses(self, positions: np.ndarray) -> np.ndarray:
        """Return the losses (n,) of positions (n, dimension) of ``space``."""
        designs = self.searched.designs(positions)
        return self.clearance.losses(designs, self._losses(designs))

    def losses_without_clearance(self, positions: np.ndarray) -> np.ndarray:
        """Return the losses (n,) of positions (n, dimension) at which actuators may come too near."""
        return self._losses(self.searched.designs(positions))

    def designs(self, positions: np.ndarray) -> Designs:
        """Return the designs of positions (n, dimension) of ``space``, with their best drives where these are."""
        designs = self.searched.designs(positions)
        return self._with_best_drives(designs)[0] if self.projected else designs

    def complete(self, position: np.ndarray) -> np.ndarray:
        """Return the position of all design variables (dimension,) for a position of ``space``.

        Raises:
            SceneError: actuators overlap there, as at every position that the search tried.
        """
        designs = self.designs(position[None])
        self.clearance.refuse(designs)
        return self.parametrization.positions_of(designs)[0] if self.projected else position

    def value_from_loss(self, loss: float | np.ndarray) -> float | np.ndarray:
        """Return what people want large: LF, or the weighted sum of the objectives."""
        return 1 - loss if self.objectives.only_localization else -loss

    def objective_values(self, position: np.ndarray) -> dict[str, float]:
        """Return the values of a position (dimension,), and the "bound" of their sum if one is known.

        Empty if only the localization factor counts, which a result has. No bound is given beyond a limit.
        """
        if self.objectives.only_localization:
            return {}
        designs = self.parametrization.designs(position[None])
        values = self.objectives.values(self.energies(designs), self._displacement_energies(designs))
        numbers = {name: float(value[0]) for name, value in values.items()}
        kept = all(keeps_limit(numbers[name], limit) for name, limit in self.objectives.limits.items())
        bound = self._nominal_loss_bound
        return {**numbers, "bound": -bound.value} if bound is not None and kept else numbers

    @cached_property
    def quadratic(self) -> Quadratic | None:
        """The problem for methods that need no plates; None if these are simulated, or energies not quadratic."""
        scenario_losses = self.scenario_losses
        matrices = self.matrices if scenario_losses is None else scenario_losses.matrices
        if matrices is None:
            return None

        def losses_of(energy: np.ndarray) -> np.ndarray:
            if scenario_losses is not None:
                return apply_measure(scenario_losses.losses_from_energies(energy), self.robust)
            return self.objectives.losses(*np.split(energy, 2 if self.displacement_response else 1, axis=1))

        return Quadratic(
            matrices=matrices,
            phasors=lambda positions: self.parametrization.designs(positions).drives,
            positions=lambda phasors: self.parametrization.positions_of(Designs(phasors)),
            losses_of=losses_of,
            ratio=(TARGET, PLATE) if scenario_losses is None and self.objectives.only_localization else None,
        )

    @property
    def slopes(self) -> Slopes | None:
        """Losses and slopes by modes where more than drives is searched; None for other problems."""
        if self.parametrization.only_drives:
            return None
        used = [evaluator.solver for evaluator in (self.design_evaluator, self.displacement_evaluator) if evaluator]
        solvers = tuple(solver for solver in used if isinstance(solver, ModalSolver))
        if self.scenario_losses is not None or len(solvers) < len(used):
            return None
        return ModalSlopes(
            searched=self.searched,
            designs=self.designs,
            solvers=solvers,
            losses_of=lambda energy: self.objectives.losses(*np.split(energy, len(solvers), axis=1)),
            clearance=self.clearance,
        ).losses_and_slopes

    @cached_property
    def loss_bound(self) -> Bound | None:
        """Proved lower bound of the loss; None if none is known."""
        if self.scenario_losses is None:
            return self._nominal_loss_bound
        # No drive, the same for all panels, has a smaller loss than the measure of each panel's own bound.
        bounds = [bound_loss(self.parametrization, *forms) for forms in self.scenario_losses.quadratic_forms()]
        values = [bound.value for bound in bounds if bound is not None]
        if not values or None in bounds:
            return None
        value = float(apply_measure(np.array([values]), self.robust)[0])
        return Bound(value, "bound only", "the measure of what each scenario alone could reach")

    @cached_property
    def _nominal_loss_bound(self) -> Bound | None:
        return bound_loss(self.parametrization, self.objectives, self.response, self.displacement_response)

    @cached_property
    def bound(self) -> float | None:
        """Largest localization factor of any drive; None if none is known, or for other objectives."""
        bound = self._nominal_loss_bound
        if self.response is None or not self.objectives.only_localization or bound is None:
            return None
        return 1 - bound.value if self._limited else self.response.bound()

    @property
    def bound_kind(self) -> BoundKind:
        """Kind of ``bound``, or of the bound of the objectives' sum."""
        bound = self._nominal_loss_bound
        if bound is None:
            return ""
        if self.objectives.only_localization and not self._limited:
            return "attained"
        return "bound only" if bound.kind == "bound only" else "attained within limits"

    @property
    def _limited(self) -> bool:
        """True if some drives cannot be chosen."""
        return has_design_tables(self.scene) or self.scene.search.limits != Limits()

    def _displacement_energies(self, designs: Designs) -> np.ndarray | None:
        """Return energies (plates, regions) of displacements, for objectives that need them."""
        if self.evaluator_name != "direct" and self.displacement_response is not None:
            return self.displacement_response.energy(designs.drives)
        return None if self.displacement_evaluator is None else self.displacement_evaluator.run(designs).energy

    def _losses(self, designs: Designs) -> np.ndarray:
        if self.projected:
            return self.objectives.losses(self._with_best_drives(designs)[1])
        return self.design_losses(designs)

    def _with_best_drives(self, designs: Designs) -> tuple[Designs, np.ndarray]:
        solver = self.design_evaluator.solver
        assert isinstance(solver, ModalSolver)
        return best_drives(self.parametrization, designs, solver.gram_matrices(designs))

    @property
    def _evaluators(self) -> set[Evaluator]:
        nominal = (self.drive_evaluator, self.design_evaluator, self.displacement_evaluator)
        scenarios = () if self.scenario_losses is None else self.scenario_losses.evaluators
        return {evaluator for evaluator in (*nominal, *scenarios) if evaluator is not None}

"""The search of a scene: from positions, by way of designs and of the energies of their plates, to losses.

A robust search evaluates every drive on the same scenarios, and its loss is a measure of theirs:

    loss(position) = measure over s of the loss of panel s under gain_s · drive, its actuators off by offset_s

The scenarios are drawn once, from ``search.robust.seed``: all particles of all iterations meet the same ones, so that
their losses can be compared, and a search that goes on from a checkpoint draws them again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from warp_plate.cluster.evaluator import Evaluator
from warp_plate.cluster.pool import WorkerPool
from warp_plate.modal.solver import MODAL, ModalSolver
from warp_plate.optimize.gradient import Slopes
from warp_plate.optimize.optimizer import SearchSpace
from warp_plate.optimize.quadratic import Quadratic, slopes_by_drive, slopes_by_energy
from warp_plate.plate.designs import Designs
from warp_plate.problem.allowed_drives import best_drives, has_free_drives
from warp_plate.problem.bounds import Bound, bound_loss
from warp_plate.problem.design_variables import DesignVariable, has_design_tables, has_slopes, with_common_step
from warp_plate.problem.objectives import EXCESS, Objectives, make_objectives
from warp_plate.problem.parametrization import Clearance, Parametrization, parametrization_of
from warp_plate.problem.plates import SearchPlates, make_plates
from warp_plate.problem.search_cost import (
    DESIGN_NUMBERS,
    design_numbers,
    evaluator_of,
    refuse_search_beyond_memory,
    search_memory,
)
from warp_plate.problem.starts import best_known_drive, scene_position
from warp_plate.problem.uncertainty import ScenarioLosses, apply_measure, make_scenario_losses
from warp_plate.quantities.region_quantities import PLATE, TARGET
from warp_plate.resolve import Resolved
from warp_plate.result.model import BoundKind
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.search import Limits, Robust
from warp_plate.solve.response import Response
from warp_plate.solve.solver import PlateSolver

# Function from phasors (plates, actuators) to energies (plates, regions) [J].
Energies = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Problem:
    """A scene's search, compiled. In a robust search all but its losses and their bound is about the nominal plate."""

    parametrization: Parametrization  # design variables
    objectives: Objectives  # objectives on the scene's grid
    plates: SearchPlates  # plates of the search and their Gram matrices
    # "direct" simulates plates, "response" takes energies from their Gram matrices, "modal" computes energies from the
    # modes of the plate
    evaluator_name: str
    resolved: Resolved  # scene on its grid, with engine and device
    pool: WorkerPool | None  # workers that run batches; None if this process does
    scenario_losses: ScenarioLosses | None = None  # losses over the scenarios of a robust search; None for others
    # True if each design has its best drive, so that positions hold no magnitudes and phases, see :mod:`allowed_drives`
    projected: bool = False

    @property
    def drive_solver(self) -> PlateSolver | ModalSolver:
        """Solver of plates that differ in their drives alone."""
        return self.plates.drives.solver

    @property
    def response(self) -> Response | None:
        """Gram matrices of velocities; None if energies are not quadratic forms of the phasors."""
        return self.plates.response

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
        projected = self.evaluator_name == "modal" and has_free_drives(self.parametrization)
        return replace(self, scenario_losses=None, projected=projected)

    @property
    def by_matrices(self) -> Problem:
        """The same search with energies from its Gram matrices instead of simulated plates."""
        return replace(self, evaluator_name="response", plates=replace(self.plates, direct=False))

    @property
    def node_steps(self) -> int:
        """Node-steps of all plates so far."""
        return sum(cost[1] for cost in self._setup_costs) + sum(one.node_steps for one in self._evaluators)

    @property
    def compile_seconds(self) -> float:
        """Seconds of compilation of all solvers."""
        return sum(cost[0] for cost in self._setup_costs) + sum(one.compile_seconds for one in self._evaluators)

    @property
    def lost(self) -> Counter[str]:
        """Number of plates without energies because workers failed, by the reason."""
        return sum((evaluator.lost for evaluator in self._evaluators), Counter())

    def design_losses(self, designs: Designs) -> np.ndarray:
        """Return the losses (plates,) of designs; NaN where a plate has no energies."""
        if self.scenario_losses is not None:
            return apply_measure(self.scenario_losses.losses(designs), self.robust)
        return self.objectives.losses(self.plates.energies(designs), self.plates.displacement_energies(designs))

    def losses(self, positions: np.ndarray) -> np.ndarray:
        """Return the losses (n,) of positions (n, dimension) of ``space``."""
        block = self._positions_a_block or max(1, len(positions))
        parts = [positions[first : first + block] for first in range(0, len(positions), block)]
        return np.concatenate([np.empty(0), *map(self._losses_of_block, parts)])

    def _losses_of_block(self, positions: np.ndarray) -> np.ndarray:
        designs = self.searched.designs(positions)
        return self.clearance.losses(designs, self._losses(designs))

    @property
    def _positions_a_block(self) -> int | None:
        """Number of positions whose forces and Gram matrices by modes are in memory at a time; None for time steps,
        whose plates solvers and workers divide."""
        solver = self.plates.designs.solver
        if isinstance(solver, ModalSolver) and not self.parametrization.only_drives:
            return max(1, DESIGN_NUMBERS // design_numbers(len(self.scene.actuators), *solver.plate.vectors.shape))
        return None

    def losses_without_clearance(self, positions: np.ndarray) -> np.ndarray:
        """Return the losses (n,) of positions (n, dimension) at which actuators may come too near."""
        return self._losses(self.searched.designs(positions))

    def designs(self, positions: np.ndarray) -> Designs:
        """Return the designs of positions (n, dimension) of ``space``, with their best drives where these are."""
        designs = self.searched.designs(positions)
        return self._with_best_drives(designs)[0] if self.projected else designs

    def complete(self, position: np.ndarray) -> np.ndarray:
        """Return the position of all variables (dimension,) for one of ``space``; SceneError: actuators overlap."""
        designs = self.designs(position[None])
        self.clearance.refuse(designs)
        return self.parametrization.positions_of(designs)[0] if self.projected else position

    @cached_property
    def start(self) -> np.ndarray | None:
        """Position (dimension,) of ``space`` with the scene's own places, frequencies and delays and the better of its
        own drive and the best known one, at which a search begins; None where only drives are searched."""
        if self.parametrization.only_drives:
            return None
        tried = np.unique([own := scene_position(self.searched), self.with_best_drive(own)], axis=0)
        return tried[int(np.argmin(np.nan_to_num(self.losses(tried), nan=np.inf)))] if len(tried) > 1 else own

    def with_best_drive(self, position: np.ndarray) -> np.ndarray:
        """Return a position (dimension,) of ``space`` with the best drive known for it, see ``best_known_drive``."""
        design = self.searched.designs(position[None])
        drive = None if self.projected else best_known_drive(self.parametrization, self.objectives, self.plates, design)
        return position if drive is None else self.parametrization.positions_of(replace(design, drives=drive[None]))[0]

    def value_from_loss(self, loss: float | np.ndarray) -> float | np.ndarray:
        """Return what people want large: LF, or the weighted sum of the objectives."""
        return 1 - loss if self.objectives.only_localization else -loss

    def objective_values(self, position: np.ndarray) -> dict[str, float]:
        """Return the values of a position (dimension,), and the "bound" of their sum if one is known and no limit is
        passed; empty if nothing but the localization factor counts, which a result has."""
        if self.objectives.plain:
            return {}
        designs, bound = self.parametrization.designs(position[None]), self._nominal_loss_bound
        energy = self.plates.energies(designs)
        values = self.objectives.values(energy, self.plates.displacement_energies(designs))
        numbers = {name: float(value[0]) for name, value in values.items()}
        if bound is not None and self.objectives.excess(energy, values)[0] <= EXCESS:
            numbers["bound"] = float(self.value_from_loss(bound.value))
        return numbers

    @cached_property
    def quadratic(self) -> Quadratic | None:
        """The problem for methods that need no plates; None if these are simulated, or energies not quadratic."""
        scenario_losses = self.scenario_losses
        matrices = self.plates.matrices if scenario_losses is None else scenario_losses.matrices
        if matrices is None:
            return None

        def losses_of(energy: np.ndarray) -> np.ndarray:
            if scenario_losses is not None:
                return apply_measure(scenario_losses.losses_from_energies(energy), self.robust)
            return self.objectives.losses(*np.split(energy, 2 if self.plates.displacement_response else 1, axis=1))

        return Quadratic(
            matrices=matrices,
            phasors=lambda positions: self.parametrization.designs(positions).drives,
            positions=lambda phasors: self.parametrization.positions_of(Designs(phasors)),
            losses_of=losses_of,
            ratio=(TARGET, PLATE) if scenario_losses is None and self.objectives.plain else None,
            optimum=self._optimum if scenario_losses is None else None,
        )

    def _optimum(self) -> tuple[np.ndarray | None, bool]:
        bound = self._nominal_loss_bound
        return (None, False) if bound is None else (bound.drive, bound.kind == "attained")

    @property
    def slopes(self) -> Slopes | None:
        """Losses and slopes by modes where more than drives is searched; None for other problems."""
        if self.parametrization.only_drives or self.scenario_losses is not None or not has_slopes(self.scene):
            return None
        evaluators = [one for one in (self.plates.designs, self.plates.displacements) if one is not None]
        modal = [one.solver for one in evaluators if isinstance(one.solver, ModalSolver)]
        return partial(self._losses_and_slopes, modal) if len(modal) == len(evaluators) else None

    def _losses_and_slopes(
        self, solvers: Sequence[ModalSolver], positions: np.ndarray, space: SearchSpace
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the losses (n,) of positions (n, dimension) in a space and their slopes ∂loss/∂x (n, dimension):

            ∂loss/∂x = Σ_r ∂L/∂E_r (∂E_r/∂x + ∂E_r/∂z · ∂z/∂x)

        with E_r and its slopes by :mod:`warp_plate.modal.slopes`, and z(x) and L(E) as in
        :mod:`warp_plate.optimize.quadratic`. If each position has its best drive, the loss does not change with the
        drive to first order, so ∂z/∂x is not needed.
        """

        def losses_of(energy: np.ndarray) -> np.ndarray:
            return self.objectives.losses(*np.split(energy, len(solvers), axis=1))

        def phasors(points: np.ndarray) -> np.ndarray:
            return self.searched.designs(points).drives

        def by(name: str) -> np.ndarray:
            values = np.concatenate([getattr(of_solver, name) for of_solver in slopes_of_energies], axis=1)
            return np.einsum("nr,nr...->n...", by_energy, values)

        designs, variables = self.designs(positions), self.searched.variables
        slopes_of_energies = [solver.energy_slopes(designs) for solver in solvers]
        energy = np.concatenate([of_solver.energy for of_solver in slopes_of_energies], axis=1)
        losses, by_energy = losses_of(energy), slopes_by_energy(losses_of, energy)
        by_drive, centre = by("drives"), by("centre")
        by_value = {"frequency": by("frequency"), "delay": by("delay")}
        if designs.centre is not None:  # where actuators come too near, only their places count
            near = self.clearance.shortfall(designs.centre) > 0
            losses = self.clearance.losses(designs, losses)
            centre[near] = self.clearance.slopes(designs.centre)[near]
            for values in (by_drive, *by_value.values()):
                values[near] = 0.0
        by_value |= {"x": centre[..., 0], "y": centre[..., 1]}

        def slope(index: int, variable: DesignVariable) -> np.ndarray:
            if variable.is_drive:  # which limits may scale with all others
                return slopes_by_drive(phasors, positions, index, space, by_drive)
            return np.asarray(by_value[variable.kind][:, list(variable.actuators)].sum(axis=1))

        return losses, np.stack([slope(*numbered) for numbered in enumerate(variables)], axis=1)

    @cached_property
    def loss_bound(self) -> Bound | None:
        """Proved lower bound of the loss of all permitted drives; None if none is known."""
        if self.scenario_losses is None:
            return self._nominal_loss_bound
        # No drive, the same for all panels, has a smaller loss than the measure of each panel's own bound.
        forms = self.scenario_losses.quadratic_forms()
        bounds = [bound_loss(self.parametrization, *of_scenario, attain=False) for of_scenario in forms]
        values = [bound.value for bound in bounds if bound is not None]
        if not values or None in bounds:
            return None
        value = float(apply_measure(np.array([values]), self.robust)[0])
        return Bound(value, "bound only")  # the measure of what each scenario alone could reach

    @cached_property
    def _nominal_loss_bound(self) -> Bound | None:
        return bound_loss(
            self.parametrization, self.objectives, self.plates.response, self.plates.displacement_response
        )

    @cached_property
    def bound(self) -> float | None:
        """Largest localization factor of any drive; None if none is known, or for other objectives."""
        bound = self._nominal_loss_bound
        if self.response is None or not self.objectives.only_localization or bound is None:
            return None
        return 1 - bound.value if self._limited else self.response.bound()

    def bound_by(self, response: Response) -> float | None:
        """Return ``bound`` by other Gram matrices of plate and target; None where further regions are limited."""
        if not self._limited:
            return response.bound()
        if any(limit.region >= len(response.matrices) for limit in self.objectives.region_limits):
            return None
        bound = bound_loss(self.parametrization, self.objectives, response, attain=False)
        return None if bound is None else 1 - bound.value

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

    def _losses(self, designs: Designs) -> np.ndarray:
        if self.projected:
            return self.objectives.losses(self._with_best_drives(designs)[1])
        return self.design_losses(designs)

    def _with_best_drives(self, designs: Designs) -> tuple[Designs, np.ndarray]:
        solver = self.plates.designs.solver
        assert isinstance(solver, ModalSolver)
        return best_drives(self.parametrization, designs, solver.gram_matrices(designs))

    @property
    def _evaluators(self) -> set[Evaluator]:
        scenarios = () if self.scenario_losses is None else self.scenario_losses.evaluators
        return self.plates.evaluators | set(scenarios)

    @property
    def _setup_costs(self) -> list[tuple[float, int]]:
        """Seconds of compilation and node-steps of solvers that served to measure Gram matrices."""
        return [part.setup_cost for part in (self.plates, self.scenario_losses) if part is not None]


def make_problem(resolved: Resolved, matrices: np.ndarray | None = None, pool: WorkerPool | None = None) -> Problem:
    """Return the problem of a resolved scene, robust where it has ``[search.robust]``.

    Without an evaluator, a robust search takes "response" if it can, and others "direct". Known
    ``SearchPlates.matrices`` are not measured again; the workers of a pool run batches.

    Raises:
        SceneError: see ``parametrization_of``, ``with_common_step``, ``make_objectives``, ``draw_scenarios`` and
            :class:`PlateSolver`; "response" for energies that are not quadratic forms of the phasors.
    """
    parametrization = parametrization_of(with_common_step(resolved.scene, not resolved.by_modes))
    scene, robust, quadratic = parametrization.scene, parametrization.scene.search.robust, parametrization.quadratic
    resolved, evaluator = resolved.with_scene(scene), resolved.evaluator
    if evaluator == "response" and not quadratic:
        kinds = dict.fromkeys(variable.kind for variable in parametrization.variables if not variable.is_drive)
        reason = f"no Gram matrix holds where {', '.join(kinds)} is searched"
        reason = reason if scene.linear else f"{scene.nonlinear_table} is not linear in the drives"
        raise SceneError(f"evaluator = 'response': {reason}; write 'direct'")
    name, objectives = evaluator_of(resolved, parametrization), make_objectives(resolved.grid)
    refuse_search_beyond_memory(search_memory(parametrization, resolved, objectives), resolved)
    plates = make_plates(parametrization, resolved, objectives, name, pool, matrices)
    scenarios = None
    if robust is not None:
        scenarios = make_scenario_losses(resolved, robust, pool, measured=name != "direct" and quadratic)
    projected = name == MODAL and robust is None and has_free_drives(parametrization)
    return Problem(
        parametrization=parametrization,
        objectives=objectives,
        plates=plates,
        evaluator_name=name,
        resolved=resolved,
        pool=pool,
        scenario_losses=scenarios,
        projected=projected,
    )

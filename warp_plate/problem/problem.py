"""The search of a scene: from positions, by way of designs and of the energies of their plates, to losses.

A robust search evaluates every drive on the same scenarios, and its loss is a measure of theirs:

    loss(position) = measure over s of the loss of panel s under gain_s · drive, its actuators off by offset_s

The scenarios are drawn once, from ``search.robust.seed``: all particles of all iterations meet the same ones, so that
their losses can be compared, and a search that goes on from a checkpoint draws them again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Literal

import numpy as np

from warp_plate.cluster.evaluator import Evaluator, make_evaluator
from warp_plate.cluster.pool import WorkerPool
from warp_plate.modal.solver import MODAL, ModalSolver, has_modes, refuse_no_modes
from warp_plate.optimize.gradient import Slopes
from warp_plate.optimize.quadratic import Quadratic
from warp_plate.optimize.space import SearchSpace
from warp_plate.plate.designs import Designs, per_plate_of
from warp_plate.plate.discretization import discretize
from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.problem.bounds import Bound, bound_loss
from warp_plate.problem.clearance import Clearance
from warp_plate.problem.design_variables import has_design_tables, with_common_step
from warp_plate.problem.objectives import PLATE, TARGET, Objectives, keeps_limit, make_objectives
from warp_plate.problem.parametrization import Parametrization, parametrization_of
from warp_plate.problem.projection import best_drives, has_free_drives
from warp_plate.problem.scenario_losses import ScenarioLosses, apply_measure, scenario_responses, simulate_scenarios
from warp_plate.problem.slopes import ModalSlopes
from warp_plate.problem.uncertainty import draw_scenarios
from warp_plate.result.model import BoundKind
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.search import Limits, Robust
from warp_plate.solve.response import Response, in_float64, measure_response
from warp_plate.solve.solver import PlateSolver

EvaluatorName = Literal["direct", "response", "modal"]
# Function from phasors (plates, actuators) to energies (plates, regions) [J].
Energies = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
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
        """The same search on the nominal plate alone, with the same solvers."""
        return replace(self, scenario_losses=None)

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
        """Return the position of all design variables (dimension,) that a position of ``space`` stands for.

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
        """Proved lower bound of the loss; None where none is claimed."""
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
        """Largest localization factor that any drive can reach; None where none is claimed, or for other objectives."""
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


def make_problem(
    scene: Scene,
    device: str = "auto",
    path: str = "auto",
    evaluator: str | None = None,
    matrices: np.ndarray | None = None,
    pool: WorkerPool | None = None,
) -> Problem:
    """Return the problem of a scene with a grid, robust where it has ``[search.robust]``.

    Args:
        scene: the scene; device and path are those of :class:`PlateSolver`.
        evaluator: see ``Problem.evaluator_name`` (default: "modal" where places, frequencies or delays of a linear
            scene are searched; else "direct", in a robust search "response" if it can be).
        matrices: ``Problem.matrices`` where they are known (default: they are measured).
        pool: workers that run batches (default: this process does).

    Raises:
        SceneError: see ``parametrization_of``, ``with_common_step``, ``make_objectives``, ``draw_scenarios`` and
            :class:`PlateSolver`; "response" for energies that are not quadratic forms of the phasors.
    """
    evaluator = evaluator or default_evaluator(scene, path)
    if evaluator == MODAL:
        refuse_no_modes(scene)
        path = MODAL
    stepped = path != MODAL
    parametrization = parametrization_of(with_common_step(scene, stepped))
    scene, quadratic = parametrization.scene, parametrization.quadratic
    if evaluator == "response" and not quadratic:
        kinds = [variable.kind for variable in parametrization.variables if variable.kind not in ("magnitude", "phase")]
        reason = f"no Gram matrix holds where {', '.join(dict.fromkeys(kinds))} is searched"
        reason = reason if scene.linear else f"{scene.nonlinear_table} is not linear in the drives"
        raise SceneError(f"evaluator = 'response': {reason}; write 'direct'")
    name = evaluator or ("response" if scene.search.robust is not None and quadratic else "direct")
    grid = discretize(scene, stepped=stepped)
    objectives = make_objectives(grid)
    evaluator_on = partial(make_evaluator, device=device, path=path, pool=pool, areas=objectives.regions)
    varied = grid if parametrization.only_drives else discretize(scene, per_plate_of(scene), stepped=stepped)
    designs = evaluator_on(varied)
    # The modes of a plate serve all designs; kernels are compiled for what differs between plates.
    drives = designs if varied is grid or name == MODAL else evaluator_on(grid)
    displacements = evaluator_on(varied, quantity="displacement") if objectives.needs_displacement else None
    evaluators = [drives] if displacements is None else [drives, displacements]
    seconds, node_steps = 0.0, 0
    if matrices is None and quadratic:
        matrices, seconds, node_steps = _measure_matrices(evaluators, objectives, path)
    regions = len(evaluators) * len(drives.solver.regions)
    if matrices is not None and len(matrices) != regions:
        raise SceneError(f"matrices: of {len(matrices)} regions; must be {regions}")
    responses = [None, None] if matrices is None else [*map(Response, np.split(matrices, len(evaluators))), None]
    scenarios, robust, particles = None, scene.search.robust, scene.search.particles
    if robust is not None:
        what = f"search.particles = {particles} with search.robust.scenarios = {robust.scenarios}"
        refuse_beyond_memory(24.0 * particles * robust.scenarios, what)
        drawn, alias = draw_scenarios(scene, robust.scenarios, robust.seed, stepped=stepped), drives.solver.device.alias
        if name != "direct" and quadratic:
            scenarios = scenario_responses(drawn, alias, path)
        else:
            scenarios = simulate_scenarios(drawn, alias, path, pool)
        seconds, node_steps = seconds + scenarios.setup_cost[0], node_steps + scenarios.setup_cost[1]
    projected = name == MODAL and robust is None and has_free_drives(parametrization, objectives)
    return Problem(
        parametrization, objectives, drives, designs, displacements, responses[0], responses[1], name, path,
        (seconds, node_steps), pool, scenarios, projected,
    )  # fmt: skip


def default_evaluator(scene: Scene, path: str = "auto") -> EvaluatorName | None:
    """Return "modal" where time steps cannot, or where each of the places, frequencies or delays that are searched
    would take plates of its own; None to leave the choice to :func:`make_problem`."""
    search = scene.search
    searched = search.frequency is not None or search.position is not None or search.delay is not None
    by_modes = path == "auto" and searched and search.robust is None and has_modes(scene)
    return MODAL if scene.modal_only_key is not None or by_modes else None


def _measure_matrices(
    evaluators: Iterable[Evaluator], objectives: Objectives, path: str
) -> tuple[np.ndarray, float, int]:
    """Return Gram matrices, measured in double precision, and the compilation and node-steps of further solvers."""
    matrices, seconds, node_steps = [], 0.0, 0
    for evaluator in evaluators:
        solver = evaluator.solver
        if isinstance(solver, ModalSolver):
            matrices.append(solver.response.matrices)
            continue
        if solver.scene.grid.precision != "float64":
            grid, quantity = solver.discretization.with_scene(in_float64(solver.scene)), solver.specialized.quantity
            solver = PlateSolver(grid, solver.device.alias, path, areas=objectives.regions, quantity=quantity)
        matrices.append(measure_response(solver).matrices)
        if solver is not evaluator.solver:
            seconds, node_steps = seconds + solver.compile_seconds, node_steps + solver.node_steps
    return np.concatenate(matrices), seconds, node_steps

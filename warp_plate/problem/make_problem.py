"""Construction of the problem of a scene: its evaluators, Gram matrices and scenarios."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import Literal, NoReturn

import numpy as np

from warp_plate.cluster.evaluator import Evaluator, make_evaluator
from warp_plate.cluster.pool import WorkerPool
from warp_plate.modal.solver import MODAL, ModalSolver, has_modes, refuse_no_modes
from warp_plate.plate.designs import per_plate_of
from warp_plate.plate.discretization import discretize
from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.problem.design_variables import with_common_step
from warp_plate.problem.objectives import Objectives, make_objectives
from warp_plate.problem.parametrization import Parametrization, parametrization_of
from warp_plate.problem.problem import Problem
from warp_plate.problem.projection import has_free_drives
from warp_plate.problem.scenario_losses import ScenarioLosses, scenario_responses, simulate_scenarios
from warp_plate.problem.uncertainty import draw_scenarios
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.search import Robust
from warp_plate.solve.response import Response, in_float64, measure_response
from warp_plate.solve.solver import PlateSolver

EvaluatorName = Literal["direct", "response", "modal"]


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
    scene, robust, quadratic = parametrization.scene, parametrization.scene.search.robust, parametrization.quadratic
    if evaluator == "response" and not quadratic:
        _refuse_response(parametrization)
    name = evaluator or ("response" if robust is not None and quadratic else "direct")
    grid = discretize(scene, stepped=stepped)
    objectives = make_objectives(grid)
    evaluator_on = partial(make_evaluator, device=device, path=path, pool=pool, areas=objectives.regions)
    varied = grid if parametrization.only_drives else discretize(scene, per_plate_of(scene), stepped=stepped)
    designs = evaluator_on(varied)
    # All designs share the modes of a plate; kernels are compiled for the quantities that differ between plates.
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
    scenarios = None
    if robust is not None:
        measured = name != "direct" and quadratic
        scenarios = _scenario_losses(scene, robust, drives.solver.device.alias, path, pool, measured)
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


def _refuse_response(parametrization: Parametrization) -> NoReturn:
    """Refuse the evaluator "response" for energies that are not quadratic forms of the phasors."""
    scene, kinds = parametrization.scene, [variable.kind for variable in parametrization.variables]
    others = [kind for kind in dict.fromkeys(kinds) if kind not in ("magnitude", "phase")]
    reason = f"no Gram matrix holds where {', '.join(others)} is searched"
    reason = reason if scene.linear else f"{scene.nonlinear_table} is not linear in the drives"
    raise SceneError(f"evaluator = 'response': {reason}; write 'direct'")


def _scenario_losses(
    scene: Scene, robust: Robust, device: str, path: str, pool: WorkerPool | None, measured: bool
) -> ScenarioLosses:
    """Return the losses over the scenarios of a robust search, by Gram matrices if ``measured``, else by simulation."""
    particles = scene.search.particles
    what = f"search.particles = {particles} with search.robust.scenarios = {robust.scenarios}"
    refuse_beyond_memory(24.0 * particles * robust.scenarios, what)
    drawn = draw_scenarios(scene, robust.scenarios, robust.seed, stepped=path != MODAL)
    if measured:
        return scenario_responses(drawn, device, path)
    return simulate_scenarios(drawn, device, path, pool)

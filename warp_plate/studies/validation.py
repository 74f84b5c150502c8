"""Out-of-sample comparison of a robust drive with the nominal one, over scenarios that neither was searched with."""

from __future__ import annotations

import numpy as np

from warp_plate.modal.solver import MODAL
from warp_plate.problem.evaluate_cases import evaluate_cases
from warp_plate.problem.problem import Problem
from warp_plate.problem.scenario_losses import simulate_scenarios
from warp_plate.problem.uncertainty import draw_scenarios
from warp_plate.result.case import Case
from warp_plate.result.checkpoint import Checkpoint
from warp_plate.result.model import RobustComparison
from warp_plate.studies.polish import best_nominal


def compare_with_nominal(
    problem: Problem, start: Checkpoint, position: np.ndarray
) -> tuple[RobustComparison, dict[str, Case], int] | None:
    """Compare the position (dimension,) found by a robust search with the best one of the nominal plate.

    See :func:`~warp_plate.studies.polish.best_nominal`. Both drives are then simulated, as two plates of one launch, in
    each of ``search.robust.fresh`` new scenarios.

    Returns:
        The comparison, the nominal drive as the case "nominal", and the node-steps besides those of the problem; None
        without a nominal position.
    """
    nominal, table = problem.nominal, problem.robust
    found = best_nominal(problem, start.seed)
    if found is None:
        return None
    evaluated = evaluate_cases(nominal, start.single_actuator, found)
    designs = problem.parametrization.designs(np.stack([position, found]))
    losses, node_steps = [], evaluated.node_steps
    stepped = problem.path != MODAL
    for scenario in draw_scenarios(problem.scene, table.fresh, table.seed, validation=True, stepped=stepped):
        panel = simulate_scenarios([scenario], problem.drive_solver.device.alias, problem.path)
        losses.append(panel.losses(designs)[:, 0])
        node_steps += sum(evaluator.node_steps for evaluator in panel.evaluators)
    bound = problem.loss_bound
    comparison = RobustComparison(
        measure=f"quantile {table.quantile:g}" if table.measure == "quantile" else table.measure,
        scenarios=table.scenarios,
        localization=problem.objectives.only_localization,
        bound=None if bound is None else float(problem.value_from_loss(bound.value)),
        searched=np.asarray(problem.value_from_loss(problem.design_losses(designs))),
        nominal_plate=np.asarray(problem.value_from_loss(nominal.design_losses(designs))),
        validation=np.asarray(problem.value_from_loss(np.stack(losses, axis=1))),
    )
    return comparison, {"nominal": evaluated.cases["best"]}, node_steps

"""What a robust search has won: its drive and the nominal one over scenarios that neither has met."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from warp_plate.problem.evaluate_cases import evaluate_cases
from warp_plate.problem.robust import RobustProblem
from warp_plate.problem.scenario_losses import simulate_scenarios
from warp_plate.problem.uncertainty import draw_scenarios
from warp_plate.result.checkpoint import Checkpoint
from warp_plate.result.model import Case
from warp_plate.result.robust import RobustComparison
from warp_plate.scene.errors import SceneError
from warp_plate.studies.driver import run_search, searcher_of


def against_nominal(
    problem: RobustProblem, begun: Checkpoint, position: np.ndarray | None, seconds: dict[str, float]
) -> tuple[RobustComparison | None, dict[str, Case], int]:
    """The position (dimension,) that a robust search found, beside what the same search finds without scatter.

    The nominal search has the same method, seed, particles and iterations; each of its evaluations is one plate instead
    of one a scenario. Adds its "robust" seconds.

    Returns:
        The comparison, None where nothing was found, Ctrl-C came first or a fresh scenario is no plate; the nominal
        drive's case by name; and node-steps of what is not the problem's.
    """
    started, nominal = time.perf_counter(), problem.nominal
    searcher = searcher_of(nominal, begun.seed)
    if searcher is None or position is None:
        return None, {}, 0
    found, interrupted = run_search(replace(begun, search_state=searcher.state()), nominal, None, None)
    if interrupted or found is None or found.result.xbest is None:
        return None, {}, 0
    try:
        last = evaluate_cases(nominal, begun.single_actuator, found.result.xbest)
        compared, node_steps = compare_over_fresh(problem, position, found.result.xbest)
    except (KeyboardInterrupt, SceneError):  # a result is not lost for want of a comparison
        return None, {}, 0
    seconds["robust"] = time.perf_counter() - started
    return compared, {"nominal": last.cases["best"]}, node_steps + last.node_steps


def compare_over_fresh(problem: RobustProblem, robust: np.ndarray, nominal: np.ndarray) -> tuple[RobustComparison, int]:
    """The positions (dimension,) that a robust and a nominal search found, over ``search.robust.fresh`` scenarios, and
    the node-steps that these took.

    Each scenario is simulated, both drives as two plates of one launch.

    Raises:
        SceneError: see ``draw_scenarios`` and ``simulate_scenarios``.
    """
    table, designs = problem.robust, problem.parametrization.designs(np.stack([robust, nominal]))
    losses, node_steps = [], 0
    for one in draw_scenarios(problem.scene, table.fresh, table.seed, validation=True):
        panels = simulate_scenarios(
            [one], problem.drive_solver.device.alias, problem.path
        )  # used once, and then let go
        losses.append(panels.losses(designs)[:, 0])
        node_steps += panels.node_steps
    bound = problem.loss_bound

    def values(losses: np.ndarray) -> np.ndarray:
        return np.asarray(problem.value_from_loss(losses))

    compared = RobustComparison(
        measure=f"quantile {table.quantile:g}" if table.measure == "quantile" else table.measure,
        scenarios=table.scenarios,
        localization=problem.only_localization,
        bound=None if bound is None else float(problem.value_from_loss(bound.value)),
        searched=values(problem.design_losses(designs)),
        nominal_plate=values(problem.nominal.design_losses(designs)),
        validation=values(np.stack(losses, axis=1)),
    )
    return compared, node_steps

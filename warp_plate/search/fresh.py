"""What a robust search has won: its drive and the nominal one over scenarios that neither has met."""

from __future__ import annotations

import numpy as np

from warp_plate.result.robust import RobustComparison
from warp_plate.search.panels import solve_directly
from warp_plate.search.robust import RobustProblem
from warp_plate.search.scenarios import draw_scenarios


def compare_over_fresh(problem: RobustProblem, robust: np.ndarray, nominal: np.ndarray) -> RobustComparison:
    """The positions (dimension,) that a robust and a nominal search found, over ``search.robust.fresh`` scenarios.

    Each scenario is simulated, both drives as two plates of one launch.

    Raises:
        SceneError: see ``draw_scenarios`` and ``solve_directly``.
    """
    scene, table = problem.scene, problem.robust
    designs = problem.variables.designs(np.stack([robust, nominal]))
    scenarios = draw_scenarios(scene, table.fresh, table.seed, fresh=True)
    losses = np.concatenate(
        # One at a time: a solver is used once.
        [solve_directly([one], problem.plain.device.alias, problem.path).losses(designs) for one in scenarios],
        axis=1,
    )
    searched = problem.losses_of(designs)
    bound = problem.bound_of_loss

    def values(losses: np.ndarray) -> np.ndarray:
        return np.asarray(problem.value_of(losses))

    return RobustComparison(
        measure=f"quantile {table.quantile:g}" if table.measure == "quantile" else table.measure,
        scenarios=table.scenarios,
        localization=problem.only_localization,
        bound=None if bound is None else float(problem.value_of(bound.value)),
        searched=values(searched),
        nominal_plate=values(problem.nominal.losses_of(designs)),
        fresh=values(losses),
    )

"""Robust searches: every drive is judged by the same scenarios, and its loss is a measure of theirs.

    loss(position) = measure over s of the loss of panel s under gain_s · drive, its actuators off by offset_s

The scenarios are drawn once, from ``search.robust.seed``: all particles of all iterations meet the same ones, so that
their losses can be compared, and a search that goes on from a checkpoint draws them again.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from warp_plate.cluster.pool import WorkerPool
from warp_plate.optimize.quadratic import Quadratic
from warp_plate.plate.designs import Batch, Designs
from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.problem.bounds import Bound
from warp_plate.problem.loss_bounds import bound_loss
from warp_plate.problem.problem import Problem, lost_plates, make_nominal_problem
from warp_plate.problem.scenario_losses import ScenarioLosses, scenario_responses, simulate_scenarios
from warp_plate.problem.uncertainty import draw_scenarios
from warp_plate.result.model import BoundKind
from warp_plate.scene.model import Scene
from warp_plate.scene.search import Robust
from warp_plate.solve.response import Response


@dataclass(frozen=True)
class RobustProblem(Problem):
    """A problem whose losses are those of ``panels``, measured; what is about one plate is about the nominal one."""

    scenario_losses: ScenarioLosses

    @property
    def robust(self) -> Robust:
        """The table ``[search.robust]``."""
        assert self.scene.search.robust is not None
        return self.scene.search.robust

    @cached_property
    def nominal(self) -> Problem:
        """The same search without scatter, on the same solvers."""
        return Problem(**{one.name: getattr(self, one.name) for one in fields(Problem)})

    @property
    def node_steps(self) -> int:
        """Of all plates so far."""
        return super().node_steps + self.scenario_losses.node_steps

    @property
    def compile_seconds(self) -> float:
        """Of all solvers."""
        return super().compile_seconds + self.scenario_losses.compile_seconds

    @property
    def lost(self) -> Counter[str]:
        """Plates without energies because workers failed, by what went wrong."""
        return super().lost + lost_plates(
            solver for panel in self.scenario_losses.scenarios for solver in panel.evaluators
        )

    def losses_of(self, designs: Batch) -> np.ndarray:
        """(plates,) what is to be made small; NaN where a plate has no energies on some panel."""
        return measured(self.scenario_losses.losses(designs[:]), self.robust)

    def objective_values(self, position: np.ndarray) -> dict[str, float]:
        """Of the plate without scatter."""
        return self.nominal.objective_values(position)

    @cached_property
    def quadratic(self) -> Quadratic | None:
        """For methods that need no plates; None where these are simulated."""
        if self.scenario_losses.matrices is None:
            return None
        return Quadratic(
            matrices=self.scenario_losses.matrices,
            drives=lambda positions: self.parametrization.designs(positions).drives,
            positions=lambda drives: self.parametrization.positions_of(Designs(drives)),
            losses_of=lambda energy: measured(self.scenario_losses.judged(energy), self.robust),
            localization=False,
        )

    @cached_property
    def loss_bound(self) -> Bound | None:
        """The measure of what each panel alone could reach: no drive, the same for all, has a smaller one."""
        if self.scenario_losses.matrices is None:
            return None
        least = []
        for panel, matrices in zip(
            self.scenario_losses.scenarios,
            np.split(self.scenario_losses.matrices, len(self.scenario_losses.scenarios)),
            strict=True,
        ):
            forms = [Response(one) for one in np.split(matrices, 2 if panel.objectives.needs_displacement else 1)]
            bound = bound_loss(self.parametrization, panel.objectives, *forms)
            if bound is None:
                return None
            least.append(bound.value)
        value = float(measured(np.array([least]), self.robust)[0])
        return Bound(value, "bound only", "the measure of what each scenario alone could reach")

    @cached_property
    def bound(self) -> float | None:
        """The largest localization factor of the nominal plate."""
        return self.nominal.bound

    @property
    def bound_kind(self) -> BoundKind:
        """Of that."""
        return self.nominal.bound_kind


def make_problem(
    scene: Scene,
    device: str = "auto",
    path: str = "auto",
    evaluator: str | None = None,
    matrices: np.ndarray | None = None,
    pool: WorkerPool | None = None,
) -> Problem:
    """The problem of a scene with a grid, robust where it has ``[search.robust]``; for the arguments see
    ``make_nominal_problem``.

    evaluator: left out, "direct"; of a robust search "response" where energies are quadratic forms of the drive.

    Raises:
        SceneError: see ``make_nominal_problem`` and ``draw_scenarios``.
    """
    robust = scene.search.robust
    made = make_nominal_problem(scene, device, path, evaluator or "direct", matrices, pool)
    if robust is None:
        return made
    chosen = evaluator or ("response" if made.parametrization.quadratic else "direct")
    refuse_beyond_memory(
        24.0 * scene.search.particles * robust.scenarios,
        f"search.particles = {scene.search.particles} with search.robust.scenarios = {robust.scenarios}",
    )
    scenarios = draw_scenarios(made.scene, robust.scenarios, robust.seed)
    alias = made.drive_solver.device.alias
    if chosen == "response":
        panels = scenario_responses(scenarios, alias, path)
    else:
        panels = simulate_scenarios(scenarios, alias, path, pool)
    own = {one.name: getattr(made, one.name) for one in fields(Problem)}
    return RobustProblem(**{**own, "evaluator_name": chosen}, scenario_losses=panels)


def measured(losses: np.ndarray, robust: Robust) -> np.ndarray:
    """(plates,) what a robust search makes small, of losses (plates, scenarios); NaN where one of a plate's is none.

    A plate without energies on one panel is worse than any other: no measure looks past it.
    """
    failed = ~np.isfinite(losses).all(axis=1)
    finite = np.where(failed[:, None], 0.0, losses)
    if robust.measure == "mean":
        found = finite.mean(axis=1)
    elif robust.measure == "worst":
        found = finite.max(axis=1)
    else:
        # No value between two scenarios' losses: one of them, the least that this part of them does not pass.
        found = np.quantile(finite, robust.quantile, axis=1, method="inverted_cdf")
    return np.where(failed, np.nan, found)

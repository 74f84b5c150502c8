"""Robust searches: every drive is evaluated on the same scenarios, and its loss is a measure of theirs.

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
from warp_plate.plate.designs import Designs
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
    """A problem whose losses are a measure over scenarios; all else is about the nominal plate.

    Attributes:
        scenario_losses: losses over the scenarios.
    """

    scenario_losses: ScenarioLosses

    @property
    def robust(self) -> Robust:
        """The table ``[search.robust]``."""
        assert self.scene.search.robust is not None
        return self.scene.search.robust

    @cached_property
    def nominal(self) -> Problem:
        """The same search without scatter, on the same solvers."""
        return Problem(**{field.name: getattr(self, field.name) for field in fields(Problem)})

    @property
    def node_steps(self) -> int:
        """Node-steps of all plates so far."""
        return super().node_steps + self.scenario_losses.node_steps

    @property
    def compile_seconds(self) -> float:
        """Seconds of compilation of all solvers."""
        return super().compile_seconds + self.scenario_losses.compile_seconds

    @property
    def lost(self) -> Counter[str]:
        """Number of plates without energies because workers failed, by the reason."""
        return super().lost + lost_plates(self.scenario_losses.evaluators)

    def design_losses(self, designs: Designs) -> np.ndarray:
        """Return the losses (plates,) of designs; NaN where a plate has no energies on some panel."""
        return apply_measure(self.scenario_losses.losses(designs), self.robust)

    def objective_values(self, position: np.ndarray) -> dict[str, float]:
        """Return the values of a position (dimension,) on the nominal plate."""
        return self.nominal.objective_values(position)

    @cached_property
    def quadratic(self) -> Quadratic | None:
        """The problem for methods that need no plates; None where these are simulated."""
        losses = self.scenario_losses
        if losses.matrices is None:
            return None
        return self._quadratic(
            losses.matrices, lambda energy: apply_measure(losses.losses_from_energies(energy), self.robust), None
        )

    @cached_property
    def loss_bound(self) -> Bound | None:
        """The measure of each panel's own bound: no drive, the same for all panels, has a smaller loss."""
        losses = self.scenario_losses
        if losses.matrices is None:
            return None
        least = []
        for plates, matrices in zip(losses.scenarios, np.split(losses.matrices, len(losses.scenarios)), strict=True):
            forms = map(Response, np.split(matrices, 2 if plates.objectives.needs_displacement else 1))
            bound = bound_loss(self.parametrization, plates.objectives, *forms)
            if bound is None:
                return None
            least.append(bound.value)
        value = float(apply_measure(np.array([least]), self.robust)[0])
        return Bound(value, "bound only", "the measure of what each scenario alone could reach")

    @cached_property
    def bound(self) -> float | None:
        """Largest localization factor of the nominal plate."""
        return self.nominal.bound

    @property
    def bound_kind(self) -> BoundKind:
        """Kind of ``bound``."""
        return self.nominal.bound_kind


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
        scene: see ``make_nominal_problem``, as for all arguments but one.
        device: see there.
        path: see there.
        evaluator: see there (default: "direct"; for a robust search of quadratic forms "response").
        matrices: see there.
        pool: see there.

    Raises:
        SceneError: see ``make_nominal_problem`` and ``draw_scenarios``.
    """
    robust = scene.search.robust
    nominal = make_nominal_problem(scene, device, path, evaluator or "direct", matrices, pool)
    if robust is None:
        return nominal
    chosen = evaluator or ("response" if nominal.parametrization.quadratic else "direct")
    refuse_beyond_memory(
        24.0 * scene.search.particles * robust.scenarios,
        f"search.particles = {scene.search.particles} with search.robust.scenarios = {robust.scenarios}",
    )
    scenarios = draw_scenarios(nominal.scene, robust.scenarios, robust.seed)
    alias = nominal.drive_solver.device.alias
    if chosen == "response":
        losses = scenario_responses(scenarios, alias, path)
    else:
        losses = simulate_scenarios(scenarios, alias, path, pool)
    common = {field.name: getattr(nominal, field.name) for field in fields(Problem)}
    return RobustProblem(**{**common, "evaluator_name": chosen}, scenario_losses=losses)


def apply_measure(losses: np.ndarray, robust: Robust) -> np.ndarray:
    """Return the measure (plates,) of losses (plates, scenarios); NaN where one of a plate's is not finite.

    A plate without energies on one panel is worse than any other: no measure overlooks it.
    """
    failed = ~np.isfinite(losses).all(axis=1)
    finite = np.where(failed[:, None], 0.0, losses)
    if robust.measure == "mean":
        measure = finite.mean(axis=1)
    elif robust.measure == "worst":
        measure = finite.max(axis=1)
    else:
        # The least of the scenarios' losses that this part of them does not pass, not a value between two of them.
        measure = np.quantile(finite, robust.quantile, axis=1, method="inverted_cdf")
    return np.where(failed, np.nan, measure)

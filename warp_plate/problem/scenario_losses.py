"""Losses of designs over the scenarios of a robust search: plates × scenarios.

All plates of a launch share stiffness and mass, so each scenario is a separate launch of the same kernels. Where
energies are quadratic forms of the phasors, each scenario has Gram matrices instead, and one product of arrays covers
all plates and scenarios.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from warp_plate.cluster.evaluator import Evaluator
from warp_plate.cluster.pool import WorkerPool
from warp_plate.modal.solver import ModalSolver
from warp_plate.optimize.quadratic import quadratic_forms
from warp_plate.plate.designs import Designs
from warp_plate.problem.objectives import Objectives, make_objectives
from warp_plate.problem.uncertainty import Scenario
from warp_plate.resolve import Resolved
from warp_plate.scene.search import Robust
from warp_plate.solve.response import Response, in_float64, measure_response

# Plates × matrices in a block for which energies are computed from Gram matrices.
BLOCK = 2**22


@dataclass(frozen=True)
class ScenarioPlates:
    """Plates of one scenario."""

    scenario: Scenario  # the panel
    objectives: Objectives  # objectives on its grid
    # evaluators of velocities and, if an objective needs them, of displacements; none where Gram matrices stand for
    # them
    evaluators: tuple[Evaluator, ...] = ()

    def losses(self, designs: Designs) -> np.ndarray:
        """Return the losses (plates,) of nominal designs on this panel, by simulation."""
        on_panel = self.scenario.designs(designs)
        return self.objectives.losses(*(evaluator.run(on_panel).energy for evaluator in self.evaluators))


@dataclass(frozen=True)
class ScenarioLosses:
    """Losses of designs over all scenarios of a search."""

    scenarios: tuple[ScenarioPlates, ...]  # plates of each scenario
    # (scenarios · regions, 2M, 2M) Gram matrices with gains, each scenario's of velocities before those of
    # displacements; None where plates are simulated
    matrices: np.ndarray | None = None
    setup_cost: tuple[float, int] = (0.0, 0)  # seconds of compilation and node-steps of solvers that are not kept
    block: int = BLOCK

    @property
    def evaluators(self) -> list[Evaluator]:
        """Evaluators of all scenarios."""
        return [evaluator for plates in self.scenarios for evaluator in plates.evaluators]

    def losses(self, designs: Designs) -> np.ndarray:
        """Return losses (plates, scenarios) of designs; not finite where a plate has no energies."""
        if self.matrices is None:
            return np.stack([plates.losses(designs) for plates in self.scenarios], axis=1)
        block = max(1, self.block // len(self.matrices))
        starts = range(0, max(len(designs), 1), block)
        phasors = [designs.drives[start : start + block] for start in starts]
        return np.concatenate([self.losses_from_energies(quadratic_forms(self.matrices, some)) for some in phasors])

    def losses_from_energies(self, energy: np.ndarray) -> np.ndarray:
        """Return losses (plates, scenarios) of energies (plates, scenarios · regions), in the order of ``matrices``."""
        objectives = [plates.objectives for plates in self.scenarios]
        sets, parts = 2 if objectives[0].needs_displacement else 1, np.split(energy, len(objectives), axis=1)
        pairs = zip(objectives, parts, strict=True)
        return np.stack([terms.losses(*np.split(part, sets, axis=1)) for terms, part in pairs], axis=1)

    def quadratic_forms(self) -> Iterator[tuple[Any, ...]]:
        """Yield each scenario's objectives and Gram matrices, of velocities and, if needed, of displacements."""
        if self.matrices is None:
            return
        for plates, matrices in zip(self.scenarios, np.split(self.matrices, len(self.scenarios)), strict=True):
            sets = np.split(matrices, 2 if plates.objectives.needs_displacement else 1)
            yield plates.objectives, *map(Response, sets)


def apply_measure(losses: np.ndarray, robust: Robust) -> np.ndarray:
    """Return the measure (plates,) of losses (plates, scenarios); NaN where one of a plate's is not finite.

    A plate without energies on one panel is worse than any other: no measure overlooks it.
    """
    failed = ~np.isfinite(losses).all(axis=1)
    finite = np.where(failed[:, None], 0.0, losses)
    if robust.measure == "quantile":
        # The least of the scenarios' losses that this part of them does not pass, not a value between two of them.
        measure = np.quantile(finite, robust.quantile, axis=1, method="inverted_cdf")
    else:
        measure = finite.mean(axis=1) if robust.measure == "mean" else finite.max(axis=1)
    return np.where(failed, np.nan, measure)


def simulate_scenarios(
    scenarios: Sequence[Scenario], resolved: Resolved, pool: WorkerPool | None = None
) -> ScenarioLosses:
    """Return losses by simulation, one launch for each scenario; all solvers together take the memory of one.

    Raises:
        SceneError: see :class:`PlateSolver` and ``make_objectives``.
    """
    plates = (_scenario_plates(scenario, resolved, pool, 1 / len(scenarios)) for scenario in scenarios)
    return ScenarioLosses(tuple(plates))


def scenario_responses(scenarios: Sequence[Scenario], resolved: Resolved) -> ScenarioLosses:
    """Return losses by Gram matrices, measured in double precision, for energies that are quadratic in the phasors.

    Raises:
        SceneError: see :class:`PlateSolver`, ``make_objectives`` and ``measure_response``.
    """
    measured, matrices, seconds, node_steps = [], [], 0.0, 0
    for scenario in scenarios:
        gain = np.tile(scenario.gain, 2)
        plates = _scenario_plates(replace(scenario, scene=in_float64(scenario.scene)), resolved)
        for evaluator in plates.evaluators:
            solver = evaluator.solver
            response = solver.response if isinstance(solver, ModalSolver) else measure_response(solver)
            matrices.append(response.matrices * np.outer(gain, gain))
            seconds, node_steps = seconds + evaluator.compile_seconds, node_steps + evaluator.node_steps
        measured.append(ScenarioPlates(scenario, plates.objectives))
    return ScenarioLosses(tuple(measured), np.concatenate(matrices), (seconds, node_steps))


def _scenario_plates(
    scenario: Scenario, resolved: Resolved, pool: WorkerPool | None = None, memory_share: float = 1.0
) -> ScenarioPlates:
    """Return the plates of one scenario; all its solvers together use a fraction of the memory for plates."""
    resolved = resolved.with_scene(scenario.scene)
    grid = resolved.grid_for(scenario.per_plate)
    objectives = make_objectives(grid)
    quantities = ("velocity", "displacement") if objectives.needs_displacement else ("velocity",)
    options = {"areas": objectives.regions, "memory_share": memory_share / len(quantities)}
    evaluators = [resolved.plates(grid, pool, **options, quantity=quantity) for quantity in quantities]
    return ScenarioPlates(scenario, objectives, tuple(evaluators))

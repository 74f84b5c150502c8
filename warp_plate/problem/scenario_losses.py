"""The scenarios of a robust search, compiled: plates × scenarios in, losses out.

A scenario has its own stiffness and mass, which all plates of a launch share: so each scenario is a launch of its own,
of kernels compiled once for all. Where energies are quadratic forms of the drive, each scenario has Gram matrices of
its own instead, and one product of arrays holds all plates and all scenarios.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from warp_plate.cluster.evaluator import Evaluator, make_evaluator
from warp_plate.cluster.pool import WorkerPool
from warp_plate.plate.designs import Designs
from warp_plate.problem.objectives import Objectives, make_objectives
from warp_plate.problem.problem import in_float64
from warp_plate.problem.uncertainty import Scenario, kept_on_plate
from warp_plate.solve.response import Response, measure_response

# Plates × matrices whose energies are worked out at once from Gram matrices.
BLOCK = 2**22


@dataclass(frozen=True)
class ScenarioPlates:
    """A scenario with the judge of its energies; evaluators: of velocities and, where these are judged, of
    displacements; none where Gram matrices stand for them."""

    scenario: Scenario
    objectives: Objectives
    evaluators: tuple[Evaluator, ...] = ()


@dataclass(frozen=True)
class ScenarioLosses:
    """All scenarios of a search.

    matrices: (scenarios · regions, 2M, 2M), scenario by scenario, those of displacements after those of velocities,
    gains included; None where plates are simulated. spent: seconds that compiling took, and node-steps, of solvers that
    are not kept.
    """

    scenarios: tuple[ScenarioPlates, ...]
    matrices: np.ndarray | None = None
    spent: tuple[float, int] = (0.0, 0)

    @property
    def node_steps(self) -> int:
        """Of all plates so far."""
        return self.spent[1] + sum(evaluator.node_steps for panel in self.scenarios for evaluator in panel.evaluators)

    @property
    def compile_seconds(self) -> float:
        """Of all solvers."""
        return self.spent[0] + sum(one.compile_seconds for panel in self.scenarios for one in panel.evaluators)

    def losses(self, designs: Designs) -> np.ndarray:
        """(plates, scenarios); not finite where a plate has no energies."""
        if self.matrices is None:
            return np.stack([_losses_of_plates(panel, designs) for panel in self.scenarios], axis=1)
        response, block = Response(self.matrices), max(1, BLOCK // len(self.matrices))
        cuts = range(0, max(len(designs), 1), block)
        return np.concatenate([self.judged(response.energy(designs.drives[at : at + block])) for at in cuts])

    def judged(self, energy: np.ndarray) -> np.ndarray:
        """(plates, scenarios) losses of energies (plates, scenarios · regions), in the order of ``matrices``."""
        regions = energy.shape[1] // len(self.scenarios)
        if self.scenarios[0].objectives.only_localization:  # of all panels at once: judges then differ in nothing
            found: np.ndarray = (
                self.scenarios[0].objectives.losses(energy.reshape(-1, regions)).reshape(-1, len(self.scenarios))
            )
            return found
        columns = []
        for index, panel in enumerate(self.scenarios):
            own = energy[:, index * regions : (index + 1) * regions]
            columns.append(
                panel.objectives.losses(*np.split(own, 2 if panel.objectives.needs_displacement else 1, axis=1))
            )
        return np.stack(columns, axis=1)


def in_scenario(designs: Designs, scenario: Scenario) -> Designs:
    """What designs are on the panel of a scenario: its gains times their drives, places of their own off as well."""
    centre = designs.centre
    if centre is not None:
        areas = np.array([actuator.area for actuator in scenario.scene.actuators]).reshape(-1, 2, 2)
        half = np.diff(areas, axis=2)[..., 0] / 2
        centre = kept_on_plate(centre + scenario.offset, half, scenario.scene.plate.size)
    return replace(designs, drives=designs.drives * scenario.gain, centre=centre)


def simulate_scenarios(
    scenarios: Sequence[Scenario], device: str = "auto", path: str = "auto", pool: WorkerPool | None = None
) -> ScenarioLosses:
    """ScenarioLosses whose plates are simulated, a launch a scenario; together they take the memory of one solver.

    Raises:
        SceneError: see :class:`PlateSolver` and ``make_objectives``.
    """
    panels = []
    for one in scenarios:
        judge = make_objectives(one.scene)
        share = 1 / (len(scenarios) * (2 if judge.needs_displacement else 1))
        panels.append(ScenarioPlates(one, judge, _evaluators(one, judge, device, path, pool, memory_share=share)))
    return ScenarioLosses(tuple(panels))


def scenario_responses(scenarios: Sequence[Scenario], device: str = "auto", path: str = "auto") -> ScenarioLosses:
    """ScenarioLosses by their Gram matrices, measured in float64, for scenes whose energies are quadratic in the drive.

    Raises:
        SceneError: see :class:`PlateSolver`, ``make_objectives`` and ``measure_response``.
    """
    panels, matrices, seconds, node_steps = [], [], 0.0, 0
    for one in scenarios:
        exact, gain = replace(one, scene=in_float64(one.scene)), np.tile(one.gain, 2)
        judge = make_objectives(exact.scene)
        for evaluator in _evaluators(exact, judge, device, path):
            solver = evaluator.solver
            matrices.append(measure_response(solver).matrices * np.outer(gain, gain))
            seconds, node_steps = seconds + solver.compile_seconds, node_steps + solver.node_steps
        panels.append(ScenarioPlates(one, judge))
    return ScenarioLosses(tuple(panels), np.concatenate(matrices), (seconds, node_steps))


def _losses_of_plates(panel: ScenarioPlates, designs: Designs) -> np.ndarray:
    own = in_scenario(designs, panel.scenario)
    return panel.objectives.losses(*(evaluator.run(own).energy for evaluator in panel.evaluators))


def _evaluators(
    one: Scenario, judge: Objectives, device: str, path: str, pool: WorkerPool | None = None, **options: Any
) -> tuple[Evaluator, ...]:
    common: dict[str, Any] = {"areas": judge.regions, "per_plate": one.per_plate, **options}
    made = make_evaluator(one.scene, device, path, pool, **common)
    if not judge.needs_displacement:
        return (made,)
    return made, make_evaluator(one.scene, device, path, pool, quantity="displacement", **common)

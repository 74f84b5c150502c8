"""Robust searches: every drive is judged by the same scenarios, and its loss is a measure of theirs.

    loss(position) = measure over s of loss of the panel s under gain_s · drive, its actuators off by offset_s

A batch holds plates × scenarios. The scenarios are drawn once, from ``search.robust.seed``: all particles of all
iterations meet the same ones, so that their losses can be compared, and a search that goes on from a checkpoint draws
them again. A scenario has its own stiffness and mass, which all plates of a launch share: so each scenario is a launch
of its own, of kernels compiled once for all. Where energies are quadratic forms of the drive, each scenario has Gram
matrices of its own instead, and one product of arrays holds all plates and all scenarios.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from warp_plate.plate.designs import Designs
from warp_plate.scene.model import Record, Scene
from warp_plate.scene.search import Robust
from warp_plate.search.scenarios import Scenario, kept_on_plate
from warp_plate.solve.response import Response, measure_response
from warp_plate.solve.solver import PlateSolver, Progress

# Plates × scenarios × regions whose energies are worked out at once from Gram matrices.
BLOCK = 2**22
# The worst part of all scenarios, whose mean stands in the report.
TAIL = 0.05


@dataclass(frozen=True)
class Panels:
    """The scenarios of a search, compiled: each has a solver, or all have Gram matrices.

    response: (scenarios · regions, 2M, 2M) energies of all scenarios, gains included, in the order of the scenarios;
    spent: seconds that compiling took, and node-steps, for what is not kept.
    """

    scenarios: tuple[Scenario, ...]
    solvers: tuple[PlateSolver, ...] = ()
    response: Response | None = None
    spent: tuple[float, int] = (0.0, 0)

    @property
    def node_steps(self) -> int:
        """Of all plates so far."""
        return self.spent[1] + sum(solver.node_steps for solver in self.solvers)

    @property
    def compile_seconds(self) -> float:
        """Of all solvers."""
        return self.spent[0] + sum(solver.compile_seconds for solver in self.solvers)

    def energies(self, designs: Designs) -> Iterator[np.ndarray]:
        """(plates, regions) energies [J] of one scenario after another."""
        if self.response is not None:
            count = len(self.scenarios)
            block = max(1, BLOCK // len(self.response.matrices))
            parts = [self.response.energy(designs.drives[at : at + block]) for at in range(0, len(designs), block)]
            whole = np.concatenate(parts).reshape(len(designs), count, -1)
            yield from whole.swapaxes(0, 1)
            return
        for scenario, solver in zip(self.scenarios, self.solvers, strict=True):
            yield solver.run(in_scenario(designs, scenario)).energy


def in_scenario(designs: Designs, scenario: Scenario) -> Designs:
    """What designs are on the panel of a scenario: its gains times their drives, places of their own off as well."""
    centre = designs.centre
    if centre is not None:
        areas = np.array([actuator.area for actuator in scenario.scene.actuators]).reshape(-1, 2, 2)
        half = np.diff(areas, axis=2)[..., 0] / 2
        centre = kept_on_plate(centre + scenario.offset, half, scenario.scene.plate.size)
    return replace(designs, drives=designs.drives * scenario.gain, centre=centre)


def solve_directly(scenarios: Sequence[Scenario], device: str = "auto", path: str = "auto") -> Panels:
    """Panels whose plates are simulated, a launch a scenario.

    Raises:
        SceneError: see :class:`PlateSolver`.
    """
    share = 1 / len(scenarios)
    solvers = (PlateSolver(one.scene, device, path, own=one.own, share=share) for one in scenarios)
    return Panels(tuple(scenarios), tuple(solvers))


def measure_scenarios(
    scenarios: Sequence[Scenario], device: str = "auto", path: str = "auto", progress: Progress | None = None
) -> Panels:
    """Panels by their Gram matrices, measured in float64, for scenes whose energies are quadratic in the drive.

    Args:
        progress: told (scenarios done, scenarios in all) after each.

    Raises:
        SceneError: see :class:`PlateSolver` and ``measure_response``.
    """
    matrices, seconds, node_steps = [], 0.0, 0
    for index, one in enumerate(scenarios):
        solver = PlateSolver(_in_float64(one.scene), device, path, own=one.own)
        gain = np.tile(one.gain, 2)
        matrices.append(measure_response(solver).matrices * np.outer(gain, gain))
        seconds, node_steps = seconds + solver.compile_seconds, node_steps + solver.node_steps
        if progress is not None:
            progress(index + 1, len(scenarios))
    return Panels(tuple(scenarios), response=Response(np.concatenate(matrices)), spent=(seconds, node_steps))


def measured(losses: np.ndarray, robust: Robust) -> np.ndarray:
    """(plates,) what a robust search makes small, of losses (plates, scenarios); NaN where any of a plate's is.

    A plate without energies on one panel is worse than any other: no measure looks past it.
    """
    failed = np.isnan(losses).any(axis=1)
    if robust.measure == "mean":
        found = losses.mean(axis=1)
    elif robust.measure == "worst":
        found = losses.max(axis=1)
    else:
        # No value between two scenarios' losses: one of them, the least that this part of them does not pass.
        found = np.quantile(losses, robust.quantile, axis=1, method="inverted_cdf")
    return np.where(failed, np.nan, found)


def worst_tail(losses: np.ndarray) -> np.ndarray:
    """(plates,) mean of the largest twentieth of losses (plates, scenarios), at least one of them."""
    count = max(1, int(np.ceil(TAIL * losses.shape[1] - 1e-9)))
    tail: np.ndarray = np.sort(losses, axis=1)[:, -count:].mean(axis=1)
    return tail


def _in_float64(scene: Scene) -> Scene:
    return scene.model_copy(update={"grid": scene.grid.model_copy(update={"precision": "float64"}), "record": Record()})

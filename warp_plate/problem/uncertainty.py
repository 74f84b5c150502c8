"""Scenarios of a robust search, variants of a scene within the tolerances of ``[search.robust]``, and losses over them.

Each scenario takes a row of numbers from 0 to 1, whatever the tolerances are: another tolerance leaves the other draws
as they were, and the first of many scenarios are the same panels as those of a few.

All plates of a launch share stiffness and mass, so each scenario is a separate launch of the same kernels. Where
energies are quadratic forms of the phasors, each scenario has Gram matrices instead, and one product of arrays covers
all plates and scenarios.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from warp_plate.cluster.evaluator import Evaluator
from warp_plate.cluster.pool import WorkerPool
from warp_plate.modal.solver import ModalSolver
from warp_plate.optimize.quadratic import quadratic_forms
from warp_plate.plate.designs import Designs, PerPlate, patch_ends, per_plate_of
from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.plate.scheme import make_scheme
from warp_plate.problem.objectives import Objectives, make_objectives
from warp_plate.resolve import Resolved
from warp_plate.scene.errors import SceneError, under
from warp_plate.scene.keys import resolved_key, value_of
from warp_plate.scene.model import WITHOUT_KEYS, Scene
from warp_plate.scene.search import Robust
from warp_plate.solve.response import Response, measure_response

# Memory of a scenario's scene and of each of its actuators [bytes].
SCENE_BYTES, ACTUATOR_BYTES = 20_000.0, 2_000.0
# Plates × matrices in a block for which energies are computed from Gram matrices.
MATRICES_AT_ONCE = 2**22


@dataclass(frozen=True)
class Scenario:
    """A panel within the tolerances."""

    scene: Scene  # scene with the panel's stiffness, thickness, damping, attached masses and places of actuators
    gain: np.ndarray  # (actuators,) factors of the drives
    offset: np.ndarray  # (actuators, 2) displacements of the actuators [m], as drawn; ``scene`` keeps them on the plate
    # what its solver is made for; the same for all scenarios of a scene, so that they share kernels
    per_plate: PerPlate

    def designs(self, designs: Designs) -> Designs:
        """Return the nominal designs on this panel: drives with its gains, and searched places with its offsets."""
        centre = None if designs.centre is None else _on_plate(self.scene, designs.centre + self.offset)
        return replace(designs, drives=designs.drives * self.gain, centre=centre)


def draw_scenarios(
    scene: Scene, count: int, seed: int, validation: bool = False, stepped: bool = True
) -> tuple[Scenario, ...]:
    """Draw scenarios of a scene with ``[search.robust]`` and a grid; the nominal scene is none of them.

    All have one time step: the scene's own where it is stable for each, else the one that the stiffest would choose;
    scenes that are not or cannot be stepped keep theirs. ``validation`` draws from another random stream. SceneError: a
    scenario is no plate or has no stable run, or they take more memory than there is.
    """
    robust, actuators = scene.search.robust, len(scene.actuators)
    if robust is None:
        raise SceneError("search.robust: is missing; without it there are no scenarios")
    what = f"search.robust: {count} scenarios of {actuators} actuators"
    refuse_beyond_memory(count * scenario_bytes(actuators), what)
    numbers = np.random.default_rng([seed, int(validation)]).random((count, 4 + 3 * actuators))
    varied = np.random.default_rng([seed, int(validation), 1]).random((count, len(robust.tolerance)))
    scenes = (_varied(scene, robust, row) for row in varied)
    with under("search.robust"):
        scenarios = [_scenario(some, robust, row) for some, row in zip(scenes, numbers, strict=True)]
    if not stepped or scene.modal_only_key is not None:
        return tuple(scenarios)
    step = _common_step(scene, scenarios)
    return tuple(replace(drawn, scene=drawn.scene.with_keys("grid", time_step=step)) for drawn in scenarios)


def scenario_bytes(actuators: int) -> float:
    """Return the bytes of a scenario's scene."""
    return SCENE_BYTES + ACTUATOR_BYTES * actuators


def _on_plate(scene: Scene, centre: np.ndarray) -> np.ndarray:
    """Return centres (..., actuators, 2) [m] of the actuators' patches, moved so that these lie on the plate."""
    half = np.ptp(patch_ends(scene.actuators), axis=2) / 2
    return np.clip(centre, half, np.maximum(np.asarray(scene.plate.size) - half, half))


def _varied(scene: Scene, robust: Robust, numbers: np.ndarray) -> Scene:
    """Return the scene with other values at the keys of ``tolerance``, for numbers (keys,) between 0 and 1."""
    if not robust.tolerance:
        return scene
    keys = {resolved_key(scene, name): part for name, part in robust.tolerance.items()}
    factors = [1 + part * (2 * number - 1) for part, number in zip(keys.values(), numbers.tolist(), strict=True)]
    return scene.with_values({key: value_of(scene, key) * factor for key, factor in zip(keys, factors, strict=True)})


def _scenario(scene: Scene, robust: Robust, numbers: np.ndarray) -> Scenario:
    """Return the scenario of numbers (4 + 3 · actuators,) between 0 and 1."""
    panel, gains, offsets = np.split(numbers, [4, 4 + len(scene.actuators)])
    tolerances = np.array([robust.young_modulus, robust.thickness, robust.damping])
    stiffness, thickness, damping = (1 + tolerances * (2 * panel[:3] - 1)).tolist()
    offset, plate = robust.place * (2 * offsets.reshape(-1, 2) - 1), scene.plate.model_dump()
    plate["young_modulus"] *= stiffness
    plate["thickness"] *= thickness
    effects = scene.effects.scaled(stiffness, thickness, damping)
    if panel[3] < robust.without_oscillators:
        effects |= scene.effects.without_attachments()
    variant = scene.with_tables(
        plate=plate,
        effects=effects,
        actuators=_moved_actuators(scene, offset),
        search={**scene.search.model_dump(), "robust": None},
        **WITHOUT_KEYS,
    )
    return Scenario(variant, 1 + robust.gain * (2 * gains - 1), offset, _per_plate(scene, robust.place))


def _moved_actuators(scene: Scene, offset: np.ndarray) -> list[dict[str, Any]]:
    """Return the tables of the actuators, each moved by its offset (actuators, 2) [m] and kept on the plate."""
    areas = patch_ends(scene.actuators)
    centre = areas.mean(axis=2)
    shift = _on_plate(scene, centre + offset) - centre
    # An actuator without offset keeps its place to the last bit.
    moved = np.where(offset[..., None] == 0, areas, areas + shift[..., None])
    tables = []
    for actuator, area, middle in zip(scene.actuators, moved, (centre + shift).tolist(), strict=True):
        shape = {"area": tuple(area.ravel().tolist())} if actuator.area is not None else actuator.placed(*middle)
        tables.append({**actuator.model_dump(), **shape})
    return tables


def _per_plate(scene: Scene, place: float) -> PerPlate:
    """Return the quantities that may differ between plates, with the actuators' areas wider by ``place`` [m]."""
    per_plate = per_plate_of(scene)
    if not place:
        return per_plate
    areas = np.array(per_plate.areas or [actuator.box for actuator in scene.actuators])
    wider = np.clip(areas + place * np.array([-1, 1, -1, 1]), 0, np.repeat(scene.plate.size, 2))
    return replace(per_plate, centre=True, areas=tuple(map(tuple, wider.tolist())))


def _common_step(scene: Scene, scenarios: list[Scenario]) -> float:
    """Return a time step [s] that is stable for all."""
    step, moment_form = scene.grid.time_step, per_plate_of(scene).per_actuator  # whose limit may differ
    scenes = (drawn.scene.with_keys("grid", time_step=None) for drawn in scenarios)
    schemes = [make_scheme(scene, moment_form=moment_form) for scene in scenes]
    if step is not None and step <= min(scheme.limit for scheme in schemes):
        return step
    return min(scheme.time_step for scheme in schemes)


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
    block: int = MATRICES_AT_ONCE

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
    """Return the measure (plates,) of losses (plates, scenarios); NaN where one of them is not finite."""
    failed = ~np.isfinite(losses).all(axis=1)
    finite = np.where(failed[:, None], 0.0, losses)
    if robust.measure == "quantile":
        # The least of the scenarios' losses that this part of them does not pass, not a value between two of them.
        measure = np.quantile(finite, robust.quantile, axis=1, method="inverted_cdf")
    else:
        measure = finite.mean(axis=1) if robust.measure == "mean" else finite.max(axis=1)
    return np.where(failed, np.nan, measure)


def make_scenario_losses(resolved: Resolved, robust: Robust, pool: WorkerPool | None, measured: bool) -> ScenarioLosses:
    """Return the losses over the scenarios of a robust search, by Gram matrices if ``measured``, else by simulation."""
    drawn = draw_scenarios(resolved.scene, robust.scenarios, robust.seed, stepped=not resolved.by_modes)
    return scenario_responses(drawn, resolved) if measured else simulate_scenarios(drawn, resolved, pool)


def simulate_scenarios(
    scenarios: Sequence[Scenario], resolved: Resolved, pool: WorkerPool | None = None
) -> ScenarioLosses:
    """Return losses by simulation, one launch for each scenario; all solvers together take the memory of one."""
    plates = (_scenario_plates(scenario, resolved, pool, 1 / len(scenarios)) for scenario in scenarios)
    return ScenarioLosses(tuple(plates))


def scenario_responses(scenarios: Sequence[Scenario], resolved: Resolved) -> ScenarioLosses:
    """Return losses by Gram matrices, measured in double precision, for energies that are quadratic in the phasors."""
    measured, matrices, seconds, node_steps = [], [], 0.0, 0
    for scenario in scenarios:
        gain = np.tile(scenario.gain, 2)
        plates = _scenario_plates(replace(scenario, scene=scenario.scene.in_float64()), resolved)
        for evaluator in plates.evaluators:
            solver = evaluator.solver
            response = solver.response if isinstance(solver, ModalSolver) else measure_response(solver)
            matrices.append(response.matrices * np.outer(gain, gain))
            seconds, node_steps = seconds + evaluator.compile_seconds, node_steps + evaluator.node_steps
        measured.append(ScenarioPlates(scenario, plates.objectives))
    return ScenarioLosses(tuple(measured), np.concatenate(matrices), (seconds, node_steps))


@under("search.robust")
def _scenario_plates(
    scenario: Scenario, resolved: Resolved, pool: WorkerPool | None = None, memory_share: float = 1.0
) -> ScenarioPlates:
    """Return the plates of one scenario, whose solvers together use a fraction of the memory for plates."""
    resolved = resolved.with_scene(scenario.scene)
    grid = resolved.grid_for(scenario.per_plate)
    objectives = make_objectives(grid)
    quantities = ("velocity", "displacement") if objectives.needs_displacement else ("velocity",)
    options = {"areas": objectives.regions, "memory_share": memory_share / len(quantities)}
    evaluators = [resolved.plates(grid, pool, **options, quantity=quantity) for quantity in quantities]
    return ScenarioPlates(scenario, objectives, tuple(evaluators))

"""Scenarios of a robust search: variants of a scene, drawn evenly within the tolerances of ``[search.robust]``.

Each scenario takes a row of numbers from 0 to 1, whatever the tolerances are: another tolerance leaves the other draws
as they were, and the first of many scenarios are the same panels as those of a few.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from warp_plate.plate.designs import Designs, PerPlate, per_plate_of
from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.plate.scheme import make_scheme
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.search import Robust

# Memory of a scenario's scene and of each of its actuators [bytes].
SCENE_BYTES, ACTUATOR_BYTES = 20_000.0, 2_000.0


@dataclass(frozen=True)
class Scenario:
    """A panel within the tolerances.

    Attributes:
        scene: scene with the panel's stiffness, thickness, damping, attached masses and places of actuators.
        gain: (actuators,) factors of the drives.
        offset: (actuators, 2) displacements of the actuators along x and y [m], as drawn; ``scene`` keeps them on the
            plate.
        per_plate: what its solver is made for; the same for all scenarios of a scene, so that they share kernels
            wherever their actuators are.
    """

    scene: Scene
    gain: np.ndarray
    offset: np.ndarray
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
    scenes that are not or cannot be stepped keep theirs. ``validation`` draws from another random stream.

    Raises:
        SceneError: a scenario is no plate, or has no stable run; they take more memory than there is.
    """
    robust, actuators = scene.search.robust, len(scene.actuators)
    if robust is None:
        raise SceneError("search.robust: is missing; without it there are no scenarios")
    what = f"search.robust: {count} scenarios of {actuators} actuators"
    refuse_beyond_memory(count * (SCENE_BYTES + ACTUATOR_BYTES * actuators), what)
    numbers = np.random.default_rng([seed, int(validation)]).random((count, 4 + 3 * actuators))
    scenarios = [_scenario(scene, robust, row) for row in numbers]
    if not stepped or scene.modal_only_key is not None:
        return tuple(scenarios)
    grid = scene.grid.model_copy(update={"time_step": _common_step(scene, scenarios)})
    return tuple(replace(drawn, scene=drawn.scene.model_copy(update={"grid": grid})) for drawn in scenarios)


def _patches(scene: Scene) -> np.ndarray:
    """Return the ends (actuators, axis, 2) of the actuators' patches [m]."""
    return np.array([actuator.area for actuator in scene.actuators]).reshape(-1, 2, 2)


def _on_plate(scene: Scene, centre: np.ndarray) -> np.ndarray:
    """Return centres (..., actuators, 2) [m] of the actuators' patches, moved so that these lie on the plate."""
    half = np.diff(_patches(scene), axis=2)[..., 0] / 2
    return np.clip(centre, half, np.maximum(np.asarray(scene.plate.size) - half, half))


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
    )
    return Scenario(variant, 1 + robust.gain * (2 * gains - 1), offset, _per_plate(scene, robust.place))


def _moved_actuators(scene: Scene, offset: np.ndarray) -> list[dict[str, Any]]:
    """Return the tables of the actuators, each moved by its offset (actuators, 2) [m] and kept on the plate."""
    areas = _patches(scene)
    centre = areas.mean(axis=2)
    shift = _on_plate(scene, centre + offset) - centre
    # An actuator without offset keeps its place to the last bit.
    moved = np.where(offset[..., None] == 0, areas, areas + shift[..., None])
    pairs = zip(scene.actuators, moved, strict=True)
    return [{**actuator.model_dump(), "area": tuple(area.ravel().tolist())} for actuator, area in pairs]


def _per_plate(scene: Scene, place: float) -> PerPlate:
    """Return the quantities that may differ between plates, with each actuator's area wider by ``place`` [m] on all
    sides."""
    per_plate = per_plate_of(scene)
    if not place:
        return per_plate
    areas = np.array(per_plate.areas or [actuator.area for actuator in scene.actuators])
    wider = np.clip(areas + place * np.array([-1, 1, -1, 1]), 0, np.repeat(scene.plate.size, 2))
    return replace(per_plate, centre=True, areas=tuple(map(tuple, wider.tolist())))


def _common_step(scene: Scene, scenarios: list[Scenario]) -> float:
    """Return a time step [s] that is stable for all."""
    update, step = {"grid": scene.grid.model_copy(update={"time_step": None})}, scene.grid.time_step
    moment_form = per_plate_of(scene).per_actuator  # whose limit may differ
    schemes = [make_scheme(drawn.scene.model_copy(update=update), moment_form=moment_form) for drawn in scenarios]
    if step is not None and step <= min(scheme.limit for scheme in schemes):
        return step
    return min(scheme.time_step for scheme in schemes)

"""The panels that one may really have: variants of a scene, drawn evenly within the tolerances of ``[search.robust]``.

Each scenario takes a row of numbers from 0 to 1, whatever the tolerances are: a tolerance more leaves what the others
draw as it was, and the first of many scenarios are the same panels as those of a few.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from warp_plate.plate.designs import PerPlate, per_plate_of
from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.plate.scheme import make_scheme
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.search import Robust

# Bytes that a scenario's scene takes, and each of its actuators.
SCENE_BYTES, ACTUATOR_BYTES = 20_000.0, 2_000.0


@dataclass(frozen=True)
class Scenario:
    """One panel.

    scene: with its stiffness, thickness, damping, oscillators and actuators where they are; gain: (actuators,) by which
    drives are multiplied; offset: (actuators, 2) x, y by which actuators are off [m], as drawn: ``scene`` keeps them on
    the plate. per_plate: what its solver is made for, the same for all scenarios of a scene, so that they share kernels
    wherever their actuators are.
    """

    scene: Scene
    gain: np.ndarray
    offset: np.ndarray
    per_plate: PerPlate


def draw_scenarios(scene: Scene, count: int, seed: int, validation: bool = False) -> tuple[Scenario, ...]:
    """So many scenarios of a scene with ``[search.robust]`` and a grid; the nominal scene is none of them.

    The same seed draws the same scenarios; ``validation``: from another stream, which shares nothing with the first.
    All
    have one time step: the scene's own where it is stable for each, else the one that the stiffest would choose.

    Raises:
        SceneError: a scenario is no plate, or has no stable run; they take more memory than there is.
    """
    robust = scene.search.robust
    if robust is None:
        raise SceneError("search.robust: is missing; without it there are no scenarios")
    actuators = len(scene.actuators)
    refuse_beyond_memory(
        count * (SCENE_BYTES + ACTUATOR_BYTES * actuators), f"search.robust: {count} scenarios of {actuators} actuators"
    )
    numbers = np.random.default_rng([seed, int(validation)]).random((count, 4 + 3 * actuators))
    drawn = [_scenario(scene, robust, row) for row in numbers]
    step = _common_step(scene, drawn)
    grid = scene.grid.model_copy(update={"time_step": step})
    return tuple(replace(one, scene=one.scene.model_copy(update={"grid": grid})) for one in drawn)


def kept_on_plate(centre: np.ndarray, half: np.ndarray, size: tuple[float, float]) -> np.ndarray:
    """Middles (..., actuators, 2) of patches [m], moved so that they lie on the plate; ``half``: (actuators, 2) [m] of
    their sides."""
    return np.clip(centre, half, np.maximum(np.asarray(size) - half, half))


def _scenario(scene: Scene, robust: Robust, numbers: np.ndarray) -> Scenario:
    """From (4 + 3 · actuators,) numbers between 0 and 1."""
    panel, gains, offsets = np.split(numbers, [4, 4 + len(scene.actuators)])
    tolerances = np.array([robust.young_modulus, robust.thickness, robust.damping])
    stiffer, thicker, damped = (1 + tolerances * (2 * panel[:3] - 1)).tolist()
    offset = robust.place * (2 * offsets.reshape(-1, 2) - 1)
    made = scene.with_tables(
        plate={
            **scene.plate.model_dump(),
            "young_modulus": scene.plate.young_modulus * stiffer,
            "thickness": scene.plate.thickness * thicker,
        },
        effects=_effects(scene, stiffer, thicker, damped, bool(panel[3] < robust.without_oscillators)),
        actuators=_moved(scene, offset),
        search={**scene.search.model_dump(), "robust": None},
    )
    return Scenario(made, 1 + robust.gain * (2 * gains - 1), offset, _own(scene, robust.place))


def _effects(scene: Scene, stiffer: float, thicker: float, damped: float, bare: bool) -> dict[str, Any]:
    """The table ``[effects]``; one factor for all damping of the panel, what hangs on it keeps its own."""
    tables = scene.effects.model_dump()
    for table, key in (("damping", "viscous"), ("material_damping", "time"), ("foundation", "damping")):
        if tables[table] is not None:
            tables[table][key] *= damped
    if tables["orthotropic"] is not None:  # rigidities in place of EH³
        tables["orthotropic"] = {key: value * stiffer * thicker**3 for key, value in tables["orthotropic"].items()}
    if bare:
        tables["oscillators"] = ()
    return tables


def _moved(scene: Scene, offset: np.ndarray) -> list[dict[str, Any]]:
    """The tables of the actuators, each moved by its offset (actuators, 2) [m] and kept on the plate."""
    areas = np.array([actuator.area for actuator in scene.actuators]).reshape(-1, 2, 2)  # (actuators, axis, end)
    centre, half = areas.mean(axis=2), np.diff(areas, axis=2)[..., 0] / 2
    shift = kept_on_plate(centre + offset, half, scene.plate.size) - centre
    # What does not move keeps its place to the last bit.
    moved = np.where(offset[..., None] == 0, areas, areas + shift[..., None])
    return [
        {**actuator.model_dump(), "area": tuple(area.ravel().tolist())}
        for actuator, area in zip(scene.actuators, moved, strict=True)
    ]


def _own(scene: Scene, place: float) -> PerPlate:
    """What plates have of their own, each actuator's area being wider by ``place`` [m] on all sides."""
    per_plate = per_plate_of(scene)
    if not place:
        return per_plate
    areas = np.array(per_plate.areas or [actuator.area for actuator in scene.actuators])
    wider = np.clip(areas + place * np.array([-1, 1, -1, 1]), 0, np.repeat(scene.plate.size, 2))
    return replace(per_plate, centre=True, areas=tuple(map(tuple, wider.tolist())))


def _common_step(scene: Scene, drawn: list[Scenario]) -> float:
    """A time step [s] that is stable for all."""
    free = scene.grid.model_copy(update={"time_step": None})
    moment_form = per_plate_of(scene).per_actuator  # whose limit may be another
    schemes = [make_scheme(one.scene.model_copy(update={"grid": free}), moment_form=moment_form) for one in drawn]
    own = scene.grid.time_step
    if own is not None and own <= min(scheme.limit for scheme in schemes):
        return own
    return min(scheme.time_step for scheme in schemes)

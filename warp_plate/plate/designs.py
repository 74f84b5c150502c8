"""Values that may differ from plate to plate in one batch, and scenes with other values of their actuators."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_plate.plate.signals import actuator_delays, actuator_frequencies, plate_harmonic, waves_apart
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import SMALLEST, Area
from warp_plate.scene.model import Scene
from warp_plate.scene.target import PlateRegion

# Part of the plate's side by which rounding may take an actuator over the border of its area.
SLACK = 1e-9


@dataclass(frozen=True)
class Designs:
    """Drives of plates and all other values that differ between them; None: as in the scene."""

    drives: np.ndarray  # (plates, actuators) complex phasors Z [N/m², or V: ``Scene.drive_unit``]
    frequency: np.ndarray | None = None  # (plates, actuators) [Hz]
    centre: np.ndarray | None = None  # (plates, actuators, 2) x, y of the actuators' centres [m]
    delay: np.ndarray | None = None  # (plates, actuators) start of the burst [s]

    def __len__(self) -> int:
        return len(self.drives)

    def __getitem__(self, rows: slice) -> Designs:
        others = (None if values is None else values[rows] for values in (self.frequency, self.centre, self.delay))
        return Designs(self.drives[rows], *others)

    @property
    def only_drives(self) -> bool:
        """True if plates differ in nothing but their drives, so that superposition holds between them."""
        return self.frequency is None and self.centre is None and self.delay is None


@dataclass(frozen=True)
class PerPlate:
    """Quantities that may differ between the plates of a solver besides their drives; kernels are compiled for them."""

    frequency: bool = False  # Plates may differ in frequency
    delay: bool = False  # Plates may differ in the start of the burst
    centre: bool = False  # Plates may differ in the places of their actuators
    # Frequency and delay differ between a plate's actuators too, which takes two waves for each and the moment form
    per_actuator: bool = False
    # (x0, x1, y0, y1) [m] of each actuator, within which it stays whole (default: the plate)
    areas: tuple[Area, ...] | None = None


NO_PER_PLATE = PerPlate()


def per_plate_of(scene: Scene) -> PerPlate:
    """Return the quantities that differ between plates of the scene's ``[search]``."""
    search, position, areas = scene.search, scene.search.position, None
    if position is not None:
        area = position.area or scene.plate.box
        moved = [actuator.name in (position.actuators or [actuator.name]) for actuator in scene.actuators]
        areas = tuple(area if moves else actuator.box for moves, actuator in zip(moved, scene.actuators, strict=True))
    searched = [table for table in (search.frequency, search.delay) if table is not None]
    return PerPlate(
        frequency=search.frequency is not None,
        delay=search.delay is not None,
        centre=position is not None,
        per_actuator=any(table.own or table.actuators is not None for table in searched),
        areas=areas,
    )


def carriers_of(scene: Scene, per_plate: PerPlate, by_modes: bool = True) -> int:
    """Return the number of separate carriers of each plate, 0, 1 or one an actuator; SceneError: the scene has no
    carrier or burst that could differ, or a load that cannot be moved."""
    if per_plate.centre and scene.grid.load == "nodes":
        raise SceneError(
            'grid.load = "nodes": actuators would jump from node to node; to move them write "overlap" or "moments"'
        )
    if per_plate.centre and not by_modes and (moved := [row for row in scene.actuators if row.area is None]):
        raise SceneError(
            f"search.position: in time steps only actuators with area move, and {moved[0].name!r} has "
            f"{moved[0].description}; leave out grid.nodes, or search by modes (--evaluator modal)"
        )
    if per_plate.centre and scene.piezo:
        raise SceneError('actuators: piezo patches (kind = "piezo") cannot be moved from plate to plate')
    if per_plate.areas is not None and len(per_plate.areas) != len(scene.actuators):
        raise SceneError(f"per_plate.areas: {len(per_plate.areas)} instead of {len(scene.actuators)}, one an actuator")
    if per_plate.delay and scene.drive.burst is None:
        raise SceneError("drive.burst: missing; only a burst can be delayed")
    if not (per_plate.frequency or per_plate.delay):
        return 0
    if scene.drive.signal is not None:
        raise SceneError("drive.signal: a file has no frequency or burst that differs from plate to plate; delete it")
    return len(scene.actuators) if per_plate.per_actuator or waves_apart(scene) > 1 else 1


@dataclass(frozen=True)
class PerPlateValues:
    """Checked designs in the form that kernels use; None for values that all plates share."""

    frequency: np.ndarray | None = None  # (plates, carriers) [Hz]
    delay: np.ndarray | None = None  # (plates, carriers) start of the burst [s]
    edges: np.ndarray | None = None  # (plates, actuators, 4) x0, x1, y0, y1 of the actuators [m]

    def __getitem__(self, rows: slice) -> PerPlateValues:
        arrays = (self.frequency, self.delay, self.edges)
        return PerPlateValues(*(None if values is None else values[rows] for values in arrays))


def check_designs(designs: Designs, scene: Scene, per_plate: PerPlate, time_step: float) -> PerPlateValues:
    """Check designs that differ in more than drives for a solver that was made for ``per_plate``.

    Raises:
        SceneError: The solver was not made for them, or they have a wrong shape, frequency, delay or place.
    """
    shape = (len(designs), len(scene.actuators))
    given: dict[str, np.ndarray] = {}
    for name, more in (("frequency", ()), ("delay", ()), ("centre", (2,))):
        values = getattr(designs, name)
        if values is None:
            continue
        if not getattr(per_plate, name):
            raise SceneError(f"designs.{name}: not enabled for this solver; make it with PerPlate({name}=True)")
        given[name] = np.asarray(values, dtype=float)
        if given[name].shape != (*shape, *more):
            raise SceneError(f"designs.{name}: shape {given[name].shape} instead of {(*shape, *more)}")
    edges = _edges(scene, per_plate, given.pop("centre")) if "centre" in given else None
    if given:
        given.setdefault("frequency", np.broadcast_to(actuator_frequencies(scene), shape))
        if scene.drive.burst is not None:
            given.setdefault("delay", np.broadcast_to(actuator_delays(scene), shape))
        carriers, end = carriers_of(scene, per_plate), scene.window.end
        most = 0.5 / time_step / plate_harmonic(scene.drive)
        for name, above, limit, right in (
            ("frequency", np.greater, most, f"0 ... {most:.6g} Hz"),
            ("delay", np.greater_equal, end, f"0 ... {end:g} s"),
        ):
            if (values := given.get(name)) is not None:
                _refuse_unless(scene, name, values, above(values, 0) & (values < limit), right)
                if carriers == 1:
                    right = "one value for all actuators, or a solver with PerPlate(per_actuator=True)"
                    _refuse_unless(scene, name, values, values == values[:, :1], right)
                given[name] = values[:, :carriers]
    return PerPlateValues(given.get("frequency"), given.get("delay"), edges)


def actuator_spaces(scene: Scene, per_plate: PerPlate) -> np.ndarray:
    """Return (actuators, 4) x0, x1, y0, y1 [m] of the part of the plate within which each actuator stays whole."""
    spaces = np.array(per_plate.areas if per_plate.areas is not None else [scene.plate.box] * len(scene.actuators))
    return np.clip(spaces, 0, np.repeat(scene.plate.size, 2))


def _edges(scene: Scene, per_plate: PerPlate, centre: np.ndarray) -> np.ndarray:
    """Return (plates, actuators, 4) rectangles of actuators around other centres."""
    half = np.ptp(patch_ends(scene.actuators), axis=2) / 2
    low, high = centre - half, centre + half
    spaces, slack = actuator_spaces(scene, per_plate), SLACK * np.array(scene.plate.size)
    inside: Any = ((low >= spaces[:, [0, 2]] - slack) & (high <= spaces[:, [1, 3]] + slack)).all(axis=-1)
    _refuse_unless(scene, "centre", centre, inside, "a place where the actuator stays whole within its area")
    return np.stack([low[..., 0], high[..., 0], low[..., 1], high[..., 1]], axis=-1)


def _refuse_unless(scene: Scene, name: str, values: np.ndarray, good: Any, right: str) -> None:
    """Refuse values (plates, actuators, ...), naming the first that is not good (plates, actuators)."""
    if not np.all(good):
        plate, actuator = np.argwhere(~good)[0]
        raise SceneError(
            f"designs.{name}: {np.round(values[plate, actuator], 9).tolist()} of actuator "
            f"{scene.actuators[actuator].name!r} on plate {plate}; must be {right}"
        )


def as_phasors(drives: object, actuators: int) -> np.ndarray:
    """Return (plates, actuators) complex phasors of phasors or (magnitude, phase); SceneError: they have no such
    shape."""
    try:
        if isinstance(drives, tuple) and len(drives) == 2:
            magnitude, phase = (as_numbers(part, "biuf") for part in drives)
            with np.errstate(invalid="ignore"):  # a drive that is not finite affects only its own plate
                phasors = magnitude * np.exp(-1j * phase)
        else:
            phasors = as_numbers(drives, "biufc").astype(complex, copy=False)
    except (TypeError, ValueError) as error:
        raise SceneError(f"drives: not an array of numbers ({error})") from None
    if phasors.ndim != 2 or phasors.shape[1] != actuators:
        raise SceneError(f"drives: shape {phasors.shape} instead of (plates, {actuators}), one column an actuator")
    return phasors


def as_numbers(values: object, kinds: str) -> np.ndarray:
    """Return an array of one of NumPy's kinds; TypeError for texts, dates and masked values."""
    array = np.asarray(values)
    if array.size and (array.dtype.kind not in kinds or np.ma.is_masked(values)):
        raise TypeError(f"{array.dtype}{', masked' if np.ma.is_masked(values) else ''}")
    return array


def scene_with(
    scene: Scene,
    magnitude: np.ndarray | None = None,
    phase: np.ndarray | None = None,
    frequency: np.ndarray | None = None,
    centre: np.ndarray | None = None,
    delay: np.ndarray | None = None,
) -> Scene:
    """Return a scene with other values (actuators,) of its actuators (default: the scene's): magnitudes [N/m², or V],
    phase lags [rad], frequencies [Hz], centres (actuators, 2) [m] and starts of the bursts [s].

    Forces stay forces. A frequency or delay that all actuators share becomes the drive's own. SceneError: no scene may
    have such numbers, for example a magnitude beyond 1e30.
    """
    actuators: list[dict[str, Any]] = [actuator.model_dump() for actuator in scene.actuators]
    drive = scene.drive.model_dump()
    burst: Any = drive.get("burst")  # none of a soft start
    if magnitude is not None:
        magnitude = magnitude * [actuator.amplitude_area for actuator in scene.actuators]
    keys = [actuator.amplitude_key for actuator in scene.actuators]
    for names, values in ((keys, magnitude), (["phase"] * len(keys), phase)):
        if values is not None:
            for actuator, name, value in zip(actuators, names, values.tolist(), strict=True):
                actuator[name] = value if abs(value) >= SMALLEST else 0.0
    for name, values, table, key in (
        ("frequency", frequency, drive, "frequency"),
        ("delay", delay, burst, "start"),
    ):
        if values is None:
            continue
        shared = table is not None and bool((values == values[0]).all())
        if shared:
            table[key] = float(values[0])
        for actuator, value in zip(actuators, values.tolist(), strict=True):
            actuator[name] = None if shared else value
    if centre is not None:
        for actuator, patch, (x, y) in zip(actuators, scene.actuators, centre.tolist(), strict=True):
            actuator |= patch.placed(x, y)
    return scene.with_tables(drive=drive, actuators=actuators)


def scene_phasors(scene: Scene) -> np.ndarray:
    """Return (actuators,) phasors of the actuators' magnitudes and phases."""
    magnitude = np.array([actuator.magnitude for actuator in scene.actuators])
    phase = np.array([actuator.phase for actuator in scene.actuators])
    phasors: np.ndarray = magnitude * np.exp(-1j * phase)
    return phasors


def patch_ends(patches: Sequence[PlateRegion]) -> np.ndarray:
    """Return (patches, 2, 2) ends along x and along y of actuators' patches or other regions [m]."""
    return np.array([patch.box for patch in patches]).reshape(-1, 2, 2)

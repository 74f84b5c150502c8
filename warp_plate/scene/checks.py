"""Checks of the tables of a scene against each other. Each raises a ValueError that names the key at fault."""

from __future__ import annotations

from collections.abc import Sequence

from warp_plate.effects.table import check_modal_tables
from warp_plate.scene.actuator import Actuator
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import Area, check_area
from warp_plate.scene.keys import resolved_key, scalar_keys
from warp_plate.scene.tables import SceneTables
from warp_plate.scene.target import NamedTarget

# Tables with properties of the panel, which a fit may change.
PANEL = ("plate", "edges", "effects", "actuators", "measurement")


def check_tables(scene: SceneTables) -> None:
    """Check that the tables of a scene fit together."""
    actuators, size = scene.actuators, scene.plate.size
    _check_areas(scene)
    _check_names("actuators", actuators)
    for key, target in scene.targets_by_key.items():
        target.check(key, size)
    _check_names("targets", scene.targets)
    if scene.targets and scene.target not in [target.unnamed for target in scene.targets]:
        raise ValueError("target: there are [[targets]] too, and it is none of them; write one of the two")
    for index, layer in enumerate(scene.effects.layers):
        scene.plate.check_thin(layer.thickness, f"effects.layers[{index}].thickness: ")
    _check_piezo(scene)
    _check_drive(scene)
    drives = ("burst", "chirp", "signal", "electrostatic")
    check_modal_tables(scene.effects, {f"drive.{name}": getattr(scene.drive, name) for name in drives})
    scene.search.check_limits([actuator.name for actuator in actuators])
    if scene.search.robust is not None:
        scene.search.robust.check(scene.effects, scene.grid.load)
        if len(scene.targets) > 1:
            raise ValueError("search.robust: not with several [[targets]]; write a scene for each target")
    _check_measurements(scene)
    if scene.fit is not None:
        _check_free_keys(scene, list(scene.fit.free))
    _check_focus(scene)
    for index, time in enumerate(scene.record.times):
        if time > scene.window.end * (1 + 1e-9):
            limit = f"window.end = {scene.window.end:g} s"
            raise ValueError(f"record.times[{index}]: {time:g} s is after the run, {limit}")
    for index, point in enumerate(scene.record.points):
        scene.plate.check_point(f"record.points[{index}]", point)


def _check_areas(scene: SceneTables) -> None:
    areas: dict[str, Area] = {
        f"actuators[{index}].area ({row.name!r})": row.area for index, row in enumerate(scene.actuators)
    }
    if scene.search.position is not None and scene.search.position.area is not None:
        areas["search.position.area"] = scene.search.position.area
    for key, area in (areas | scene.effects.areas).items():
        check_area(key, area, scene.plate.size)


def _check_names(table: str, rows: Sequence[Actuator | NamedTarget]) -> None:
    names = [row.name for row in rows]
    for index, name in enumerate(names):
        if name in names[:index]:
            raise ValueError(f"{table}[{index}].name: {name!r} is taken; give each {table.removesuffix('s')} its own")


def _check_piezo(scene: SceneTables) -> None:
    """Check that a scene with piezo patches has nothing that these exclude."""
    if not scene.piezo:
        return
    for index, actuator in enumerate(scene.actuators):
        if actuator.thickness is None:
            raise ValueError(f'actuators[{index}].kind: "pressure" beside "piezo"; all must be of one kind')
        scene.plate.check_thin(actuator.thickness, f"actuators[{index}].thickness: ")
    tables = {"drive.electrostatic": scene.drive.electrostatic, "search.position": scene.search.position}
    excluded = [key for key, table in tables.items() if table is not None]
    excluded += [key for key in scene.effects.section_keys if not key.endswith(".density")]
    if excluded:
        raise ValueError(f"{excluded[0]}: not with piezo patches; delete it")


def _check_drive(scene: SceneTables) -> None:
    """Check the actuators and the burst against the drive and the end of the run."""
    drive, end = scene.drive, scene.window.end
    after = f"s is after the run, which ends at window.end = {end:g} s"
    for index, actuator in enumerate(scene.actuators):
        key, delay = f"actuators[{index}]", actuator.delay
        if delay is not None and drive.burst is None:
            raise ValueError(f"{key}.delay: there is no burst to delay; write [drive.burst], or delete the delay")
        if delay is not None and delay >= end:
            raise ValueError(f"{key}.delay: {delay:g} {after}")
        if actuator.frequency is not None and drive.signal is not None:
            raise ValueError(f"{key}.frequency: drive.signal replaces the carrier of all actuators; delete one of them")
        if actuator.force is not None and drive.electrostatic is not None:
            raise ValueError(f"{key}.force: {actuator.force:g} N, but drive.electrostatic takes volts; write magnitude")
    if drive.burst is not None and drive.burst.start >= end:
        raise ValueError(f"drive.burst.start: {drive.burst.start:g} {after}")


def _check_measurements(scene: SceneTables) -> None:
    names = [actuator.name for actuator in scene.actuators]
    for index, row in enumerate(scene.measurement):
        if row.actuator is not None and row.actuator not in names:
            raise ValueError(f"measurement[{index}].actuator: {row.actuator!r} is not one of {', '.join(names)}")
        for name, point in {"point": row.point, "force_at": row.force_at}.items():
            if point is not None:
                scene.plate.check_point(f"measurement[{index}].{name}", point)


def _check_focus(scene: SceneTables) -> None:
    """Check that the points of a focus lie on the plate and that its waveforms are not too many."""
    if (focus := scene.focus) is None:
        return
    for index, point in enumerate(focus.points):
        scene.plate.check_point(f"focus.points[{index}]", point)
    if focus.rest is not None and focus.rest.radius > min(scene.plate.size) / 2:
        raise ValueError(f"focus.rest.radius: {focus.rest.radius:g} m is above half of a side of the plate")
    focus.check_numbers(focus.samples, len(scene.actuators), "time")


def _check_free_keys(scene: SceneTables, names: Sequence[str]) -> None:
    """Check that the free keys of a fit are different numbers of the scene's panel."""
    kinds, keys = scalar_keys(scene), set()
    for name in names:
        try:
            key = resolved_key(scene, name, kinds)
        except SceneError as error:
            raise ValueError(f"fit.free: {error}") from None
        if kinds[key] is not float or not key.startswith(PANEL):
            raise ValueError(f"fit.free: {name}: is no real number of the panel ({', '.join(PANEL)})")
        if key in keys:
            raise ValueError(f"fit.free: {name}: is there twice")
        keys.add(key)

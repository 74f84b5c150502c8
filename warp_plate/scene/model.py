"""The scene: its tables, checked, how it is read and written, and what follows from them."""

from __future__ import annotations

import math
import operator
from collections.abc import Iterable, Mapping, Sequence
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import PrivateAttr, ValidationError, model_validator

from warp_plate.effects.layers import check_layers
from warp_plate.effects.table import check_modal_tables
from warp_plate.scene.actuator import Actuator
from warp_plate.scene.errors import SceneError, check_type, under
from warp_plate.scene.explain_errors import explain_error
from warp_plate.scene.fields import Area, check_area
from warp_plate.scene.grid import Grid, grid_by_waves
from warp_plate.scene.keys import (
    ALTERNATIVES,
    PANEL,
    assign,
    check_links,
    key_parts,
    linked_keys,
    put,
    resolved_key,
    scalar_keys,
    value_of,
)
from warp_plate.scene.load import dump_toml, parse_toml, read_scene_text
from warp_plate.scene.outline import with_drawing
from warp_plate.scene.tables import SceneTables
from warp_plate.scene.target import NamedTarget, PlateRegion, Target

# Largest angle above π of a corner whose edges may be supported [rad].
REENTRANT = 0.01
# Points of a support's curve that must be on the plate.
SUPPORT_SAMPLES = 129
# Tables whose numbers have tolerances: in a specification, whose frequency is its own, and in a search.
VARIED = (*PANEL, "target.", "targets[")
SEARCHED = (*VARIED, "drive.", "window.")
# Tables that name keys, left out of variants in which these may be absent or no longer equal.
WITHOUT_KEYS: dict[str, Any] = {"links": {}, "specification": None, "fit": None, "design": None}


class Scene(SceneTables):
    """The complete input of a run, in SI units; read one with :meth:`load`.

    If the scene has several ``targets``, ``target`` is one of them, by default the first.
    """

    _folder: Path | None = PrivateAttr(default=None)

    @staticmethod
    def load(source: SceneSource, assignments: Sequence[str] = ()) -> Scene:
        """Return the scene of a preset's name or of a TOML file, or raise a SceneError that names what is wrong.

        A scene is returned unchanged. Of ``assignments`` each puts a value into a file's tables: ``KEY=VALUE``, see
        :func:`warp_plate.scene.keys.assign`.
        """
        if isinstance(source, Scene):
            return source
        check_type("scene", source, Scene, str, Path)
        text, folder = read_scene_text(source)
        return Scene.parse(text, str(source), assignments, folder).in_folder(folder)

    @staticmethod
    def parse(text: str, name: str, assignments: Sequence[str] = (), folder: Path | None = None) -> Scene:
        """Return the scene of a TOML text, or raise a SceneError that begins with ``name``; see :meth:`load`.

        An outline is read from a file in ``folder``.
        """
        check_type("text", text, str)
        tables = parse_toml(text, name)
        assign(tables, assignments)
        with under(name):
            return Scene.from_tables(with_drawing(tables, folder))

    @staticmethod
    def from_tables(tables: Mapping[str, Any]) -> Scene:
        """Return the scene of tables by their names, or raise a SceneError if a key is unknown or wrong."""
        try:
            return Scene.model_validate(tables)
        except ValidationError as error:
            raise SceneError(explain_error(error, Scene)) from None

    @model_validator(mode="before")
    @classmethod
    def _default_target(cls, tables: Any) -> Any:
        if not isinstance(tables, dict) or "target" in tables or not tables.get("targets"):
            return tables
        try:
            first = NamedTarget.model_validate(tables["targets"][0]).unnamed
        except (ValidationError, LookupError, TypeError):  # reported by the validation of ``targets``
            first = Target(area=(0.0, 1.0, 0.0, 1.0))
        return {**tables, "target": first}

    @model_validator(mode="after")
    def _default_grid(self) -> Scene:
        """Choose the grid of a nonlinear scene, for which no error is known, by its bending waves."""
        if self.gridded_by_waves:
            plate, drive = self.plate, self.drive
            frequencies = [drive.frequency, *(actuator.frequency or 0.0 for actuator in self.actuators)]
            frequencies.append(drive.chirp.end_frequency if drive.chirp else 0.0)
            highest = max(frequencies) * (2 if drive.electrostatic else 1)  # a squared voltage has twice the frequency
            self._derive("grid", grid_by_waves(plate.size, math.sqrt(2 * math.pi * plate.kappa / highest)))
        return self

    @model_validator(mode="after")
    def _default_edge(self) -> Scene:
        self.edges.check(self.plate.outline is not None)
        if self.plate.outline is not None and self.edges.outline is None:
            self._derive("edges", self.edges.model_copy(update={"outline": "clamped"}))
        return self

    @model_validator(mode="after")
    def _tables_fit_together(self) -> Scene:
        _check_tables(self)
        return self

    def aimed_at(self, index: int) -> Scene:
        """Return the scene with another one of its ``targets`` as ``target``."""
        return self.model_copy(update={"target": self.targets[index].unnamed})

    @property
    def folder(self) -> Path | None:
        """Folder of the files that the scene names; None without files, or if it was not read from a file."""
        return self._folder

    def in_folder(self, folder: Path | None) -> Scene:
        """Return the scene with the folder of the files that it names; None if it names no files."""
        folder = folder if self.named_files else None
        if folder == self._folder:
            return self
        scene = self.model_copy()
        scene._folder = folder
        return scene

    def with_tables(self, **tables: Any) -> Scene:
        """Return the scene with some tables replaced, or raise a SceneError if they do not fit together."""
        # A grid with an accuracy must have no other keys; a grid that was not written stays unwritten.
        grid = {"grid": self.grid} if self.grid.accuracy is not None else {}
        unwritten = {"grid"} - self.model_fields_set
        present = {key: table for key, table in {**self.model_dump(), **grid}.items() if key not in unwritten}
        return Scene.from_tables({**present, **tables}).in_folder(self._folder)

    def with_accuracy(self, accuracy: float) -> Scene:
        """Return the scene with an accuracy in place of its grid, or raise a SceneError if it is out of range."""
        try:
            return self.model_copy(update={"grid": Grid(accuracy=accuracy)})
        except SceneError as error:
            raise SceneError(f"grid.{error}") from None

    def replace(self, key: str, value: Any) -> Scene:
        """Return the scene with another value or table at a key, or raise a SceneError if one of them is wrong.

            >>> scene = Scene.load("paper").replace("drive.frequency", 300)
            >>> scene = scene.replace("actuators.lower left.area", (0.03, 0.04, 0.03, 0.04))
            >>> scene.replace("effects.damping", {"viscous": 50}).effects.damping.viscous
            50.0

        Keys and what they exclude are those of ``--set``; the value None removes a table.
        """
        tables = self._tables()
        put(tables, key, value, key)
        if "grid" not in self.model_fields_set and not key.startswith("grid"):
            del tables["grid"]
        return Scene.from_tables(tables).in_folder(self._folder)

    def with_values(self, values: Mapping[str, float | str]) -> Scene:
        """Return the scene, checked again, with other values at some of ``scalar_keys``; integers where these are kept.

        ``grid.accuracy`` replaces the other keys of the grid, the force of an actuator its magnitude and the other way
        round.

        Raises:
            SceneError: the values are not valid; the message names the key at fault.
        """
        tables: Any = self.model_dump(mode="json")
        if self.targets:
            del tables["target"]
        if self.gridded_by_waves and not any(key.startswith("grid.") for key in values):
            del tables["grid"]
        elif self.grid.accuracy is not None or "grid.accuracy" in values:
            changed = {"accuracy", *(key_parts(key)[1] for key in values if key.startswith("grid."))}
            tables["grid"] = {key: value for key, value in tables["grid"].items() if key in changed}
        kinds = scalar_keys(self)
        places = []
        linked = [(key, inner) for key in values for inner in linked_keys(self, key)]
        for name, key in linked:
            value = values[name]
            *path, last = key_parts(key)
            table = reduce(operator.getitem, path, tables)
            whole = kinds[key] is int and isinstance(value, float) and value.is_integer()
            places.append((table, last, int(value) if whole else value))
            if path[:1] == ["actuators"] and last in ALTERNATIVES:
                table.pop(ALTERNATIVES[str(last)], None)
        for table, last, value in places:
            table[last] = value
        return Scene.from_tables(tables).in_folder(self._folder)

    def to_toml(self) -> str:
        """Return the scene, defaults included, as TOML text that :meth:`parse` reads back."""
        tables = self._tables()
        tables |= {key: tables.pop(key) for key in ("targets", "actuators", "measurement")}  # at the end
        return dump_toml(tables)

    def _tables(self) -> dict[str, Any]:
        """Return the tables as a file would have them, defaults included."""
        tables = self.model_dump(mode="json", exclude_none=True)
        if self.grid.accuracy is not None:
            tables["grid"] = {"accuracy": self.grid.accuracy}
        if self.targets and self.target == self.targets[0].unnamed:
            del tables["target"]
        return tables

    def __repr__(self) -> str:
        width, height = self.plate.size
        millimetres = f"{1e3 * width:g} × {1e3 * height:g} × {1e3 * self.plate.thickness:g} mm"
        count = len(self.actuators)
        title = f"{self.title!r}, " if self.title else ""
        return f"<Scene {title}{millimetres}, {count} actuator{'s'[: count > 1]}, {self.drive.frequency:g} Hz>"

    __str__ = __repr__


SceneSource = Scene | str | Path


def _check_tables(scene: SceneTables) -> None:
    """Check that the tables of a scene fit together."""
    actuators = scene.actuators
    _check_areas(scene)
    _check_outline(scene)
    _check_names("actuators", actuators)
    if scene.links:
        check_links(scene)
    _check_names("targets", scene.targets)
    if scene.targets and scene.target not in [target.unnamed for target in scene.targets]:
        raise ValueError("target: there are [[targets]] too, and it is none of them; write one of the two")
    for index, layer in enumerate(scene.effects.layers):
        scene.plate.check_thin(layer.thickness, f"effects.layers[{index}].thickness: ")
    check_layers(scene.effects.layers)
    _check_piezo(scene)
    scene.check_steady()
    _check_drive(scene)
    drives = ("ramp", "burst", "chirp", "signal", "electrostatic")
    check_modal_tables(scene.effects, {f"drive.{name}": getattr(scene.drive, name) or None for name in drives})
    if scene.effects.air is not None:
        sounds = [table.sound_key for table in (scene.search, scene.specification) if table is not None]
        scene.effects.air.check(scene.plate.outline is not None, sounds)
    scene.search.check_limits([actuator.name for actuator in actuators])
    if scene.search.robust is not None:
        scene.search.robust.check(scene.effects, scene.grid.load)
        _check_keys(scene, "search.robust.tolerance", scene.search.robust.tolerance, SEARCHED)
        if len(scene.targets) > 1:
            raise ValueError("search.robust: not with several [[targets]]; write a scene for each target")
    scene.check_measurements()
    if scene.fit is not None:
        _check_keys(scene, "fit.free", scene.fit.free, PANEL)
    if scene.design is not None:
        _check_keys(scene, "design.free", scene.design.free, PANEL)
        _check_keys(scene, "design.tolerance", scene.design.tolerance, VARIED)
        scene.design.check(scene.movable, scene.plate.size)
    _check_focus(scene)
    if scene.specification is not None:
        kinds = {actuator.kind for actuator in actuators}
        scene.specification.check([target.name for target in scene.targets], scene.plate.size, kinds)
        _check_keys(scene, "specification.tolerance", scene.specification.tolerance, VARIED)
    for index, time in enumerate(scene.record.times):
        if time > scene.window.end * (1 + 1e-9):
            limit = f"window.end = {scene.window.end:g} s"
            raise ValueError(f"record.times[{index}]: {time:g} s is after the run, {limit}")
    for index, point in enumerate(scene.record.points):
        scene.plate.check_point(f"record.points[{index}]", point)


def _check_outline(scene: SceneTables) -> None:
    """Check that a plate with an outline or supports has nothing that these exclude."""
    if (outline := scene.outline) is None:
        return
    if scene.effects.stretches and scene.plate.outline is not None:
        raise ValueError("effects.stretching: not with plate.outline; delete one of them")
    for index, support in enumerate(scene.supports):
        key = f"supports[{index}].{next(name for name in ('point', 'line', 'ring') if getattr(support, name))}"
        for end in support.ends:
            scene.plate.check_point(key, end)
        curve = support.piece(key)
        if curve is not None and not outline.contains(curve.points(np.linspace(0, 1, SUPPORT_SAMPLES))).all():
            raise ValueError(f"{key}: leaves the plate; keep all of it inside the outline, outside the holes")
    regions: dict[str, PlateRegion] = {f"actuators[{index}]": row for index, row in enumerate(scene.actuators)}
    regions |= {key: target for key, target in scene.targets_by_key.items() if target.mask is None}
    for key, region in (regions | scene.effects.regions).items():
        if outline.share(region.flattened()) == 0:
            value = list(getattr(region, region.shape))
            raise ValueError(
                f"{key}.{region.shape}: {value} is off the plate; move it inside the outline, outside its holes"
            )
    for before, after, angle in outline.corners():
        if angle > math.pi + REENTRANT and before.condition == after.condition == "supported":
            x, y = after.start
            raise ValueError(
                f"edges.{after.edge}: supported at the re-entrant corner of {before.name} and {after.name} near "
                f"({x:.4g}, {y:.4g}) m, where no solution converges; round it by corner_radius, or clamp or free it"
            )


def _check_areas(scene: SceneTables) -> None:
    over = scene.outline is not None
    for index, row in enumerate(scene.actuators):
        row.check(f"actuators[{index}]", scene.plate.size, over, f" ({row.name!r})")
    for key, region in (scene.targets_by_key | scene.effects.regions).items():
        region.check(key, scene.plate.size, over)
    areas: dict[str, Area] = {}
    if (position := scene.search.position) is not None:
        areas |= {} if position.area is None else {"search.position.area": position.area}
        areas |= {f"search.position.areas.{name}": area for name, area in (position.areas or {}).items()}
    for key, area in areas.items():
        check_area(key, area, scene.plate.size)


def _check_names(table: str, rows: Sequence[Actuator | NamedTarget]) -> None:
    names: set[str] = set()
    for index, row in enumerate(rows):
        if row.name in names:
            key, kind = f"{table}[{index}].name", table.removesuffix("s")
            raise ValueError(f"{key}: {row.name!r} is taken; give each {kind} its own")
        names.add(row.name)


def _check_piezo(scene: SceneTables) -> None:
    """Check that a scene with piezo patches has nothing that these exclude."""
    if not scene.piezo:
        return
    for index, actuator in enumerate(scene.actuators):
        if actuator.kind == "coil":
            continue
        if actuator.thickness is None:
            raise ValueError(f'actuators[{index}].kind: "pressure" beside "piezo"; all but coils must be of one kind')
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
    for key, table in (("burst", drive.burst), ("signal", drive.signal)):
        if table is not None and table.start >= end:
            raise ValueError(f"drive.{key}.start: {table.start:g} {after}")


def _check_focus(scene: SceneTables) -> None:
    """Check that the points of a focus lie on the plate and that its waveforms are not too many."""
    if (focus := scene.focus) is None:
        return
    for index, point in enumerate(focus.points):
        scene.plate.check_point(f"focus.points[{index}]", point)
    if focus.rest is not None and focus.rest.radius > min(scene.plate.size) / 2:
        raise ValueError(f"focus.rest.radius: {focus.rest.radius:g} m is above half of a side of the plate")
    focus.check_numbers(focus.samples, len(scene.actuators), "time")


def _check_keys(scene: SceneTables, where: str, names: Iterable[str], tables: tuple[str, ...]) -> None:
    """Check that the keys of a fit or of tolerances are different real numbers of some tables of the scene."""
    kinds, taken = scalar_keys(scene), set[str]()
    for name in names:
        try:
            key = resolved_key(scene, name, kinds)
        except SceneError as error:
            raise ValueError(f"{where}: {error}") from None
        linked = linked_keys(scene, key)
        if kinds[key] is not float or not all(inner.startswith(tables) for inner in linked):
            listed = ", ".join(table.rstrip(".[") for table in tables)
            raise ValueError(f"{where}: {name}: is no real number of {listed}")
        if where.endswith("tolerance") and not value_of(scene, key):
            raise ValueError(f"{where}: {name}: is 0 or not written in the scene; write its number")
        if taken & {*linked}:
            raise ValueError(f"{where}: {name}: is there twice")
        taken |= {*linked}

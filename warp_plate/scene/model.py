"""The scene: its tables, checked, how it is read and written, and what follows from them."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from functools import reduce
from pathlib import Path
from typing import Any

from pydantic import PrivateAttr, ValidationError, model_validator

from warp_plate.scene.checks import check_tables
from warp_plate.scene.errors import SceneError
from warp_plate.scene.explain_errors import explain_error
from warp_plate.scene.grid import Grid, grid_by_waves
from warp_plate.scene.keys import ALTERNATIVES, assign, key_parts, resolved_key, scalar_keys
from warp_plate.scene.load import dump_toml, parse_toml, read_scene_text
from warp_plate.scene.tables import SceneTables
from warp_plate.scene.target import NamedTarget, Target


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
        text, folder = read_scene_text(source)
        return Scene.parse(text, str(source), assignments).in_folder(folder)

    @staticmethod
    def parse(text: str, name: str, assignments: Sequence[str] = ()) -> Scene:
        """Return the scene of a TOML text, or raise a SceneError that begins with ``name``; see :meth:`load`."""
        tables = parse_toml(text, name)
        assign(tables, assignments)
        try:
            return Scene.from_tables(tables)
        except SceneError as error:
            raise SceneError(f"{name}: {error}") from None

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
            speed = math.sqrt(plate.rigidity / (plate.density * plate.thickness))
            self._derive("grid", grid_by_waves(plate.size, math.sqrt(2 * math.pi * speed / highest)))
        return self

    @model_validator(mode="after")
    def _tables_fit_together(self) -> Scene:
        check_tables(self)
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
        scene = self.model_copy()
        scene._folder = folder if self.names_files else None
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

    def replace(self, key: str, value: float | str) -> Scene:
        """Return the scene with another value at a key, or raise a SceneError if there is no such key or value.

            >>> Scene.load("paper").replace("drive.frequency", 300).drive.frequency
            300.0

        Keys are written as for ``--vary``, such as ``plate.thickness`` and ``actuators[0].phase``.
        """
        return self.with_values({resolved_key(self, key): value})

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
        for key, value in values.items():
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
        tables = self.model_dump(exclude_none=True)
        if self.grid.accuracy is not None:
            tables["grid"] = {"accuracy": self.grid.accuracy}
        if self.targets and self.target == self.targets[0].unnamed:
            del tables["target"]
        tables |= {key: tables.pop(key) for key in ("targets", "actuators", "measurement")}  # at the end
        return dump_toml(tables)

    def __repr__(self) -> str:
        width, height = self.plate.size
        millimetres = f"{1e3 * width:g} × {1e3 * height:g} × {1e3 * self.plate.thickness:g} mm"
        count = len(self.actuators)
        title = f"{self.title!r}, " if self.title else ""
        return f"<Scene {title}{millimetres}, {count} actuator{'s'[: count > 1]}, {self.drive.frequency:g} Hz>"

    __str__ = __repr__


SceneSource = Scene | str | Path

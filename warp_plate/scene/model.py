"""The scene: a pydantic model for each table of the scene file, with the checks that need no grid."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, PrivateAttr, ValidationError, model_validator

from warp_plate.effects.edges import Edges
from warp_plate.effects.effect import Term
from warp_plate.effects.layers import Layer
from warp_plate.effects.table import Effects, check_modal_tables
from warp_plate.scene.actuator import Actuator
from warp_plate.scene.assignments import assign
from warp_plate.scene.drive import Drive, check_drive
from warp_plate.scene.dump import dump_scene
from warp_plate.scene.errors import SceneError
from warp_plate.scene.explain_errors import explain_error
from warp_plate.scene.fields import (
    Area,
    Coordinate,
    Instant,
    Positive,
    Table,
    Text,
    check_area,
)
from warp_plate.scene.fit import Fit, Measurement
from warp_plate.scene.focus import Focus
from warp_plate.scene.grid import DEFAULT_ACCURACY, Grid, grid_by_waves
from warp_plate.scene.keys import resolved_key, with_values
from warp_plate.scene.load import parse_toml, read_scene_text
from warp_plate.scene.piezo import check_piezo, piezo_layers
from warp_plate.scene.search import Search
from warp_plate.scene.target import NamedTarget, Target


class Plate(Table):
    """Geometry and material of the plate."""

    size: tuple[Positive, Positive]  # sides along x and y [m]
    thickness: Positive  # thickness H, at most a fifth of the shorter side [m]
    young_modulus: Annotated[float, Field(ge=1e3, le=1e13)]  # Young's modulus E [Pa]
    poisson_ratio: Annotated[float, Field(ge=-0.99, lt=0.5)]  # Poisson's ratio ν [1]
    density: Annotated[float, Field(ge=1, le=1e5)]  # density ρ [kg/m³]

    @property
    def rigidity(self) -> float:
        """Bending rigidity EH³/12(1 − ν²) [N·m] of the isotropic plate."""
        return self.young_modulus * self.thickness**3 / (12 * (1 - self.poisson_ratio**2))

    @model_validator(mode="after")
    def _thin(self) -> Plate:
        self.check_thin(self.thickness, "thickness: ")
        return self

    def check_thin(self, thickness: float, head: str = "") -> None:
        """Raise ValueError, beginning with ``head``, unless a thickness [m] is small against the sides."""
        if thickness > min(self.size) / 5:
            limit = "a plate is thinner than a fifth of its side (lengths are in metres)"
            raise ValueError(f"{head}{thickness:g} m is not thin for a side of {min(self.size):g} m; {limit}")


class Window(Table):
    """The interval of time over which kinetic energy is averaged."""

    start: Instant = 0.05  # start [s]
    end: Positive = 0.1  # end of the interval and of the run [s]

    @model_validator(mode="after")
    def _ordered(self) -> Window:
        if self.end <= self.start:
            raise ValueError(f"end: {self.end:g} s must be later than start = {self.start:g} s")
        return self


class Record(Table):
    """Outputs of a run besides energies."""

    # Times at which displacement fields are stored [s] (default: the end of the run and a quarter period before; for
    # bursts, sweeps and other drives without a period the middle of the run)
    times: tuple[Instant, ...] = ()
    # Points (x, y) at which the displacement of every step is stored [m]
    points: tuple[tuple[Coordinate, Coordinate], ...] = ()


class Scene(Table):
    """The complete input of a run, in SI units; read one with :meth:`load`.

    If the scene has several ``targets``, ``target`` is one of them, by default the first.
    """

    title: Text = ""  # title of tables and pictures
    plate: Plate
    edges: Edges = Edges()
    grid: Grid = Grid(accuracy=DEFAULT_ACCURACY)
    window: Window = Window()
    drive: Drive
    targets: tuple[NamedTarget, ...] = ()
    target: Target
    record: Record = Record()
    effects: Effects = Effects()
    search: Search = Search()
    focus: Focus | None = None
    fit: Fit | None = None
    measurement: tuple[Measurement, ...] = ()
    actuators: Annotated[tuple[Actuator, ...], Field(min_length=1)]
    _folder: Path | None = PrivateAttr(default=None)

    @staticmethod
    def load(source: SceneSource, assignments: Sequence[str] = ()) -> Scene:
        """Return the scene of a preset's name or of a TOML file, or raise a SceneError that names what is wrong.

        A scene is returned unchanged. Of ``assignments`` each puts a value into a file's tables: ``KEY=VALUE``, see
        :func:`warp_plate.scene.assignments.assign`.
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
            grid = grid_by_waves(plate.size, math.sqrt(2 * math.pi * speed / highest))
            self.__dict__["grid"] = grid  # the model is frozen, and the table counts as not written
        return self

    @property
    def gridded_by_waves(self) -> bool:
        """True if the scene has no ``[grid]``, and no accuracy could be kept because it is not linear."""
        return "grid" not in self.model_fields_set and not self.linear

    @model_validator(mode="after")
    def _tables_fit_together(self) -> Scene:
        actuators, size = self.actuators, self.plate.size
        areas: dict[str, Area] = {
            f"actuators[{index}].area ({row.name!r})": row.area for index, row in enumerate(actuators)
        }
        if self.search.position is not None and self.search.position.area is not None:
            areas["search.position.area"] = self.search.position.area
        for key, area in (areas | self.effects.areas).items():
            check_area(key, area, size)
        _check_names("actuators", actuators)
        for key, target in self.targets_by_key.items():
            target.check(key, size)
        _check_names("targets", self.targets)
        if self.targets and self.target not in [target.unnamed for target in self.targets]:
            raise ValueError("target: there are [[targets]] too, and it is none of them; write one of the two")
        for index, layer in enumerate(self.effects.layers):
            self.plate.check_thin(layer.thickness, f"effects.layers[{index}].thickness: ")
        check_piezo(self)
        check_drive(self.drive, actuators, self.window.end)
        drives = ("burst", "chirp", "signal", "electrostatic")
        check_modal_tables(self.effects, {f"drive.{name}": getattr(self.drive, name) for name in drives})
        self.search.check_limits([actuator.name for actuator in actuators])
        if self.search.robust is not None:
            self.search.robust.check(self.effects, self.grid.load)
            if len(self.targets) > 1:
                raise ValueError("search.robust: not with several [[targets]]; write a scene for each target")
        for index, row in enumerate(self.measurement):
            row.check(f"measurement[{index}]", self)
        if self.fit is not None:
            self.fit.check(self)
        if self.focus is not None:
            self.focus.check(size, len(actuators))
        self._check_record()
        return self

    def _check_record(self) -> None:
        (width, height), end = self.plate.size, self.window.end
        for index, time in enumerate(self.record.times):
            if time > end * (1 + 1e-9):
                raise ValueError(f"record.times[{index}]: {time:g} s is after the run, window.end = {end:g} s")
        for index, (x, y) in enumerate(self.record.points):
            if not (0 <= x <= width and 0 <= y <= height):
                raise ValueError(f"record.points[{index}]: {[x, y]} is off the plate of {[width, height]} m")

    @property
    def piezo(self) -> bool:
        """True if the actuators are piezo patches, driven by voltages."""
        return any(actuator.kind == "piezo" for actuator in self.actuators)

    @property
    def layers(self) -> tuple[Layer, ...]:
        """Layers of the plate, those of piezo patches included."""
        return (*self.effects.layers, *piezo_layers(self.actuators))

    @property
    def terms(self) -> tuple[Term, ...]:
        """Terms of the equation of motion besides bending and inertia: those of elastic edges, then of the effects."""
        return (*self.edges.terms(), *self.effects.terms(self.plate))

    @property
    def uniform(self) -> bool:
        """True if the plate is isotropic, homogeneous, and clamped or supported along all edges."""
        varied = self.effects.section_keys or self.layers
        return not varied and all(edge in ("clamped", "supported") for _, edge in self.edges)

    @property
    def names_files(self) -> bool:
        """True if parts of the scene lie in other files."""
        masks = any(target.mask is not None for target in self.targets_by_key.values())
        signals = (self.drive.signal, self.focus and self.focus.wish)
        return masks or any(signals) or bool(self.effects.map_files)

    @property
    def targets_by_key(self) -> dict[str, Target]:
        """All targets by key: ``target``, or ``targets[0]``, ``targets[1]``, ..."""
        return {f"targets[{index}]": row for index, row in enumerate(self.targets)} or {"target": self.target}

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
        kept = {key: table for key, table in {**self.model_dump(), **grid}.items() if key not in unwritten}
        return Scene.from_tables({**kept, **tables}).in_folder(self._folder)

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
        return with_values(self, {resolved_key(self, key): value})

    def to_toml(self) -> str:
        """Return the scene, defaults included, as TOML text that :meth:`parse` reads back."""
        return dump_scene(self)

    def __repr__(self) -> str:
        width, height = self.plate.size
        millimetres = f"{1e3 * width:g} × {1e3 * height:g} × {1e3 * self.plate.thickness:g} mm"
        count = len(self.actuators)
        title = f"{self.title!r}, " if self.title else ""
        return f"<Scene {title}{millimetres}, {count} actuator{'s'[: count > 1]}, {self.drive.frequency:g} Hz>"

    __str__ = __repr__

    @property
    def nonlinear_table(self) -> str | None:
        """First table that makes displacements nonlinear in the drives, so that superposition fails; None if none."""
        return self.nonlinear_key or self.effects.first(lambda effect: effect.travels)

    @property
    def nonlinear_key(self) -> str | None:
        """First table that keeps the motion from obeying a linear equation; None if none."""
        electrostatic = "drive.electrostatic" if self.drive.electrostatic is not None else None
        return self.effects.first(lambda effect: not effect.linear) or electrostatic

    @property
    def linear(self) -> bool:
        return self.nonlinear_table is None

    @property
    def modal_only_key(self) -> str | None:
        """First key that only the modal engine knows, because it has no time steps; None if none."""
        return self.effects.first(lambda effect: not effect.stepped)

    def check_stepped(self) -> None:
        """Raise a SceneError if only the modal engine knows the scene's effects."""
        if (key := self.modal_only_key) is not None:
            raise SceneError(
                f'{key}: cannot be stepped in time; use the evaluator "modal", or write [effects.damping] instead'
            )

    @property
    def steady(self) -> bool:
        """True if the response is the steady one: energies are means over all time, and ``window`` is not read."""
        return self.steady_key is not None

    @property
    def steady_key(self) -> str | None:
        """First effect that is defined for steady tones alone, without motion in time; None if none."""
        return self.effects.first(lambda effect: effect.steady)

    @property
    def nonharmonic_key(self) -> str | None:
        """First key that makes the drive other than a tone of one frequency from t = 0 on; None if none."""
        return self.nonperiodic_key or ("drive.electrostatic" if self.drive.electrostatic is not None else None)

    @property
    def nonperiodic_key(self) -> str | None:
        """First key that keeps the load from repeating with the drive's period from t = 0 on; None if none."""
        if self.drive.waveform_key is not None:
            return self.drive.waveform_key
        for index, actuator in enumerate(self.actuators):
            if actuator.frequency not in (None, self.drive.frequency):
                return f"actuators[{index}].frequency"
        return self.effects.first(lambda effect: effect.travels)

    @property
    def drive_unit(self) -> str:
        """Unit of all magnitudes, N/m² or, for electrostatic actuators and piezo patches, V."""
        return "V" if self.piezo or self.drive.electrostatic is not None else "N/m²"

    @property
    def drive_angular_frequency(self) -> float:
        """Angular frequency of the drive, 2πf [rad/s]."""
        return 2 * math.pi * self.drive.frequency


SceneSource = Scene | str | Path


def _check_names(table: str, rows: Sequence[Actuator | NamedTarget]) -> None:
    names = [row.name for row in rows]
    for index, name in enumerate(names):
        if name in names[:index]:
            raise ValueError(f"{table}[{index}].name: {name!r} is taken; give each {table.removesuffix('s')} its own")

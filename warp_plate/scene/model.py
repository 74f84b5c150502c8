"""The scene: one pydantic model a table of the scene file, with the checks that need no grid."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, PrivateAttr, Tag, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from warp_plate.scene.drive import Drive, check_drive
from warp_plate.scene.effects import Effects
from warp_plate.scene.errors import SceneError
from warp_plate.scene.explain_errors import explain_error
from warp_plate.scene.fields import (
    Area,
    Coordinate,
    Instant,
    Moderate,
    Name,
    NotNegative,
    Positive,
    Table,
    Text,
    check_area,
)
from warp_plate.scene.load import parse_toml, read_scene_text
from warp_plate.scene.search import Search
from warp_plate.scene.target import NamedTarget, Target


class ElasticEdge(Table):
    """An edge on springs: translation [N/m²] against displacement, rotation [N·m/(rad·m)] against slope, per length."""

    translation: NotNegative = 0.0
    rotation: NotNegative = 0.0


def _edge_word(value: object) -> object:
    if value not in ("clamped", "supported", "free"):
        raise PydanticCustomError(
            "edge_word",
            "must be 'clamped', 'supported', 'free', or a table of springs such as { translation = 1e6 }",
        )
    return value


Edge = Annotated[
    Annotated[Literal["clamped", "supported", "free"], BeforeValidator(_edge_word), Tag("word")]
    | Annotated[ElasticEdge, Tag("springs")],
    Discriminator(lambda value: "springs" if isinstance(value, dict | ElasticEdge) else "word"),
]


class Plate(Table):
    """Geometry and material: sides [m], thickness [m], Young's modulus [Pa], density [kg/m³]."""

    size: tuple[Positive, Positive]
    thickness: Positive
    young_modulus: Annotated[float, Field(ge=1e3, le=1e13)]
    poisson_ratio: Annotated[float, Field(ge=-0.99, lt=0.5)]
    density: Annotated[float, Field(ge=1, le=1e5)]

    @model_validator(mode="after")
    def _thin(self) -> Plate:
        self.check_thin(self.thickness, "thickness: ")
        return self

    def check_thin(self, thickness: float, head: str = "") -> None:
        """Raise ValueError, beginning with ``head``, where the plate is not thin at a place of this thickness [m]."""
        if thickness > min(self.size) / 5:
            raise ValueError(
                f"{head}{thickness:g} m is not thin for a side of {min(self.size):g} m; "
                "a Kirchhoff-Love plate is thinner than a fifth of its side (lengths are in metres)"
            )


class Edges(Table):
    """What holds each side: "clamped" (u = 0, no slope), "supported" (u = 0, no bending moment), "free" (no moment, no
    shear force) or springs."""

    left: Edge = "clamped"
    bottom: Edge = "clamped"
    right: Edge = "clamped"
    top: Edge = "clamped"


class Grid(Table):
    """Nodes along x and y with the edges included, spatial order, how loads are weighed, step, precision.

    Or ``accuracy``, the relative error that the localization factors may have, which chooses all of these.
    """

    nodes: tuple[Annotated[int, Field(ge=5, le=8193)], Annotated[int, Field(ge=5, le=8193)]] = (27, 27)
    order: Literal[2, 4] = 2
    load: Literal["overlap", "nodes", "moments"] = "overlap"
    time_step: Positive | None = None
    precision: Literal["float32", "float64"] = "float32"
    accuracy: Annotated[float, Field(ge=1e-4, le=0.5)] | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Grid:
        if self.order == 4 and min(self.nodes) < 9:
            raise ValueError(f"nodes: {list(self.nodes)} are too few for order = 4, which takes 9 or more a side")
        chosen = self.model_fields_set & {"nodes", "order", "load", "time_step", "precision"}
        if self.accuracy is not None and chosen:
            raise ValueError(
                f"accuracy: {self.accuracy:g} chooses nodes, order, load, time_step and precision; delete it, or "
                f"delete {', '.join(sorted(chosen))}"
            )
        return self


class Window(Table):
    """The span of time [s] over which kinetic energy is averaged; the run ends with it."""

    start: Instant = 0.05
    end: Positive = 0.1

    @model_validator(mode="after")
    def _ordered(self) -> Window:
        if self.end <= self.start:
            raise ValueError(f"end: {self.end:g} s must be later than start = {self.start:g} s")
        return self


class Record(Table):
    """What is kept beside energies: displacement at ``times`` [s], its trace at ``points`` (x, y) [m]."""

    times: tuple[Instant, ...] = ()
    points: tuple[tuple[Coordinate, Coordinate], ...] = ()


class Actuator(Table):
    """A patch that presses on the plate: area x0, x1, y0, y1 [m], magnitude [N/m²; V under ``[drive.electrostatic]``],
    phase lag [rad], frequency [Hz] (None: the drive's), delay [s] (None: its burst begins at ``drive.burst.start``)."""

    name: Name
    area: Area
    magnitude: Moderate = 1.0
    phase: Moderate = 0.0
    frequency: Positive | None = None
    delay: Instant | None = None


class Scene(Table):
    """Everything that a run needs, in SI units, checked; read one with :meth:`load`."""

    title: Text = ""
    plate: Plate
    edges: Edges = Edges()
    grid: Grid = Grid()
    window: Window = Window()
    drive: Drive
    targets: tuple[NamedTarget, ...] = ()
    # One of ``targets``, where there are such: the first, unless it is said.
    target: Target
    record: Record = Record()
    effects: Effects = Effects()
    search: Search = Search()
    actuators: Annotated[tuple[Actuator, ...], Field(min_length=1)]
    # No key of the file: where the files that it names lie.
    _folder: Path | None = PrivateAttr(default=None)

    @staticmethod
    def load(source: str | Path) -> Scene:
        """Return the scene of a preset's name or of a TOML file.

        Raises:
            SceneError: there is no such preset or file, it is not TOML, or a key is unknown or wrong.
        """
        text, folder = read_scene_text(source)
        return Scene.parse(text, str(source)).in_folder(folder)

    @staticmethod
    def parse(text: str, name: str) -> Scene:
        """Return the scene of a TOML text; ``name`` begins the message of an error.

        Raises:
            SceneError: the text is not TOML, or a key is unknown or wrong.
        """
        tables = parse_toml(text, name)
        try:
            return Scene.from_tables(tables)
        except SceneError as error:
            raise SceneError(f"{name}: {error}") from None

    @staticmethod
    def from_tables(tables: Mapping[str, Any]) -> Scene:
        """Return the scene of tables by their names.

        Raises:
            SceneError: a key is unknown or wrong.
        """
        try:
            return Scene.model_validate(tables)
        except ValidationError as error:
            raise SceneError(explain_error(error, Scene)) from None

    @model_validator(mode="before")
    @classmethod
    def _first_of_targets(cls, tables: Any) -> Any:
        if not isinstance(tables, dict) or "target" in tables or not tables.get("targets"):
            return tables
        try:
            first = NamedTarget.model_validate(tables["targets"][0]).unnamed
        except (ValidationError, LookupError, TypeError):  # which the check of ``targets`` will tell
            first = Target(area=(0.0, 1.0, 0.0, 1.0))
        return {**tables, "target": first}

    @model_validator(mode="after")
    def _fits(self) -> Scene:
        size = self.plate.size
        for index, actuator in enumerate(self.actuators):
            check_area(f"actuators[{index}].area ({actuator.name!r})", actuator.area, size)
        names: set[str] = set()
        for index, actuator in enumerate(self.actuators):
            if actuator.name in names:
                raise ValueError(f"actuators[{index}].name: {actuator.name!r} is taken; give each actuator its own")
            names.add(actuator.name)
        self._check_targets()
        delays = [actuator.delay for actuator in self.actuators]
        check_drive(self.drive, [actuator.frequency for actuator in self.actuators], delays, self.window.end)
        if self.search.position is not None and self.search.position.area is not None:
            check_area("search.position.area", self.search.position.area, size)
        for index, layer in enumerate(self.effects.layers):
            check_area(f"effects.layers[{index}].area", layer.area, size)
            if layer.thickness > min(size) / 5:
                raise ValueError(
                    f"effects.layers[{index}].thickness: {layer.thickness:g} m is not thin; at most a fifth of the "
                    f"plate's shorter side, {min(size) / 5:g} m"
                )
        for index, oscillator in enumerate(self.effects.oscillators):
            check_area(f"effects.oscillators[{index}].area", oscillator.area, size)
        self.search.check_limits([actuator.name for actuator in self.actuators])
        if self.search.robust is not None:
            self.search.robust.check(self.effects, self.grid.load)
            if len(self.targets) > 1:
                raise ValueError("search.robust: not with several [[targets]]; write a scene for each target")
        for index, time in enumerate(self.record.times):
            if time > self.window.end * (1 + 1e-9):
                raise ValueError(
                    f"record.times[{index}]: {time:g} s is after the run, which ends at window.end = "
                    f"{self.window.end:g} s"
                )
        for index, (x, y) in enumerate(self.record.points):
            if not (0 <= x <= size[0] and 0 <= y <= size[1]):
                raise ValueError(
                    f"record.points[{index}]: {[x, y]} is off the plate of {list(size)} m; "
                    "write x, y inside it"
                )
        return self

    def _check_targets(self) -> None:
        for key, one in self.targets_by_key.items():
            one.check(key, self.plate.size)
        for index, target in enumerate(self.targets):
            if target.name in [other.name for other in self.targets[:index]]:
                raise ValueError(f"targets[{index}].name: {target.name!r} is taken; give each target its own")
        if self.targets and self.target not in [target.unnamed for target in self.targets]:
            raise ValueError("target: there are [[targets]] too, and it is none of them; write one of the two")

    @property
    def uniform(self) -> bool:
        """Whether the plate is isotropic, the same everywhere, and clamped or supported all around."""
        words = all(edge in ("clamped", "supported") for _, edge in self.edges)
        varied = self.effects.orthotropic or self.effects.variation or self.effects.layers
        return words and not varied

    @property
    def names_files(self) -> bool:
        """Whether some of the scene lies in other files."""
        variation = self.effects.variation
        masks = any(target.mask is not None for target in self.targets_by_key.values())
        return masks or self.drive.signal is not None or (variation is not None and any(variation.files))

    @property
    def targets_by_key(self) -> dict[str, Target]:
        """All targets by their keys: ``target``, or ``targets[0]``, ..."""
        several: dict[str, Target] = {f"targets[{index}]": target for index, target in enumerate(self.targets)}
        return several or {"target": self.target}

    def aimed_at(self, index: int) -> Scene:
        """The scene with another one of its several targets as its ``target``."""
        return self.model_copy(update={"target": self.targets[index].unnamed})

    @property
    def folder(self) -> Path | None:
        """Where the files lie that the scene names; None: it names none, or was not read from a file."""
        return self._folder

    def in_folder(self, folder: Path | None) -> Scene:
        """Return the scene with the folder of the files that it names; None if it names no files."""
        return self.model_copy()._with_folder(folder if self.names_files else None)

    def _with_folder(self, folder: Path | None) -> Scene:
        self._folder = folder
        return self

    def with_tables(self, **tables: Any) -> Scene:
        """Return the scene with some of its tables replaced, checked again.

        Raises:
            SceneError: the tables do not fit together.
        """
        # A grid that is chosen for an accuracy must not name anything else.
        grid = {"grid": self.grid} if self.grid.accuracy is not None else {}
        return Scene.from_tables({**self.model_dump(), **grid, **tables})._with_folder(self._folder)

    def with_accuracy(self, accuracy: float) -> Scene:
        """Return the scene with an accuracy in place of its grid.

        Raises:
            SceneError: the accuracy is out of range.
        """
        try:
            return self.model_copy(update={"grid": Grid(accuracy=accuracy)})
        except ValidationError as error:
            raise SceneError(f"grid.{explain_error(error, Grid)}") from None

    @property
    def nonlinear_table(self) -> str | None:
        """The table for which displacements are not linear in the drives, so that no superposition holds; or None."""
        if self.effects.stretching is not None:
            return "effects.stretching"
        if self.drive.electrostatic is not None:
            return "drive.electrostatic"
        return None if self.effects.moving_load is None else "effects.moving_load"

    @property
    def linear(self) -> bool:
        """Whether displacements are linear in the drives."""
        return self.nonlinear_table is None

    @property
    def nonharmonic_key(self) -> str | None:
        """The first key for which the drive is no tone of one frequency from t = 0 on; or None."""
        return self.nonperiodic_key or ("drive.electrostatic" if self.drive.electrostatic is not None else None)

    @property
    def nonperiodic_key(self) -> str | None:
        """The first key for which the load does not repeat with the drive's period from t = 0 on; or None."""
        for name in ("burst", "chirp", "signal"):
            if getattr(self.drive, name) is not None:
                return f"drive.{name}"
        for index, actuator in enumerate(self.actuators):
            if actuator.frequency not in (None, self.drive.frequency):
                return f"actuators[{index}].frequency"
        return None if self.effects.moving_load is None else "effects.moving_load"

    @property
    def drive_unit(self) -> str:
        """Of the actuators' magnitudes and of every drive: N/m², or V where the voltage is squared."""
        return "N/m²" if self.drive.electrostatic is None else "V"

    @property
    def drive_angular_frequency(self) -> float:
        """2πf [rad/s]."""
        return 2 * math.pi * self.drive.frequency

"""The scene: one pydantic model a table of the scene file, with the checks that need no grid."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from warp_plate.scene.effects import Area, Effects, NotNegative, Positive, Table

# HDF5 cannot keep a text with a NUL in it.
Text = Annotated[str, Field(pattern=r"^[^\x00]*$")]
Weight = Annotated[float, Field(ge=0, le=1e6)]


class ElasticEdge(Table):
    """An edge on springs: translation [N/m²] against displacement, rotation [N·m/(rad·m)] against slope, per length."""

    translation: NotNegative = 0.0
    rotation: NotNegative = 0.0


Edge = Annotated[
    Annotated[Literal["clamped", "supported", "free"], Tag("word")] | Annotated[ElasticEdge, Tag("springs")],
    Discriminator(lambda value: "springs" if isinstance(value, dict | ElasticEdge) else "word"),
]


class Plate(Table):
    """Geometry and material: sides [m], thickness [m], Young's modulus [Pa], density [kg/m³]."""

    size: tuple[Positive, Positive]
    thickness: Positive
    young_modulus: Annotated[float, Field(ge=1e3, le=1e13)]
    poisson_ratio: Annotated[float, Field(gt=-1, lt=0.5)]
    density: Annotated[float, Field(ge=1, le=1e5)]

    @model_validator(mode="after")
    def _thin(self) -> Plate:
        if self.thickness > min(self.size) / 5:
            raise ValueError(
                f"thickness: {self.thickness:g} m is not thin for a side of {min(self.size):g} m; "
                "a Kirchhoff-Love plate is thinner than a fifth of its side (lengths are in metres)"
            )
        return self


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

    start: Annotated[float, Field(ge=0)] = 0.05
    end: Positive = 0.1

    @model_validator(mode="after")
    def _ordered(self) -> Window:
        if self.end <= self.start:
            raise ValueError(f"end: {self.end:g} s must be later than start = {self.start:g} s")
        return self


class Drive(Table):
    """What all actuators share: the frequency [Hz]."""

    frequency: Positive


class Target(Table):
    """The part of the plate that should vibrate: x0, x1, y0, y1 [m]."""

    area: Area


class Record(Table):
    """What is kept beside energies: displacement at ``times`` [s], its trace at ``points`` (x, y) [m]."""

    times: tuple[Annotated[float, Field(ge=0)], ...] = ()
    points: tuple[tuple[float, float], ...] = ()


class Search(Table):
    """The particle swarm, with the paper's names: w (inertia), κ (decay), c₁ (cognitive), c₂ (social)."""

    particles: Annotated[int, Field(ge=2, le=10_000_000)] = 20
    iterations: Annotated[int, Field(ge=1)] = 80
    inertia: Weight = 0.4
    decay: Annotated[float, Field(gt=0, le=1)] = 0.99
    cognitive: Weight = 2.0
    social: Weight = 2.0
    velocity_limit: Annotated[float, Field(gt=0, le=1e100)] | None = None
    stall: Annotated[int, Field(ge=1)] | None = None
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0


class Actuator(Table):
    """A patch that presses on the plate: area x0, x1, y0, y1 [m], magnitude [N/m²], phase lag [rad]."""

    name: Annotated[Text, Field(min_length=1)]
    area: Area
    magnitude: float = 1.0
    phase: float = 0.0


def _check_area(key: str, area: Area, size: tuple[float, float]) -> None:
    """Raise ValueError, naming ``key``, unless the rectangle has an inside and lies on the plate."""
    x0, x1, y0, y1 = area
    if x1 <= x0 or y1 <= y0:
        raise ValueError(f"{key}: {list(area)} has no inside; write x0, x1, y0, y1 with x0 < x1 and y0 < y1")
    slack = 1e-9 * max(size)
    if min(x0, y0) < -slack or x1 > size[0] + slack or y1 > size[1] + slack:
        raise ValueError(
            f"{key}: {list(area)} reaches off the plate; x must stay in 0 ... {size[0]:g}, "
            f"y in 0 ... {size[1]:g} (metres)"
        )


class Scene(Table):
    """Everything that a run needs, in SI units, checked; read one with :meth:`load`."""

    title: Text = ""
    plate: Plate
    edges: Edges = Edges()
    grid: Grid = Grid()
    window: Window = Window()
    drive: Drive
    target: Target
    record: Record = Record()
    effects: Effects = Effects()
    search: Search = Search()
    actuators: Annotated[tuple[Actuator, ...], Field(min_length=1)]

    @staticmethod
    def load(source: str | Path) -> Scene:
        """The scene of a preset's name or of a TOML file.

        Raises:
            SceneError: no such preset or file, not TOML, or a key that is unknown or wrong; one line.
        """
        from warp_plate.scene.load import load_scene

        return load_scene(source)

    @model_validator(mode="after")
    def _fits(self) -> Scene:
        size = self.plate.size
        for index, actuator in enumerate(self.actuators):
            _check_area(f"actuators[{index}].area ({actuator.name!r})", actuator.area, size)
        names = [actuator.name for actuator in self.actuators]
        for index, name in enumerate(names):
            if name in names[:index]:
                raise ValueError(f"actuators[{index}].name: {name!r} is taken; give each actuator its own")
        _check_area("target.area", self.target.area, size)
        for index, layer in enumerate(self.effects.layers):
            _check_area(f"effects.layers[{index}].area", layer.area, size)
        for index, oscillator in enumerate(self.effects.oscillators):
            _check_area(f"effects.oscillators[{index}].area", oscillator.area, size)
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

    @property
    def uniform(self) -> bool:
        """Whether the plate is isotropic, the same everywhere, and clamped or supported all around."""
        words = all(edge in ("clamped", "supported") for _, edge in self.edges)
        return words and self.effects.orthotropic is None and not self.effects.layers

    @property
    def linear(self) -> bool:
        """Whether displacements are linear in the drives: all effects but stretching."""
        return self.effects.stretching is None

    @property
    def drive_angular_frequency(self) -> float:
        """2πf [rad/s]."""
        return 2 * math.pi * self.drive.frequency

    def _repr_html_(self) -> str:
        """How a notebook shows it: see :mod:`warp_plate.viz.html`."""
        from warp_plate.viz.html import scene_html

        return scene_html(self)

"""The table ``[plate]`` and the top level of a scene file, before its tables are checked against each other."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from warp_plate.effects.edges import Edges
from warp_plate.effects.layers import Layer
from warp_plate.effects.table import Effects
from warp_plate.scene.actuator import Actuator
from warp_plate.scene.drive import Drive
from warp_plate.scene.fields import Density, Point, Positive, Table, Text, Unit, YoungModulus
from warp_plate.scene.fit import Fit, Measurement
from warp_plate.scene.focus import Focus
from warp_plate.scene.grid import DEFAULT_ACCURACY, Grid, Record, Window
from warp_plate.scene.search import Search
from warp_plate.scene.target import NamedTarget, Target


class Plate(Table):
    """Geometry and material of the plate."""

    size: Annotated[tuple[Positive, Positive], Unit("m"), Field(examples=[[0.2, 0.12]])]
    """Sides along x and y."""
    thickness: Annotated[Positive, Unit("m"), Field(examples=[0.7e-3])]
    """Thickness H, at most a fifth of the shorter side."""
    young_modulus: Annotated[YoungModulus, Field(examples=[72e9])]
    """Young's modulus E."""
    poisson_ratio: Annotated[float, Field(ge=-0.99, lt=0.5, examples=[0.22]), Unit("1")]
    """Poisson's ratio ν."""
    density: Annotated[Density, Field(examples=[2480.0])]
    """Density ρ."""

    @property
    def rigidity(self) -> float:
        """Bending rigidity EH³/12(1 − ν²) [N·m] of the isotropic plate."""
        return self.young_modulus * self.thickness**3 / (12 * (1 - self.poisson_ratio**2))

    @model_validator(mode="after")
    def _thin(self) -> Plate:
        self.check_thin(self.thickness, "thickness: ")
        return self

    def check_point(self, key: str, point: Point) -> None:
        """Raise ValueError, beginning with ``key``, unless a point x, y [m] is on the plate."""
        if not all(0 <= at <= side for at, side in zip(point, self.size, strict=True)):
            raise ValueError(f"{key}: {list(point)} is off the plate of {list(self.size)} m")

    def check_thin(self, thickness: float, head: str = "") -> None:
        """Raise ValueError, beginning with ``head``, unless a thickness [m] is small against the sides."""
        if thickness > min(self.size) / 5:
            limit = "a plate is thinner than a fifth of its side (lengths are in metres)"
            raise ValueError(f"{head}{thickness:g} m is not thin for a side of {min(self.size):g} m; {limit}")


class SceneTables(Table):
    """The top level of a scene file."""

    title: Annotated[Text, Field(examples=["Touch panel"])] = ""
    """Title of tables and pictures."""
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

    @property
    def piezo(self) -> bool:
        """True if the actuators are piezo patches, driven by voltages."""
        return any(actuator.kind == "piezo" for actuator in self.actuators)

    @property
    def piezo_moments(self) -> list[float]:
        """Bending moment per length and volt [N/V] of each piezo patch.

        It is E d31 / (1 − ν) times the distance of the patch's middle from the neutral plane: the plate's own, or that
        of plate and patch if the patch has a density and so counts as a layer. Poisson's ratio is the plate's.
        """
        plate, moments = self.plate, []
        for patch in self.actuators:
            assert patch.d31 is not None
            assert patch.thickness is not None
            assert patch.young_modulus is not None
            stretch, added = plate.young_modulus * plate.thickness, 0.0
            if patch.density is not None:
                added = patch.young_modulus * patch.thickness
            distance = (plate.thickness + patch.thickness) / 2 * stretch / (stretch + added)
            moments.append(patch.young_modulus * patch.d31 / (1 - plate.poisson_ratio) * distance)
        return moments

    @property
    def layers(self) -> tuple[Layer, ...]:
        """Layers of the plate, among them the bodies of piezo patches that have a density."""
        keys = ("area", "thickness", "young_modulus", "density")
        patches = (patch for patch in self.actuators if patch.density is not None)
        return (*self.effects.layers, *(Layer(**{key: getattr(patch, key) for key in keys}) for patch in patches))

    @property
    def targets_by_key(self) -> dict[str, Target]:
        """All targets by key: ``target``, or ``targets[0]``, ``targets[1]``, ..."""
        return {f"targets[{index}]": row for index, row in enumerate(self.targets)} or {"target": self.target}

    @property
    def drive_unit(self) -> str:
        """Unit of all magnitudes, N/m² or, for electrostatic actuators and piezo patches, V."""
        return "V" if self.piezo or self.drive.electrostatic is not None else "N/m²"

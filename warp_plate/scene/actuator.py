"""The table ``[[actuators]]``: the patches that press on the plate or bend it, and coils."""

from typing import Annotated, Any, Literal, Self

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from warp_plate.effects.coil import CoilKeys
from warp_plate.effects.effect import Panel
from warp_plate.scene.fields import (
    LARGEST,
    SMALLEST,
    Density,
    Gain,
    Instant,
    Moderate,
    Name,
    Positive,
    Unit,
    YoungModulus,
)
from warp_plate.scene.target import PlateRegion

# Keys that a piezo patch must have, and those that it may have.
PIEZO, PIEZO_OPTIONS = ("d31", "thickness", "young_modulus"), ("density", "capacitance")


class DrivenPatch(PlateRegion):
    """A patch that presses on the plate, or a piezo patch on its upper face that bends it."""

    name: Annotated[Name, Field(examples=["left"])]
    """Name, different for each actuator."""
    magnitude: Annotated[Moderate, Unit("drive"), Field(examples=[0.5])] = 1.0
    """Amplitude of the pressure or the voltage, see ``Scene.drive_unit``; coils have ``voltage`` or ``current``."""
    force: Annotated[Moderate | None, Unit("N"), Field(examples=[1e-3])] = None
    """Amplitude of the patch's total force, in place of the magnitude."""
    phase: Annotated[Moderate, Unit("rad"), Field(examples=[1.57])] = 0.0
    """Phase lag."""
    frequency: Annotated[Positive | None, Unit("Hz"), Field(examples=[300.0])] = None
    """Frequency (default: that of the drive)."""
    delay: Annotated[Instant | None, Field(examples=[0.002])] = None
    """Start of the burst (default: that of the drive)."""
    kind: Annotated[Literal["pressure", "piezo", "coil"], Field(examples=["piezo"])] = "pressure"
    """How the patch acts; keys from ``d31`` to ``capacitance`` are for "piezo", those from ``model`` on for "coil"."""
    d31: Annotated[Gain | None, Unit("m/V"), Field(examples=[-1.9e-10])] = None
    """Transverse charge coefficient, negative for ceramics."""
    thickness: Annotated[Positive | None, Unit("m"), Field(examples=[2e-4])] = None
    """Thickness of the patch."""
    young_modulus: Annotated[YoungModulus | None, Field(examples=[6.3e10])] = None
    """Young's modulus of the patch."""
    density: Annotated[Density | None, Field(examples=[7800.0])] = None
    """Density of the patch; if given, its mass and stiffness are included as those of a layer."""
    capacitance: Annotated[Positive | None, Unit("F"), Field(examples=[2e-8])] = None
    """Capacitance, for electrical energies."""


class Actuator(CoilKeys, DrivenPatch):
    """A patch that presses on the plate, a piezo patch on its upper face that bends it, or a coil.

    A file gives ``magnitude`` or ``force``. With a force, ``magnitude`` is force / area. The force is what is stored,
    so it is kept if the size of the patch changes. A coil has a ``voltage`` or a ``current`` instead.
    """

    @property
    def amplitude_key(self) -> Literal["magnitude", "force", "voltage", "current"]:
        """Key that gives the amplitude in the scene file."""
        if self.kind == "coil":
            return "current" if self.voltage is None else "voltage"
        return "magnitude" if self.force is None else "force"

    @property
    def amplitude_unit(self) -> str | None:
        """Unit of the number under ``amplitude_key``; None where it is ``Scene.drive_unit``."""
        return {"magnitude": None, "force": "N", "voltage": "V", "current": "A"}[self.amplitude_key]

    @property
    def amplitude_area(self) -> float:
        """Ratio of the number under ``amplitude_key`` to the magnitude: the patch's area [m²] for a force, otherwise
        1."""
        return 1.0 if self.force is None else self.patch_area

    def moment_on(self, plate: Panel) -> float:
        """Return the bending moment per length and volt [N/V] of a piezo patch on a plate; 0 of a coil.

        It is E d31 / (1 − ν) times the distance of the patch's middle from the neutral plane: the plate's own, or that
        of plate and patch if the patch has a density and so counts as a layer. Poisson's ratio is the plate's.
        """
        if self.d31 is None or self.thickness is None or self.young_modulus is None:
            return 0.0
        stretch = plate.young_modulus * plate.thickness
        added = 0.0 if self.density is None else self.young_modulus * self.thickness
        distance = (plate.thickness + self.thickness) / 2 * stretch / (stretch + added)
        return self.young_modulus * self.d31 / (1 - plate.poisson_ratio) * distance

    @model_validator(mode="after")
    def _keys_of_kind(self) -> Self:
        if self.kind == "coil":
            if self.force is not None:
                raise ValueError(
                    f"force: {self.force:g} N, but a coil takes volts or amperes; write voltage or current"
                )
            if "magnitude" in self.model_fields_set:
                raise ValueError(
                    f"magnitude: {self.magnitude:g}, but a coil takes voltage or current; write one of them"
                )
            self._derive("magnitude", getattr(self, self.amplitude_key))
        if self.kind == "piezo":
            if self.area is None:
                raise ValueError(f"{self.shape}: piezo patches are rectangles; write area = [x0, x1, y0, y1]")
            for key in PIEZO:
                if getattr(self, key) is None:
                    raise ValueError(f'{key}: missing; kind = "piezo" takes {", ".join(PIEZO)}')
            if self.force is not None:
                raise ValueError(f"force: {self.force:g} N, but a piezo patch takes volts; write magnitude")
            return self
        for key in (*PIEZO, *PIEZO_OPTIONS):
            if (value := getattr(self, key)) is not None:
                does = "presses" if self.kind == "pressure" else "holds a coil"
                raise ValueError(f'{key}: {value:g}, but the patch {does}; write kind = "piezo", or delete the key')
        return self

    @model_validator(mode="after")
    def _magnitude_of_force(self) -> Self:
        x0, x1, y0, y1 = self.box
        if self.force is None or not (x0 < x1 and y0 < y1):  # the scene refuses such an area
            return self
        area = self.amplitude_area
        if "magnitude" in self.model_fields_set:
            raise ValueError(f"force: {self.force:g} N, beside magnitude = {self.magnitude:g}; delete one of them")
        magnitude = self.force / area if area else float("inf")
        if magnitude and not SMALLEST <= abs(magnitude) <= LARGEST:
            limits = f"{SMALLEST:g} to {LARGEST:g} N/m² are possible"
            raise ValueError(f"force: {self.force:g} N on {area:g} m² press with {magnitude:g} N/m²; {limits}")
        self._derive("magnitude", magnitude)
        return self

    @model_serializer(mode="wrap")
    def _without_derived(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        tables: dict[str, Any] = {"name": self.name, **dump(self)}
        if self.amplitude_key != "magnitude":
            tables.pop("magnitude", None)
        return tables

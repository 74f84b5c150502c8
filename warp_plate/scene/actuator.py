"""The table ``[[actuators]]``: the patches that press on the plate or bend it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from warp_plate.scene.fields import LARGEST, SMALLEST, Area, Gain, Instant, Moderate, Name, Positive, Table

# Keys that a piezo patch must have, and those that it may have.
PIEZO, PIEZO_OPTIONS = ("d31", "thickness", "young_modulus"), ("density", "capacitance")


class Actuator(Table):
    """A patch that presses on the plate, or a piezo patch on its upper face that bends it.

    A file gives ``magnitude`` or ``force``. With a force, ``magnitude`` is force / area. The force is what is stored,
    so it is kept if the size of the patch changes.
    """

    name: Name  # name, different for each actuator
    area: Area  # rectangle x0, x1, y0, y1; for a disc, the square of the same area [m]
    magnitude: Moderate = 1.0  # amplitude of the pressure [N/m²], or of the voltage [V], see ``Scene.drive_unit``
    force: Moderate | None = None  # amplitude of the patch's total force [N], in place of the magnitude
    phase: Moderate = 0.0  # phase lag [rad]
    frequency: Positive | None = None  # frequency [Hz] (default: that of the drive)
    delay: Instant | None = None  # start of the burst [s] (default: that of the drive)
    kind: Literal["pressure", "piezo"] = "pressure"  # how the patch acts; all keys below are for "piezo"
    d31: Gain | None = None  # transverse charge coefficient [m/V], negative for ceramics
    thickness: Positive | None = None  # thickness of the patch [m]
    young_modulus: Annotated[float, Field(ge=1e3, le=1e13)] | None = None  # Young's modulus of the patch [Pa]
    # Density of the patch [kg/m³]; if given, its mass and stiffness are included as those of a layer
    density: Annotated[float, Field(ge=1, le=1e5)] | None = None
    capacitance: Positive | None = None  # capacitance, for electrical energies [F]

    @property
    def amplitude_key(self) -> Literal["magnitude", "force"]:
        """Key that gives the amplitude in the scene file."""
        return "magnitude" if self.force is None else "force"

    @property
    def amplitude_area(self) -> float:
        """Ratio of the number under ``amplitude_key`` to the magnitude: the patch's area [m²] for a force, otherwise
        1."""
        x0, x1, y0, y1 = self.area
        return 1.0 if self.force is None else (x1 - x0) * (y1 - y0)

    @model_validator(mode="after")
    def _keys_of_kind(self) -> Actuator:
        if self.kind == "piezo":
            for key in PIEZO:
                if getattr(self, key) is None:
                    raise ValueError(f'{key}: missing; kind = "piezo" takes {", ".join(PIEZO)}')
            if self.force is not None:
                raise ValueError(f"force: {self.force:g} N, but a piezo patch takes volts; write magnitude")
            return self
        for key in (*PIEZO, *PIEZO_OPTIONS):
            if (value := getattr(self, key)) is not None:
                raise ValueError(f'{key}: {value:g}, but the patch presses; write kind = "piezo", or delete the key')
        return self

    @model_validator(mode="after")
    def _magnitude_of_force(self) -> Actuator:
        x0, x1, y0, y1 = self.area
        if self.force is None or not (x0 < x1 and y0 < y1):  # the scene refuses such an area
            return self
        area = self.amplitude_area
        if "magnitude" in self.model_fields_set:
            raise ValueError(f"force: {self.force:g} N, beside magnitude = {self.magnitude:g}; delete one of them")
        magnitude = self.force / area if area else float("inf")
        if magnitude and not SMALLEST <= abs(magnitude) <= LARGEST:
            limits = f"{SMALLEST:g} to {LARGEST:g} N/m² are possible"
            raise ValueError(f"force: {self.force:g} N on {area:g} m² press with {magnitude:g} N/m²; {limits}")
        object.__setattr__(self, "magnitude", magnitude)  # the table is frozen for everybody else
        return self

    @model_serializer(mode="wrap")
    def _without_derived(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        tables: dict[str, Any] = dump(self)
        if self.force is not None:
            tables.pop("magnitude", None)
        return tables

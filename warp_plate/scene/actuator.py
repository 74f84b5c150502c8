"""The table ``[[actuators]]``: the patches that press on the plate."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import SerializerFunctionWrapHandler, model_serializer, model_validator

from warp_plate.scene.fields import LARGEST, SMALLEST, Area, Instant, Moderate, Name, Positive, Table


class Actuator(Table):
    """A patch that presses on the plate.

    A file gives ``magnitude`` or ``force``. With a force ``magnitude`` is force / area; the force is what is written
    back, so that it also holds after the patch has another size.
    """

    name: Name  # name, different for each actuator
    area: Area  # rectangle x0, x1, y0, y1 [m]
    magnitude: Moderate = 1.0  # amplitude of the pressure [N/m²], or of the voltage [V] under ``[drive.electrostatic]``
    force: Moderate | None = None  # amplitude of the patch's total force [N], in place of the magnitude
    phase: Moderate = 0.0  # phase lag [rad]
    frequency: Positive | None = None  # frequency [Hz] (default: that of the drive)
    delay: Instant | None = None  # start of the burst [s] (default: that of the drive)

    @property
    def amplitude_key(self) -> Literal["magnitude", "force"]:
        """Key that gives the amplitude in the scene file."""
        return "magnitude" if self.force is None else "force"

    @property
    def amplitude_area(self) -> float:
        """Ratio of the number under ``amplitude_key`` to the magnitude: the patch's area [m²] for a force, else 1."""
        x0, x1, y0, y1 = self.area
        return 1.0 if self.force is None else (x1 - x0) * (y1 - y0)

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

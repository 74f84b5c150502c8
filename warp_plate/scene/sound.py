"""Limits of the sound at points in front of a plate, as searches and specifications have them."""

from typing import Annotated

from pydantic import Field

from warp_plate.scene.fields import Moderate, Positive, Table, Unit

SoundLevel = Annotated[float, Field(ge=-200, le=200), Unit("dB(A)")]


class PressureLimit(Table):
    """A largest level of the sound at a point in front of the plate, which is in a baffle; see docs/sound.md."""

    point: Annotated[tuple[Moderate, Moderate, Positive], Unit("m"), Field(examples=[[0.1, 0.1, 1.0]])]
    """x and y in the plane of the plate, whose corner is at the origin, and height z above it."""
    level: Annotated[SoundLevel, Field(examples=[35.0])]
    """Largest A-weighted sound pressure level, re 20 µPa."""

    @property
    def name(self) -> str:
        """Name of the limited sound."""
        return "sound at {:g},{:g},{:g} m".format(*self.point)

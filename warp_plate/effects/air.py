"""The air beside the plate, which moves with it and carries its sound away."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from warp_plate.effects.effect import Effect, Setting
from warp_plate.scene.fields import Flag, Positive, Unit

# Density [kg/m³] and speed of sound [m/s] of dry air at 20 °C and 101.325 kPa.
AIR_DENSITY, SOUND_SPEED = 1.204, 343.2


class AirLoad(Effect):
    """The load of the air on a plate, in a rigid baffle or not: the mass of air that moves with it, and radiation as a
    loss.

    Both depend on the frequency, so that it is defined only for steady tones and needs the modal engine. ``[window]``
    is not read: energies are means over all time. The sound is that of this air too.
    """

    density: Annotated[Positive, Field(le=1e4, examples=[1.2]), Unit("kg/m³")] = AIR_DENSITY
    """Density of the air."""
    sound_speed: Annotated[Positive, Field(le=1e4, examples=[343.0]), Unit("m/s")] = SOUND_SPEED
    """Speed of sound."""
    sides: Annotated[Literal["both", "front"], Field(examples=["front"])] = "both"
    """Place of the air: on both sides of the plate, or in front of it only."""
    baffle: Annotated[Flag, Field(examples=[False])] = True
    """False for a rectangle with air on both sides that is open at the back, without a baffle around it."""

    stepped = False
    steady = True

    @classmethod
    def typical(cls, setting: Setting) -> tuple[Any, str]:
        return cls(), "air at 20 °C on both sides"

    @property
    def lossy(self) -> bool:
        return True

    def check(self, outlined: bool, sounds: Sequence[str | None]) -> None:
        """Raise ValueError if a plate with an outline, or limits of sound by their keys, need a baffle."""
        if not self.baffle and outlined:
            raise ValueError("effects.air.baffle: false, which is solved for rectangles; delete it, or plate.outline")
        for key in sounds if not self.baffle else ():
            if key is not None:
                raise ValueError(f"{key}: is the sound of a plate in a baffle; delete it, or effects.air.baffle")

    @model_validator(mode="after")
    def _open_on_both_sides(self) -> Self:
        if not self.baffle and self.sides == "front":
            raise ValueError('sides: "front", but without a baffle air is on both sides; delete sides, or baffle')
        return self

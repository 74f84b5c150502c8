"""Kelvin-Voigt damping of the plate's material."""

from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import Field

from warp_plate.effects.damping import TYPICAL_LOSS
from warp_plate.effects.effect import Effect, Panel, Setting, Term
from warp_plate.scene.fields import NotNegative, Unit


class MaterialDamping(Effect):
    """Kelvin-Voigt damping of the plate's material: bending moments follow u + time·u̇ instead of u."""

    time: Annotated[NotNegative, Unit("s"), Field(examples=[1e-5])]
    """Retardation time; a mode of angular frequency ω has the loss factor time·ω."""

    damping_keys = ("time",)

    def terms(self, plate: Panel) -> Iterator[Term]:
        yield Term("damping", self.time, multiple_of="bending")

    @classmethod
    def typical(cls, setting: Setting) -> tuple[Any, str]:
        time = TYPICAL_LOSS / setting.angular_frequency
        return cls(time=time), f"{time:.2g} s (loss factor {TYPICAL_LOSS:g} at the drive's frequency)"

"""Viscous damping of each mode."""

from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import Field

from warp_plate.effects.damping import TYPICAL_LOSS
from warp_plate.effects.effect import Effect, Panel, Setting, Term
from warp_plate.effects.loss_factor import PerMode
from warp_plate.scene.fields import Unit


class ModalDamping(Effect):
    """Viscous damping of each mode, 2ζω on its velocity, added to all other damping. It needs the modal engine.

    A list gives the damping ratio of each mode in order; the last one holds for all higher modes.
    """

    ratio: Annotated[PerMode, Unit("1"), Field(examples=[[0.02, 0.01]])]
    """Damping ratio ζ."""

    stepped = False
    damping_keys = ("ratio",)

    def terms(self, plate: Panel) -> Iterator[Term]:
        yield Term("damping", self.ratio, multiple_of="modes")

    @classmethod
    def typical(cls, setting: Setting) -> tuple[Any, str]:
        return cls(ratio=TYPICAL_LOSS / 2), f"damping ratio {TYPICAL_LOSS / 2:g} of all modes"

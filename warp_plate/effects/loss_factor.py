"""Hysteretic damping, of steady tones."""

from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import Discriminator, Field, Tag

from warp_plate.effects.damping import TYPICAL_LOSS
from warp_plate.effects.effect import Effect, Panel, Setting, Term
from warp_plate.scene.fields import NotNegative, Unit

Fraction = Annotated[NotNegative, Field(lt=1)]
Fractions = Annotated[tuple[Fraction, ...], Field(min_length=1)]
# A number for all modes, or one for each in order, the last of which holds for all higher modes.
PerMode = Annotated[
    Annotated[Fraction, Tag("number")] | Annotated[Fractions, Tag("list")],
    Discriminator(lambda value: "list" if isinstance(value, list | tuple) else "number"),
]


class LossFactor(Effect):
    """Hysteretic damping: the bending stiffness times 1 + iη, with a loss factor η that does not depend on frequency.

    It is defined only for steady tones and needs the modal engine. ``[window]`` is not read: energies are means over
    all time. A list gives the loss factor of each mode in order; the last one holds for all higher modes.
    """

    eta: Annotated[PerMode, Unit("1"), Field(examples=[0.02])]
    """Loss factor η."""

    stepped = False
    steady = True
    damping_keys = ("eta",)

    def terms(self, plate: Panel) -> Iterator[Term]:
        yield Term("hysteretic", self.eta, multiple_of="modes" if isinstance(self.eta, tuple) else "bending")

    @classmethod
    def typical(cls, setting: Setting) -> tuple[Any, str]:
        return cls(eta=TYPICAL_LOSS), f"loss factor {TYPICAL_LOSS:g}"

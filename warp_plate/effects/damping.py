"""Damping of the whole plate: viscous, of its material, hysteretic, and mode by mode."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from warp_plate.effects.effect import Effect, Panel, Setting, Term
from warp_plate.scene.fields import NotNegative, Unit

# Loss factor at the drive's frequency, typical of plastics and glued joints.
TYPICAL_LOSS = 0.02
Fraction = Annotated[NotNegative, Field(lt=1)]
Fractions = Annotated[tuple[Fraction, ...], Field(min_length=1)]
# A number for all modes, or one for each in order, the last of which holds for all higher modes.
PerMode = Annotated[
    Annotated[Fraction, Tag("number")] | Annotated[Fractions, Tag("list")],
    Discriminator(lambda value: "list" if isinstance(value, list | tuple) else "number"),
]


class Damping(Effect):
    """Viscous damping, c u̇ on the left of the equation of motion."""

    viscous: Annotated[NotNegative, Unit("N·s/m³"), Field(examples=[88.0])]
    """Damping c."""
    scheme: Annotated[Literal["centred", "backward"], Field(examples=["backward"])] = "centred"
    """Velocity that is damped: "centred" in the step (second order, same stability limit), or "backward", from the
    last half-step, as in equation (6) of the source paper (first order, lower limit)."""

    damping_keys = ("viscous",)

    def terms(self, plate: Panel) -> Iterator[Term]:
        yield Term("damping", self.viscous)

    @classmethod
    def typical(cls, setting: Setting) -> tuple[Any, str]:
        plate = setting.plate
        viscous = TYPICAL_LOSS * setting.angular_frequency * plate.density * plate.thickness
        return cls(viscous=viscous), f"{viscous:.2g} N·s/m³ (loss factor {TYPICAL_LOSS:g})"


class MaterialDamping(Effect):
    """Kelvin-Voigt damping of the plate's material: bending moments follow u + time·u̇ instead of u."""

    time: Annotated[NotNegative, Unit("s"), Field(examples=[1e-5])]
    """Retardation time; a mode of angular frequency ω has the loss factor time·ω."""

    damping_keys = ("time",)

    def terms(self, plate: Panel) -> Iterator[Term]:
        yield Term("damping", self.time, of="bending")

    @classmethod
    def typical(cls, setting: Setting) -> tuple[Any, str]:
        time = TYPICAL_LOSS / setting.angular_frequency
        return cls(time=time), f"{time:.2g} s (loss factor {TYPICAL_LOSS:g} at the drive's frequency)"


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
        yield Term("hysteretic", self.eta, of="modes" if isinstance(self.eta, tuple) else "bending")

    @classmethod
    def typical(cls, setting: Setting) -> tuple[Any, str]:
        return cls(eta=TYPICAL_LOSS), f"loss factor {TYPICAL_LOSS:g}"


class ModalDamping(Effect):
    """Viscous damping of each mode, 2ζω on its velocity, added to all other damping. It needs the modal engine.

    A list gives the damping ratio of each mode in order; the last one holds for all higher modes.
    """

    ratio: Annotated[PerMode, Unit("1"), Field(examples=[[0.02, 0.01]])]
    """Damping ratio ζ."""

    stepped = False
    damping_keys = ("ratio",)

    def terms(self, plate: Panel) -> Iterator[Term]:
        yield Term("damping", self.ratio, of="modes")

    @classmethod
    def typical(cls, setting: Setting) -> tuple[Any, str]:
        return cls(ratio=TYPICAL_LOSS / 2), f"damping ratio {TYPICAL_LOSS / 2:g} of all modes"

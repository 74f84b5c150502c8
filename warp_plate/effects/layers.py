"""Layers bonded to parts of the plate; :mod:`warp_plate.plate.section` adds them to its rigidities and mass."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from warp_plate.effects.effect import Effect, Setting
from warp_plate.scene.fields import Area, Flag, NotNegative, Positive, Unit


class Layer(Effect):
    """Material bonded to the plate over a rectangle: a stiffener, a foil, the body of an actuator."""

    area: Annotated[Area, Unit("m"), Field(examples=[[0.02, 0.06, 0.03, 0.07]])]
    """Rectangle x0, x1, y0, y1."""
    thickness: Annotated[Positive, Unit("m"), Field(examples=[2e-4])]
    """Thickness on each face that has the layer."""
    young_modulus: Annotated[NotNegative, Field(le=1e13, examples=[2e9]), Unit("Pa")]
    """Young's modulus; Poisson's ratio is that of the plate."""
    density: Annotated[NotNegative, Field(le=1e5, examples=[1800.0]), Unit("kg/m³")]
    """Density."""
    both: Annotated[Flag, Field(examples=[True])] = False
    """True for a layer on both faces; a layer on one face shifts the neutral plane."""

    in_kernels = False

    @classmethod
    def typical(cls, setting: Setting) -> tuple[Any, str]:
        return film(setting.patches), "a piezoelectric film of 110 µm, 2.5 GPa, 1780 kg/m³ on each actuator"


def film(areas: tuple[Area, ...]) -> tuple[Layer, ...]:
    """Return a film of polyvinylidene fluoride, glued on as an actuator, on one face over each rectangle [m]."""
    return tuple(Layer(area=area, thickness=110e-6, young_modulus=2.5e9, density=1780.0) for area in areas)

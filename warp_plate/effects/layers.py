"""Layers bonded to parts of the plate; :mod:`warp_plate.plate.section` adds them to its rigidities and mass."""

import itertools
from collections.abc import Iterable, Sequence
from typing import Annotated, Any

from pydantic import Field

from warp_plate.effects.effect import Effect, Setting
from warp_plate.outline.outline import shared_areas
from warp_plate.scene.fields import Flag, NotNegative, Positive, Unit
from warp_plate.scene.target import PlateRegion

# Part of a layer that another one covers within rounding.
COVERED = 1e-6


class Layer(Effect, PlateRegion):
    """Material bonded to a part of the plate: a stiffener, a foil, the body of an actuator."""

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


def check_layers(layers: Sequence[Layer]) -> None:
    """Raise ValueError if layers of shapes other than rectangles along x and y lie on each other."""
    shaped = {index: layer for index, layer in enumerate(layers) if layer.area is None}
    for (one, first), (two, second) in itertools.combinations(shaped.items(), 2):
        shared = shared_areas([first.flattened()], [second.flattened()])[0, 0]
        if shared > COVERED * min(first.patch_area, second.patch_area):
            head = f"effects.layers[{two}].{second.description}: overlaps effects.layers[{one}]"
            raise ValueError(f"{head}, and only layers with area lie on others; move it beside that one")


def film(patches: Iterable[PlateRegion]) -> tuple[Layer, ...]:
    """Return a film of polyvinylidene fluoride, glued on as an actuator, on one face over each patch."""
    film = {"thickness": 110e-6, "young_modulus": 2.5e9, "density": 1780.0}
    return tuple(Layer(**dict(patch.region), **film) for patch in patches)

"""Stretching at large amplitude; its kernel and NumPy functions take Berger's tension from ``plate/bending.py``."""

from typing import Any

from warp_plate.effects.effect import Effect, Setting


class Stretching(Effect):
    """Stretching at large amplitude, after Berger, for an isotropic plate with in-plane fixed edges: the tension
    N = 6D/(H² area) ∫ |∇u|² dA, −N∇²u on the left of the equation of motion."""

    linear = False

    @classmethod
    def typical(cls, setting: Setting) -> tuple[Any, str]:
        return cls(), "named"

"""The continuous plate of a scene, without a grid, for the exact and the Ritz references."""

from __future__ import annotations

from dataclasses import dataclass

from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import ElasticEdge, Scene

EDGES = ("clamped", "supported", "free")
Held = str | ElasticEdge


@dataclass(frozen=True)
class ThinPlate:
    """A rectangular Kirchhoff-Love plate, ρH ü + c u̇ + D∇⁴u = f."""

    size: tuple[float, float]  # (a, b) [m]
    edges: tuple[Held, Held, Held, Held]  # Left, bottom, right and top edge, each one of EDGES or on springs
    rigidity: float  # D = EH³ / 12(1 − ν²) [N·m]
    poisson_ratio: float  # ν, which matters only if an edge is free or on springs
    surface_density: float  # ρH [kg/m²]
    viscous: float = 0.0  # c [N·s/m³]


def thin_plate(scene: Scene) -> ThinPlate:
    """Return the plate of a scene; its grid and time steps play no part.

    Raises:
        SceneError: The references do not know one of its edges or effects, or its drive.
    """
    edges = (scene.edges.left, scene.edges.bottom, scene.edges.right, scene.edges.top)
    for side, edge in zip(("left", "bottom", "right", "top"), edges, strict=True):
        if edge not in EDGES and not isinstance(edge, ElasticEdge):
            raise SceneError(f"edges.{side} = {edge}: the reference solutions know {', '.join(EDGES)}, springs")
    for effect, table in scene.effects:
        if effect != "damping" and table:
            raise SceneError(f"effects.{effect}: the reference solutions know viscous damping and no other effect")
    if scene.nonharmonic_key is not None:
        raise SceneError(f"{scene.nonharmonic_key}: the reference solutions know one frequency from t = 0 on")
    plate, damping = scene.plate, scene.effects.damping
    return ThinPlate(
        size=plate.size,
        edges=edges,
        rigidity=plate.young_modulus * plate.thickness**3 / (12 * (1 - plate.poisson_ratio**2)),
        poisson_ratio=plate.poisson_ratio,
        surface_density=plate.density * plate.thickness,
        viscous=damping.viscous if damping else 0.0,
    )

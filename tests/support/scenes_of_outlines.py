"""Small scenes of plates with outlines."""

import math

from support.scenes import MATERIAL, scene_of


def outlined(outline, edge="clamped", holes=(), parts=(), material=MATERIAL, **tables):
    """Return a scene of a plate with an outline, in place of the rectangle of :func:`support.scenes.scene_of`."""
    tables = {"actuators": [(0.08, 0.11, 0.06, 0.09)], "modal_density": 1.0, **tables}
    plate = {**material, "outline": outline, "holes": [*holes]}
    edges = {"outline": edge, "parts": [*parts]}
    return scene_of(**{"plate": plate, **tables, "edges": ("clamped",) * 4}).with_tables(edges=edges)


def dimensionless(scene, frequencies, length):
    """Return ωL²√(ρH/D) of frequencies [Hz]."""
    plate = scene.plate
    return 2 * math.pi * frequencies * length**2 * math.sqrt(plate.density * plate.thickness / plate.rigidity)

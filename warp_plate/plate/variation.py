"""Variation of thickness, stiffness and density over the plate, from arrays in the scene or in files."""

from __future__ import annotations

import numpy as np

from warp_plate.plate.files import read_table
from warp_plate.scene.effects import LEAST_FACTOR, MOST_FACTOR, Variation
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene


def factors_at_nodes(scene: Scene) -> dict[str, np.ndarray]:
    """Return (ny, nx) factors of thickness, young_modulus and density by name; ones where the scene has no array.

    Arrays are interpolated bilinearly and not averaged: one finer than the grid is sampled.

    Raises:
        SceneError: A file cannot be read or holds no such array, or the plate is not thin everywhere.
    """
    (nx, ny), variation = scene.grid.nodes, scene.effects.variation
    factors = {key: np.ones((ny, nx)) for key in Variation.model_fields}
    for key, given in variation or ():
        if given is None:
            continue
        head = f"effects.variation.{key}"
        if isinstance(given, str):
            array = read_table(head, given, scene.folder, LEAST_FACTOR, MOST_FACTOR)
            head += f" = {given!r}"
        else:
            array = np.array(given)
        if key == "thickness":
            try:
                scene.plate.check_thin(scene.plate.thickness * array.max())
            except ValueError as error:
                raise SceneError(f"{head}: {error}") from None
        factors[key] = _interpolate(_interpolate(array, ny).T, nx).T
    return factors


def _interpolate(values: np.ndarray, count: int) -> np.ndarray:
    """Return (count, ...) evenly spaced values, linear between the rows (rows, ...), from the first to the last."""
    where = np.linspace(0, len(values) - 1, count)
    low = np.minimum(where.astype(int), max(len(values) - 2, 0))
    high, part = np.minimum(low + 1, len(values) - 1), (where - low)[:, None]
    interpolated: np.ndarray = (1 - part) * values[low] + part * values[high]
    return interpolated

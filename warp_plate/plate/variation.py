"""Variation of thickness, stiffness and density over the plate, from arrays in the scene or in files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from warp_plate.plate.files import number_rows, read_beside
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
        head = f"effects.variation.{key}" + (f" = {given!r}" if isinstance(given, str) else "")
        try:
            values = _read(f"effects.variation.{key}", given, scene.folder) if isinstance(given, str) else given
            array = np.array(values)
            if key == "thickness":
                scene.plate.check_thin(scene.plate.thickness * array.max())
        except ValueError as error:
            raise error if isinstance(error, SceneError) else SceneError(f"{head}: {error}") from None
        factors[key] = _interpolate(_interpolate(array, ny).T, nx).T
    return factors


def _read(key: str, name: str, folder: Path | None) -> list[list[float]]:
    rows = number_rows(read_beside(key, name, folder))
    if not rows:
        raise ValueError("holds no numbers")
    for number, row in rows:
        for column, value in enumerate(row, 1):
            if not LEAST_FACTOR <= value <= MOST_FACTOR:
                raise ValueError(
                    f"line {number}, column {column}: {value:g} is no factor from {LEAST_FACTOR:g} to {MOST_FACTOR:g}"
                )
    return [row for _, row in rows]


def _interpolate(values: np.ndarray, count: int) -> np.ndarray:
    """Return (count, ...) evenly spaced values, linear between the rows (rows, ...), from the first to the last."""
    where = np.linspace(0, len(values) - 1, count)
    low = np.minimum(where.astype(int), max(len(values) - 2, 0))
    high, part = np.minimum(low + 1, len(values) - 1), (where - low)[:, None]
    interpolated: np.ndarray = (1 - part) * values[low] + part * values[high]
    return interpolated

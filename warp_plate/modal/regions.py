"""Mass matrices of parts of a plate: ∫ ρH X_i X_k Y_j Y_l dA over rectangles, discs, polygons and masks.

A rectangle or mask adds its lines to Gauss's rule. A disc or polygon is cut into chords along x: Gauss's rule along y
between the lines where the chords' ends are not smooth, and along x between the knots on each chord. On a disc the rule
is in the angle, y = y₀ + r sin θ, in which the chords' ends are smooth.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from warp_plate.modal.galerkin import Galerkin, Integrals, Matrix
from warp_plate.modal.splines import gauss
from warp_plate.plate.section import interpolate
from warp_plate.plate.shapes import clipped, read_mask
from warp_plate.scene.fields import Area
from warp_plate.scene.target import Target

# Corners of the polygon for the part of a disc in a rectangle.
DISC_CORNERS = 512


def region_matrix(galerkin: Galerkin, region: Area | Target, within: Area | None = None) -> Matrix:
    """Return the mass matrix [kg] of a region of the plate, without the oscillators' masses but of the same size.

    Args:
        galerkin: Plate.
        region: Rectangle x0, x1, y0, y1 [m], or target.
        within: Rectangle outside which the region does not count (default: none).

    Raises:
        SceneError: The file of a mask cannot be read.
    """
    area = region.area if isinstance(region, Target) else region
    if area is not None:
        matrix = _over_rectangle(galerkin, _common(area, within))
    elif isinstance(region, Target) and region.mask is not None:
        matrix = _over_mask(galerkin, region, within)
    else:
        assert isinstance(region, Target)
        matrix = _over_chords(galerkin, region, within)
    matrix.resize(galerkin.mass.shape)
    return matrix


def _common(first: Area, second: Area | None) -> Area:
    if second is None:
        return first
    return max(first[0], second[0]), min(first[1], second[1]), max(first[2], second[2]), min(first[3], second[3])


def _over_rectangle(galerkin: Galerkin, area: Area) -> Matrix:
    integrals = Integrals(galerkin.scene, galerkin.along_x, galerkin.along_y, (area[:2], area[2:]))
    return integrals.matrix(integrals.fields()[-1] * integrals.inside(area))


def _over_mask(galerkin: Galerkin, target: Target, within: Area | None) -> Matrix:
    """Return the matrix of a mask, which is bilinear between its numbers."""
    scene = galerkin.scene
    key = next((key for key, each in scene.targets_by_key.items() if each == target), "target")
    values = read_mask(scene, key, target)
    (width, height), (rows, columns) = scene.plate.size, values.shape
    area = _common((0.0, width, 0.0, height), within)
    cuts = [*np.linspace(0, width, max(columns, 2)), *area[:2]], [*np.linspace(0, height, max(rows, 2)), *area[2:]]
    integrals = Integrals(scene, galerkin.along_x, galerkin.along_y, cuts)
    x, y = integrals.points
    share = interpolate(interpolate(values, y / height * (rows - 1)).T, x / width * (columns - 1)).T
    return integrals.matrix(integrals.fields()[-1] * share * integrals.inside(area))


def _over_chords(galerkin: Galerkin, target: Target, within: Area | None) -> Matrix:
    scene, along_x, along_y = galerkin.scene, galerkin.along_x, galerkin.along_y
    integrals = Integrals(scene, along_x, along_y)
    count, breaks = integrals.rule, integrals.breaks
    if target.disc is not None and within is None:
        y, weights, chords = _disc_chords(target.disc, breaks[1], count)
    else:
        corners = target.corners(DISC_CORNERS)
        assert corners is not None
        y, weights, chords = _polygon_chords(corners if within is None else clipped(corners, within), breaks[1], count)
    rows, columns = integrals.pairs[0]
    along, ordinates = [], []
    for ordinate, weight, (low, high) in zip(y, weights, chords, strict=True):
        inside = breaks[0][(breaks[0] > low) & (breaks[0] < high)]
        x, shares = gauss(np.concatenate([[low], inside, [high]]), count)
        values = along_x.values(x)
        density = integrals.fields_at(x, np.array([ordinate]))[-1][0]
        along.append((values[rows] * (values[columns] * shares * density)).sum(axis=1) * weight)
        ordinates.append(ordinate)
    rows, columns = integrals.pairs[1]
    values = along_y.values(np.array(ordinates))
    return integrals.scatter((values[rows] * values[columns]) @ np.array(along))


def _disc_chords(
    disc: tuple[float, float, float], breaks: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, list[tuple[float, float]]]:
    """Return ordinates, weights and ends of the chords of a disc x, y, radius [m]."""
    x, y, radius = disc
    cuts = np.clip((breaks - y) / radius, -1, 1)
    angle, weight = gauss(np.unique(np.concatenate([[-math.pi / 2, 0, math.pi / 2], np.arcsin(cuts)])), count)
    half = radius * np.cos(angle)
    return y + radius * np.sin(angle), weight * half, list(zip(x - half, x + half, strict=True))


def _polygon_chords(
    corners: np.ndarray, breaks: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, list[tuple[float, float]]]:
    """Return the same of a polygon (corners, 2) [m]; an ordinate returns for each chord at it."""
    if len(corners) < 3:
        return np.empty(0), np.empty(0), []
    low, high = corners[:, 1].min(), corners[:, 1].max()
    inside = breaks[(breaks > low) & (breaks < high)]
    y, weights = gauss(np.unique(np.concatenate([corners[:, 1], inside])), count)
    found = [(at, weight, chord) for at, weight in zip(y, weights, strict=True) for chord in _chords_at(corners, at)]
    ordinates, shares, chords = zip(*found, strict=True)
    return np.array(ordinates), np.array(shares), list(chords)


def _chords_at(corners: np.ndarray, y: float) -> Iterator[tuple[float, float]]:
    (x0, y0), (x1, y1) = corners.T, np.roll(corners, -1, axis=0).T
    crossed = (y0 < y) != (y1 < y)
    x = np.sort((x0 + (x1 - x0) * (y - y0) / np.where(crossed, y1 - y0, 1))[crossed])
    yield from ((low, high) for low, high in zip(x[::2], x[1::2], strict=True) if high > low)

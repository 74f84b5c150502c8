"""Mass matrices of parts of a plate: ∫ ρH X_i X_k Y_j Y_l dA over rectangles, discs, polygons and masks.

The sides of a rectangle and the lines of a mask are further breaks of Gauss's rule. A disc or polygon is cut into
chords along x, with Gauss's rule along each chord, and along y for the integrals over the chords. These are smooth in y
between knots, corners, and the points of the outline where a chord ends on a line across which the mass or the splines
are not smooth. On a disc the rule is in the angle θ, y = y₀ + r sin θ, as the chords' length r cos θ is smooth in it.
"""

from __future__ import annotations

import math

import numpy as np

from warp_plate.modal.spaces.integrals import Integrals
from warp_plate.modal.spaces.knots import lines
from warp_plate.modal.spaces.splines import Splines, gauss
from warp_plate.plate.section import bilinear
from warp_plate.plate.shapes import clipped, read_mask
from warp_plate.scene.fields import Area
from warp_plate.scene.model import Scene
from warp_plate.scene.target import Target

# Corners of the polygon for the part of a disc in a rectangle.
DISC_CORNERS = 512


def region_values(
    scene: Scene, along: tuple[Splines, Splines], region: Area | Target, within: Area | None
) -> np.ndarray:
    """Return ∫ ρH u u dA over a region [kg], for each pair of functions of y and of x; see ``region_matrix``."""
    area = region.area if isinstance(region, Target) else region
    if area is not None:
        area = _common(area, within)
        integrals = Integrals(scene, *along, (area[:2], area[2:]))
        return integrals.values(integrals.fields()[-1] * integrals.inside(area))
    assert isinstance(region, Target)
    if region.mask is not None:
        return _over_mask(scene, along, region, within)
    return _over_chords(scene, along, region, within)


def _common(first: Area, second: Area | None) -> Area:
    if second is None:
        return first
    return max(first[0], second[0]), min(first[1], second[1]), max(first[2], second[2]), min(first[3], second[3])


def _over_mask(scene: Scene, along: tuple[Splines, Splines], target: Target, within: Area | None) -> np.ndarray:
    """Return the values of a mask, which is bilinear between its numbers."""
    key = next((key for key, listed in scene.targets_by_key.items() if listed == target), "target")
    mask = read_mask(scene, key, target)
    (width, height), (rows, columns) = scene.plate.size, mask.shape
    area = _common((0.0, width, 0.0, height), within)
    cuts = [*np.linspace(0, width, max(columns, 2)), *area[:2]], [*np.linspace(0, height, max(rows, 2)), *area[2:]]
    integrals = Integrals(scene, *along, cuts)
    x, y = integrals.points
    share = bilinear(mask, x / width, y / height)
    return integrals.values(integrals.fields()[-1] * share * integrals.inside(area))


def _over_chords(scene: Scene, along: tuple[Splines, Splines], target: Target, within: Area | None) -> np.ndarray:
    """Return the values of a disc or polygon; part of a disc counts as part of a polygon of DISC_CORNERS corners."""
    integrals = Integrals(scene, *along)
    count, (breaks_x, breaks_y) = integrals.rule, integrals.breaks
    places = np.array([place for place, _ in lines(scene, 0)])
    if target.disc is not None and within is None:
        y, weights, chords = _disc_chords(target.disc, places, breaks_y, count)
    else:
        corners = target.corners(DISC_CORNERS)
        assert corners is not None
        corners = corners if within is None else clipped(corners, within)
        y, weights, chords = _polygon_chords(corners, places, breaks_y, count)
    rows, columns = integrals.pairs[0]
    along_x = np.empty((y.size, rows.size))
    for number, (low, high) in enumerate(chords):
        inside = breaks_x[(breaks_x > low) & (breaks_x < high)]
        x, shares = gauss(np.concatenate([[low], inside, [high]]), count)
        values = along[0].values(x)
        density = integrals.fields_at(x, y[number : number + 1])[-1][0]
        along_x[number] = (values[rows] * values[columns]) @ (shares * density * weights[number])
    rows, columns = integrals.pairs[1]
    values = along[1].values(y)
    return np.asarray((values[rows] * values[columns]) @ along_x)


def _disc_chords(
    disc: tuple[float, float, float], places: np.ndarray, breaks: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, list[tuple[float, float]]]:
    """Return ordinates [m], weights and ends [m] of the chords of a disc x, y, radius [m], by ``count`` Gauss points
    between places along x at which integrals are not smooth in the chords' ends, and breaks along y [m]."""
    x, y, radius = disc
    half = np.abs(places - x) / radius
    ends = np.arccos(half[half < 1])
    cuts = np.arcsin(np.clip((breaks - y) / radius, -1, 1))
    angle, weight = gauss(np.unique(np.concatenate([[-math.pi / 2, 0, math.pi / 2], cuts, ends, -ends])), count)
    half = radius * np.cos(angle)
    return y + radius * np.sin(angle), weight * half, list(zip(x - half, x + half, strict=True))


def _polygon_chords(
    corners: np.ndarray, places: np.ndarray, breaks: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, list[tuple[float, float]]]:
    """Return the same of a polygon (corners, 2) [m]; an ordinate returns for each chord at it."""
    if len(corners) < 3:
        return np.empty(0), np.empty(0), []
    (x0, y0), (x1, y1) = corners.T, np.roll(corners, -1, axis=0).T
    share = (places[:, None] - x0) / np.where(x1 == x0, math.inf, x1 - x0)
    ends = (y0 + share * (y1 - y0))[(share > 0) & (share < 1)]
    inside = breaks[(breaks > y0.min()) & (breaks < y0.max())]
    y, weights = gauss(np.unique(np.concatenate([y0, inside, ends])), count)
    ordinates, shares, chords = [], [], []
    for at, weight in zip(y, weights, strict=True):
        crossed = (y0 < at) != (y1 < at)
        x = np.sort((x0 + (x1 - x0) * (at - y0) / np.where(crossed, y1 - y0, 1))[crossed])
        for low, high in zip(x[::2], x[1::2], strict=True):
            if high > low:
                ordinates.append(at)
                shares.append(weight)
                chords.append((low, high))
    return np.array(ordinates), np.array(shares), chords

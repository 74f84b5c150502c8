"""Points of a region of the plate at which a field is largest, between the points of any grid.

A region is sampled inside and along its outlines. Around each sample that exceeds its neighbours a finer grid shows
whether there are several maxima, from which climbers (``optimize.climbers``) move to the maxima between samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from itertools import pairwise
from typing import Literal

import numpy as np
import shapely

from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.spaces.space import Matrix
from warp_plate.optimize.climbers import (
    ALONG,
    AROUND,
    FEW_SHRINKS,
    SHRINKS,
    Climbers,
    bends,
    climb,
    parabolic_summits,
    quadratic_summits,
)
from warp_plate.outline.pieces import Arc
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.target import Target

# Corners of a full turn of a round outline.
CORNERS = 1024
# Maxima that are returned: the FEWEST highest samples at least, and up to MOST that lie below the highest one by at
# most what a sample may miss of its maximum (24 samples a wave: 1 - cos(2π/48) along each axis).
FEWEST, MISSED, MOST = 12, 0.03, 200
# Turn [rad] at a corner that is a sample; those of round outlines are not.
SHARP = 0.05
# Width of a seam [of the longer side] within which points count as those of a region.
SEAM = 1e-9
# Largest turn [rad] of a side of the polygon that stands for a plate with an outline.
TURN = 2e-3
Values = Callable[[np.ndarray], np.ndarray]
NEIGHBOURS = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
# Steps of the finer grid around a sample, three to a spacing of samples.
FINE = np.stack(np.meshgrid(np.arange(-6, 7) / 3, np.arange(-6, 7) / 3), axis=-1)
# Steps of Gauss and Newton: their number, differences and largest length [spacings], the part of the trace that is
# added to the diagonal, and the parts of a step that are tried.
DIP_STEPS, DIFFERENCE, STRIDE, DAMPING, FRACTIONS = 7, 1e-3, 2.0, 1e-12, np.array([0.0, 0.03, 0.1, 0.3, 1.0])
# Gain of a round, relative to the largest value, below which a search ends that meets no corners, as on lines.
CONVERGED = 1e-12
# How much lower than the highest the maxima may be that others are sought beside, how much lower the field there, and
# how far away [spacings].
RIDGE, FALLEN, BESIDE = 1e-3, 1e-2, np.array([-3.0, -1.5, 1.5, 3.0])[:, None]


def shape_of(key: str, target: Target, side: Literal[-1, 0, 1] = 0) -> shapely.Geometry:
    """Return the polygon [m] of a target: inside its curve (``side`` -1), around it (1), or near it (0).

    Raises:
        SceneError: The target is a mask; names its ``key``.
    """
    corners = target.corners(CORNERS)
    if corners is None:
        raise SceneError(f"{key}.mask: a specification takes an area, a disc or a polygon")
    half_axes = target.ellipse[2:4] if target.ellipse else ()
    radius = max(target.disc[2] if target.disc else 0.0, target.corner_radius or 0.0, *half_axes)
    sagitta = radius * (math.pi / CORNERS) ** 2 / 2  # by which a side may be off its arc
    return shapely.buffer(shapely.Polygon(corners), side * sagitta, join_style="mitre")


class Care(IntEnum):
    """How maxima are sought: among samples, between them, or there with the last steps and along ridges too."""

    SAMPLES, QUICK, THOROUGH = range(3)


@dataclass(frozen=True)
class Line:
    """A closed line with its samples, fewer than its corners where it is round."""

    corners: np.ndarray  # (corners, 2) [m]
    places: np.ndarray  # (samples,) rising lengths along it [m] of the samples

    def at(self, lengths: np.ndarray) -> np.ndarray:
        """Return the points (..., 2) at lengths along the line (..., 1) [m]."""
        ends = self._ends
        closed = np.concatenate([self.corners, self.corners[:1]])
        along = lengths[..., 0] % ends[-1]
        return np.stack([np.interp(along, ends, closed[:, axis]) for axis in (0, 1)], axis=-1)

    @cached_property
    def samples(self) -> np.ndarray:
        """(samples, 2) points [m]."""
        return self.at(self.places[:, None])

    @cached_property
    def stride(self) -> float:
        """Largest length between samples [m]."""
        return float(np.diff(self.places, append=self._ends[-1]).max())

    @cached_property
    def _ends(self) -> np.ndarray:
        """(corners + 1,) lengths along the line at its corners, and its whole length [m]."""
        return _lengths(self.corners)


def make_line(corners: np.ndarray, spacing: float) -> Line:
    """Return a closed line with samples at its sharp corners, and between them at most ``spacing`` [m] apart."""
    sides = np.diff(corners, axis=0, append=corners[:1]) @ (1, 1j)
    turns = np.abs(np.angle(sides * np.roll(sides, 1).conj()))
    ends = _lengths(corners)
    marks = np.unique(np.concatenate([[0.0], ends[:-1][turns > SHARP], ends[-1:]]))
    parts = [np.linspace(low, high, math.ceil((high - low) / spacing), endpoint=False) for low, high in pairwise(marks)]
    return Line(corners, np.concatenate(parts))


@dataclass(frozen=True)
class Region:
    """A part of the plate with its samples."""

    shape: shapely.Geometry  # its part on the plate [m], wider by the seam
    uncut: shapely.Geometry  # its part in the box around the plate [m], wider by the seam; for means
    plate: ModalPlate  # the plate
    x: np.ndarray  # (nx,) [m]
    y: np.ndarray  # (ny,) [m]
    inside: np.ndarray  # (ny, nx) true for grid points of the region
    lines: tuple[Line, ...]  # its outlines
    target: Target | None = None  # the target, whose mean has no polygon in the place of its arcs

    @cached_property
    def samples(self) -> np.ndarray:
        """(samples, 2) points [m]: those of the grid, then those of the lines."""
        return np.concatenate([self._grid[self.inside], *(line.samples for line in self.lines)])

    @cached_property
    def mean_matrix(self) -> Matrix:
        """(unknowns, unknowns) matrix of the mean square over the region, by mass."""
        space = self.plate.space
        if self.target is not None:
            return Matrix(space.region_matrix(self.target) / space.region_mass(self.target))
        matrices, masses = [], []
        for polygon in shapely.get_parts(self.uncut):
            for sign, ring in ((1, polygon.exterior), *((-1, ring) for ring in polygon.interiors)):
                corners = tuple(map(tuple, shapely.get_coordinates(ring)[:-1]))
                target = Target.model_construct(area=None, disc=None, mask=None, polygon=corners)
                matrices.append(sign * space.region_matrix(target))
                masses.append(sign * space.region_mass(target))
        return Matrix(sum(matrices[1:], start=matrices[0]) / sum(masses))

    @cached_property
    def _grid(self) -> np.ndarray:
        return np.stack(np.meshgrid(self.x, self.y), axis=-1)

    def peaks(self, levels: np.ndarray, values: Values, care: Care = Care.THOROUGH, fewest: int = FEWEST) -> np.ndarray:
        """Return points (points, 2) [m] of the largest maxima of a field, in any order: all that may be the largest.

        Args:
            levels: (samples,) field at the samples, at which it is compared with the neighbours.
            values: Function from points (points, 2) [m] to the field (points,), by which points are moved to the maxima
                between samples.
            care: How they are sought.
            fewest: Number of the highest maxima that are returned at least.
        """
        parts = _split_like(levels, [self._grid[self.inside], *(line.places for line in self.lines)])
        maxima = [self._grid_maxima(parts[0]), *map(_line_maxima, parts[1:])]
        heights = np.concatenate([part[at] for part, at in zip(parts, maxima, strict=True)])
        order = np.argsort(-heights, kind="stable")
        unit = float(np.abs(levels).max())
        near = heights.max() - MISSED * unit
        highest = np.zeros(len(order), dtype=bool)
        highest[order[: np.clip(np.count_nonzero(heights >= near), fewest, max(fewest, MOST))]] = True
        chosen = [at[own] for at, own in zip(maxima, _split_like(highest, maxima), strict=True)]
        grid, on_lines = self._grid[self.inside][chosen[0]], list(zip(self.lines, chosen[1:], strict=True))
        if care == Care.SAMPLES:
            return np.concatenate([grid, *(line.samples[at] for line, at in on_lines)])
        climbers = [self._climbers(self._maxima_around(grid, values), unit)]
        for line, at in on_lines:
            climbers.append(Climbers(line.places[at, None], line.stride / 4, ALONG, line.at, parabolic_summits))
        levels_at, missed = (lambda points: self._within(points[None], values(points))[0]), MISSED * unit
        points = climb(climbers, levels_at, missed, SHRINKS if care == Care.THOROUGH else FEW_SHRINKS)
        if care == Care.THOROUGH and len(ridges := self._along_ridges(points, levels_at, unit)):
            points = np.concatenate([points, climb([self._climbers(ridges, unit)], levels_at, missed)])
        return points

    def _climbers(self, points: np.ndarray, unit: float) -> Climbers:
        steps = np.array([_spacing(self.x), _spacing(self.y)]) / 4
        return Climbers(points, steps, AROUND, self._on_plate, quadratic_summits, CONVERGED * unit)

    def _along_ridges(self, points: np.ndarray, levels_at: Values, unit: float) -> np.ndarray:
        """Return points (n, 2) [m] beside the highest of maxima (m, 2), on ridges where a field falls little."""
        heights, spacing = levels_at(points), max(_spacing(self.x), _spacing(self.y))
        points, lowest = points[heights >= heights.max() - RIDGE * unit], heights.max() - FALLEN * unit
        around = self._on_plate(points[:, None] + AROUND * spacing / 4).reshape(-1, 2)
        levels = levels_at(around).reshape(-1, len(AROUND))
        within = np.isfinite(levels).all(axis=1)
        points, (*_, xx, yy, xy) = points[within], bends(levels[within])
        ridges = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]).T)[1][:, :, -1]
        starts = self._on_plate(points[:, None] + BESIDE * spacing * ridges[:, None]).reshape(-1, 2)
        return starts[levels_at(starts) >= lowest]

    def _grid_maxima(self, levels: np.ndarray) -> np.ndarray:
        """Return the indices of grid points inside that no neighbour exceeds."""
        field = np.full(self.inside.shape, -np.inf)
        field[self.inside] = levels
        return np.flatnonzero(_exceeds_neighbours(field)[self.inside])

    def _maxima_around(self, points: np.ndarray, values: Values) -> np.ndarray:
        """Return the maxima (n, 2) of a field on fine grids around points (points, 2), or these if there are none."""
        around = points[:, None, None] + FINE * (_spacing(self.x), _spacing(self.y))
        around = np.clip(around, (0.0, 0.0), self.plate.scene.plate.size).reshape(-1, FINE.size // 2, 2)
        levels = self._within(around, values(around.reshape(-1, 2))).reshape(-1, *FINE.shape[:2])
        maxima = _exceeds_neighbours(levels) & np.isfinite(levels)
        maxima[:, [0, -1]] = maxima[:, :, [0, -1]] = False  # there the next points are not known
        maxima = maxima.reshape(-1, FINE.size // 2)
        found = np.concatenate([points[~maxima.any(axis=1)], around[maxima]])
        return found[np.unique(np.round(found / max(self.plate.scene.plate.size), 9), axis=0, return_index=True)[1]]

    def _on_plate(self, points: np.ndarray) -> np.ndarray:
        """Return the points (..., 2) [m] of the plate's box next to others."""
        return np.clip(points, (0.0, 0.0), self.plate.scene.plate.size)

    def dips(self, points: np.ndarray, field: Values, sampled: np.ndarray) -> np.ndarray:
        """Return the points (n, 2) [m] where a complex field is smallest that steps of Gauss and Newton reach from
        points (m, 2) of the region, and from cells between the samples (samples,) of the field around which its phase
        turns: zeros, and the lowest points of narrow valleys of its size."""
        points = np.concatenate([points, self._vortices(sampled)])
        spacing, rows = np.array([_spacing(self.x), _spacing(self.y)]), np.arange(len(points))
        stencil = np.vstack([np.zeros(2), np.diag(spacing), -np.diag(spacing)]) * DIFFERENCE
        for _ in range(DIP_STEPS):
            here, *around = field((points[:, None] + stencil).reshape(-1, 2)).reshape(len(points), -1).T
            slopes = np.stack([around[0] - around[2], around[1] - around[3]], axis=1) / (2 * DIFFERENCE)  # of a spacing
            normal, gradient = (slopes[:, :, None].conj() * slopes[:, None]).real, (slopes.conj() * here[:, None]).real
            normal += (DAMPING * np.trace(normal, axis1=1, axis2=2) + np.finfo(float).tiny)[:, None, None] * np.eye(2)
            steps = np.linalg.solve(normal, gradient[:, :, None])[:, :, 0]
            steps *= spacing / np.maximum(1.0, np.abs(steps).max(axis=1, keepdims=True) / STRIDE)
            trials = points[:, None] - FRACTIONS[:, None] * steps[:, None]
            sizes = np.abs(field(trials.reshape(-1, 2)))
            points = trials[rows, self._within(trials, -sizes).argmax(axis=1)]
        return points

    def _vortices(self, sampled: np.ndarray) -> np.ndarray:
        """Return the middles (n, 2) [m] of the cells between samples of a complex field that hold a zero."""
        grid = np.full(self.inside.shape, np.nan, dtype=complex)
        grid[self.inside] = sampled[: np.count_nonzero(self.inside)]
        corners = [grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]]
        turns = sum(np.angle(after * before.conj()) for before, after in pairwise([*corners, corners[0]]))
        rows, columns = np.nonzero(np.abs(turns) > math.pi)
        return (self._grid[rows, columns] + self._grid[rows + 1, columns + 1]) / 2

    def _within(self, points: np.ndarray, levels: np.ndarray) -> np.ndarray:
        """Return levels (n, m) at points (n, m, 2), -∞ outside the region."""
        within = shapely.contains_xy(self.shape, *points.reshape(-1, 2).T).reshape(points.shape[:2])
        return np.where(within, levels.reshape(within.shape), -np.inf)


def _exceeds_neighbours(levels: np.ndarray) -> np.ndarray:
    """Return where no neighbour exceeds levels on grids (..., ny, nx)."""
    around = np.pad(levels, [(0, 0)] * (levels.ndim - 2) + [(1, 1)] * 2, constant_values=-np.inf)
    rows, columns = levels.shape[-2:]
    neighbours = [around[..., 1 + i : 1 + i + rows, 1 + j : 1 + j + columns] for i, j in NEIGHBOURS]
    return np.asarray(levels >= np.max(neighbours, axis=0))


def _split_like(values: np.ndarray, parts: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return values (n,) in parts as long as others."""
    return np.split(values, np.cumsum([len(part) for part in parts])[:-1])


def _line_maxima(levels: np.ndarray) -> np.ndarray:
    """Return the indices of samples of a closed line that no neighbour exceeds."""
    return np.flatnonzero((levels >= np.roll(levels, 1)) & (levels >= np.roll(levels, -1)))


def _lengths(line: np.ndarray) -> np.ndarray:
    """Return the (samples + 1,) lengths [m] along a closed line (samples, 2) at its samples, and its whole length."""
    return np.concatenate([[0.0], np.hypot(*np.diff(line, axis=0, append=line[:1]).T).cumsum()])


def _spacing(positions: np.ndarray) -> float:
    return float(positions[1] - positions[0]) if len(positions) > 1 else 0.0


def _plate_shape(scene: Scene) -> shapely.Geometry:
    """Return the polygon [m] of a plate with an outline, narrower by what its sides may cut off hollow arcs."""
    assert scene.outline is not None
    shell, *holes = scene.outline.polygons(TURN)
    axes = [np.linalg.norm(piece.axes, axis=0).max() for piece in scene.outline.pieces if isinstance(piece, Arc)]
    hidden = TURN**2 / 8 * max(axes, default=0.0)
    return shapely.buffer(shapely.Polygon(shell, holes), -hidden, join_style="mitre")


def make_region(
    plate: ModalPlate,
    shape: shapely.Geometry,
    spacing: float,
    fewest: int = 2,
    target: Target | None = None,
    coarser: float = 0.0,
) -> Region:
    """Return a region with samples at most ``spacing`` [m] apart, at least ``fewest`` along each side of its box.

    The ``target`` is the region itself, where its shape only approximates it. Means may be over a shape whose sides are
    off by ``coarser`` [m], which takes less time.

    Raises:
        SceneError: The region is empty.
    """
    size = plate.scene.plate.size
    uncut = shapely.intersection(shape, shapely.box(0.0, 0.0, *size))
    shape = shapely.intersection(uncut, _plate_shape(plate.scene)) if plate.scene.plate.outline else uncut
    if shape.is_empty or shape.area <= 0:
        raise SceneError(
            "specification.guard: leaves nothing of the plate outside the targets; write a narrower one [m]"
        )
    x0, y0, x1, y1 = shape.bounds
    x, y = (
        np.linspace(low, high, max(fewest, int(np.ceil((high - low) / spacing)) + 1))
        for low, high in ((x0, x1), (y0, y1))
    )
    lines = []
    for polygon in shapely.get_parts(shape):
        if polygon.geom_type != "Polygon":
            continue
        for ring in (polygon.exterior, *polygon.interiors):
            step = min(spacing, ring.length / (4 * fewest))
            lines.append(make_line(shapely.get_coordinates(ring)[:-1], step))
    seamed, uncut = (shapely.buffer(part, SEAM * max(size)) for part in (shape, shapely.simplify(uncut, coarser)))
    shapely.prepare(seamed)
    inside = shapely.contains_xy(seamed, *np.meshgrid(x, y))
    return Region(seamed, uncut, plate, x, y, inside, tuple(lines), target)


def in_units(unit: float, acceleration: np.ndarray) -> np.ndarray:
    """Return the sizes of complex accelerations in a unit [m/s²]."""
    return np.asarray(np.abs(acceleration) / unit)


def shortfall(unit: float, phase: float | Literal["free"], acceleration: np.ndarray) -> np.ndarray:
    """Return by how much complex accelerations at a phase lag [rad] fall short of a unit [m/s²].

    At a free phase this is half of how much their squares do, a smooth function where the acceleration is zero.
    """
    if phase == "free":
        return np.asarray((1 - np.abs(acceleration / unit) ** 2) / 2)
    return np.asarray(1 - (np.exp(1j * phase) * acceleration).real / unit)

"""Pieces of an outline: straight lines and arcs of ellipses, with what the engines ask of a curve.

A piece is a curve with a parameter t from 0 to 1. Loops of pieces have the plate on their left, so that the normal to
the right of the tangent points out of the plate.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.polynomial import legendre

# Parameters nearer to an end than this count as the end.
END = 1e-12
# Largest turn [rad] of a side of the polylines that stand for arcs.
TURN = 0.02
# Gauss points and panels for the length of an arc.
POINTS, PANELS = 16, 16


@dataclass(frozen=True, eq=False)
class Piece:
    """A smooth curve with one edge condition."""

    condition: Any  # "clamped", "supported", "free" or an ElasticEdge
    edge: str  # Key of the edge that the piece belongs to, such as "outline", "parts[0]" or "holes[1]"
    name: str  # Name in messages

    def points(self, t: np.ndarray | float) -> np.ndarray:
        """Return (..., 2) points [m] at parameters."""
        raise NotImplementedError

    def tangents(self, t: np.ndarray | float) -> np.ndarray:
        """Return (..., 2) derivatives of the points by the parameter [m]."""
        raise NotImplementedError

    def crossings(self, axis: int, values: np.ndarray) -> np.ndarray:
        """Return the parameters between the ends at which x (0) or y (1) takes one of the values [m]."""
        raise NotImplementedError

    def extremes(self, axis: int) -> np.ndarray:
        """Return the parameters between the ends at which x (0) or y (1) is extreme."""
        raise NotImplementedError

    def part(self, low: float, high: float) -> Piece:
        """Return the part between two parameters."""
        raise NotImplementedError

    def reversed(self) -> Piece:
        """Return the piece in the other direction."""
        raise NotImplementedError

    @property
    def area(self) -> float:
        """Area [m²] that the line from the origin to the piece sweeps, ½ ∫ x dy − y dx."""
        raise NotImplementedError

    @property
    def length(self) -> float:
        """Arc length [m]."""
        raise NotImplementedError

    @property
    def start(self) -> np.ndarray:
        """(2,) first point [m]."""
        return self.points(0.0)

    @property
    def end(self) -> np.ndarray:
        """(2,) last point [m]."""
        return self.points(1.0)

    @property
    def closed(self) -> bool:
        """True if the piece is a whole ellipse."""
        return False

    def normals(self, t: np.ndarray | float) -> np.ndarray:
        """Return (..., 2) unit normals that point out of the plate."""
        tangents = self.tangents(t)
        turned = np.stack([tangents[..., 1], -tangents[..., 0]], axis=-1)
        return np.asarray(turned / np.linalg.norm(turned, axis=-1, keepdims=True))

    def monotone(self, axis: int) -> Iterator[Monotone]:
        """Yield the parts on which x (0) or y (1) rises or falls, but for those on which it is constant."""
        cuts = np.concatenate([[0.0], np.sort(self.extremes(axis)), [1.0]])
        for first, last in pairwise(cuts.tolist()):
            ends = self.points(np.array([first, last]))[:, axis]
            if abs(ends[1] - ends[0]) > END * (1 + abs(ends).max()):
                yield Monotone(self, axis, float(ends.min()), float(ends.max()), (first + last) / 2)

    def polyline(self, turn: float = TURN) -> np.ndarray:
        """Return (n, 2) points [m] from the start to the end, an arc in steps of at most ``turn`` [rad]."""
        raise NotImplementedError

    def nearest(self, point: tuple[float, float] | np.ndarray) -> tuple[float, float]:
        """Return the parameter of the nearest point, and its distance [m]."""
        t = np.linspace(0, 1, 257)
        for _ in range(7):
            distances = np.linalg.norm(self.points(t) - np.asarray(point), axis=1)
            best = int(distances.argmin())
            t = np.linspace(t[max(best - 1, 0)], t[min(best + 1, t.size - 1)], 33)
        best = int((distances := np.linalg.norm(self.points(t) - np.asarray(point), axis=1)).argmin())
        return float(t[best]), float(distances[best])

    def on(self, condition: Any, edge: str) -> Piece:
        """Return the piece with another condition, as part of another edge."""
        return replace(self, condition=condition, edge=edge)


@dataclass(frozen=True, eq=False)
class Straight(Piece):
    """A straight line."""

    ends: np.ndarray  # (2, 2) first and last point [m]

    def points(self, t: np.ndarray | float) -> np.ndarray:
        t = np.asarray(t, dtype=float)[..., None]
        return np.asarray((1 - t) * self.ends[0] + t * self.ends[1])

    def tangents(self, t: np.ndarray | float) -> np.ndarray:
        return np.broadcast_to(self.ends[1] - self.ends[0], (*np.shape(t), 2))

    def crossings(self, axis: int, values: np.ndarray) -> np.ndarray:
        first, last = self.ends[:, axis]
        if first == last:
            return np.empty(0)
        t = (np.asarray(values, dtype=float) - first) / (last - first)
        return t[(t > END) & (t < 1 - END)]

    def extremes(self, axis: int) -> np.ndarray:
        return np.empty(0)

    def part(self, low: float, high: float) -> Straight:
        return replace(self, ends=self.points(np.array([low, high])))

    def reversed(self) -> Straight:
        return replace(self, ends=self.ends[::-1])

    @property
    def area(self) -> float:
        (x0, y0), (x1, y1) = self.ends.tolist()
        return (x0 * y1 - x1 * y0) / 2

    @property
    def length(self) -> float:
        return float(np.linalg.norm(self.ends[1] - self.ends[0]))

    def polyline(self, turn: float = TURN) -> np.ndarray:
        return self.ends


@dataclass(frozen=True, eq=False)
class Arc(Piece):
    """An arc of an ellipse, centre + A (cos θ, sin θ)."""

    centre: np.ndarray  # (2,) centre [m]
    axes: np.ndarray  # (2, 2) A, half axes as columns [m]
    angles: tuple[float, float]  # First and last angle θ [rad]; clockwise if the first is larger

    def _angle(self, t: np.ndarray | float) -> np.ndarray:
        return np.asarray(self.angles[0] + np.asarray(t, dtype=float) * (self.angles[1] - self.angles[0]))

    def points(self, t: np.ndarray | float) -> np.ndarray:
        angle = self._angle(t)
        return np.asarray(self.centre + np.stack([np.cos(angle), np.sin(angle)], axis=-1) @ self.axes.T)

    def tangents(self, t: np.ndarray | float) -> np.ndarray:
        angle = self._angle(t)
        turned = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
        return np.asarray((self.angles[1] - self.angles[0]) * turned @ self.axes.T)

    def wave(self, axis: int) -> tuple[float, float]:
        """Return radius r [m] and phase β [rad] of a coordinate, centre + r cos(θ − β)."""
        cosine, sine = self.axes[axis]
        return math.hypot(cosine, sine), math.atan2(sine, cosine)

    def _parameters(self, angle: np.ndarray) -> np.ndarray:
        """Return the parameters between the ends at which the arc passes angles [rad], in every turn."""
        first, last = self.angles
        turns = 2 * math.pi * np.arange(-3, 4)
        t = ((angle[..., None] - first + turns) / (last - first)).ravel()
        return np.unique(t[(t > END) & (t < 1 - END)])

    def crossings(self, axis: int, values: np.ndarray) -> np.ndarray:
        radius, phase = self.wave(axis)
        cosine = (np.asarray(values, dtype=float) - self.centre[axis]) / radius
        offset = np.arccos(cosine[np.abs(cosine) <= 1])
        remainder = np.concatenate([phase + offset, phase - offset])
        return self._parameters(np.remainder(remainder, 2 * math.pi))

    def extremes(self, axis: int) -> np.ndarray:
        _, phase = self.wave(axis)
        return self._parameters(np.remainder(np.array([phase, phase + math.pi]), 2 * math.pi))

    def part(self, low: float, high: float) -> Arc:
        first, last = self._angle(np.array([low, high])).tolist()
        return replace(self, angles=(first, last))

    def reversed(self) -> Arc:
        return replace(self, angles=self.angles[::-1])

    @property
    def least_radius(self) -> float:
        """Least radius of curvature [m] of the whole ellipse."""
        longer, shorter = np.linalg.svd(self.axes, compute_uv=False)
        return float(shorter**2 / longer)

    @property
    def hollow(self) -> bool:
        """True if the plate is outside the ellipse."""
        return bool((self.angles[1] - self.angles[0]) * np.linalg.det(self.axes) < 0)

    @property
    def closed(self) -> bool:
        return abs(self.angles[1] - self.angles[0]) > 2 * math.pi * (1 - END)

    @property
    def area(self) -> float:
        chord = self.end - self.start
        swept = self.centre[0] * chord[1] - self.centre[1] * chord[0]
        return float(swept + np.linalg.det(self.axes) * (self.angles[1] - self.angles[0])) / 2

    @cached_property
    def length(self) -> float:
        s, weights = legendre.leggauss(POINTS)
        t = (np.arange(PANELS)[:, None] + (s + 1) / 2) / PANELS
        return float((np.linalg.norm(self.tangents(t), axis=-1) @ weights).sum() / 2 / PANELS)

    def polyline(self, turn: float = TURN) -> np.ndarray:
        steps = max(2, math.ceil(abs(self.angles[1] - self.angles[0]) / turn))
        return self.points(np.linspace(0, 1, steps + 1))


@dataclass(frozen=True, eq=False)
class Monotone:
    """A part of a piece on which x or y takes every value between two once."""

    piece: Piece
    axis: int  # The coordinate that is monotone: 0 for x, 1 for y
    low: float  # Its least value [m]
    high: float  # Its largest value [m]
    middle: float  # A parameter inside the part

    def across(self, values: np.ndarray) -> np.ndarray:
        """Return the other coordinate [m] where the monotone one takes values from ``low`` to ``high`` [m]."""
        axis, piece = self.axis, self.piece
        if isinstance(piece, Straight):
            (start, end), (other, last) = piece.ends[:, axis], piece.ends[:, 1 - axis]
            return np.asarray(other + (np.asarray(values) - start) * ((last - other) / (end - start)))
        assert isinstance(piece, Arc)
        radius, phase = piece.wave(axis)
        offset = np.arccos(np.clip((np.asarray(values) - piece.centre[axis]) / radius, -1, 1))
        angle = phase + math.copysign(1.0, math.sin(float(piece._angle(self.middle)) - phase)) * offset
        cosine, sine = piece.axes[1 - axis]
        return np.asarray(piece.centre[1 - axis] + cosine * np.cos(angle) + sine * np.sin(angle))


def straight(corners: Iterable[tuple[float, float]] | np.ndarray, condition: Any, edge: str) -> list[Piece]:
    """Return the closed loop of straight pieces through corners (n, 2) [m]."""
    points = np.asarray(corners, dtype=float)
    ahead = np.roll(points, -1, axis=0)
    return [
        Straight(condition, edge, f"side {index}", np.stack(ends))
        for index, ends in enumerate(zip(points, ahead, strict=True))
    ]


def ellipse(centre: tuple[float, float], radii: tuple[float, float], angle: float, condition: Any, edge: str) -> Arc:
    """Return a whole ellipse with half axes ``radii`` [m], the first turned by an angle [rad] from x."""
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    return Arc(condition, edge, "the ellipse", np.array(centre), turn * radii, (0.0, 2 * math.pi))


def rounded(pieces: list[Piece], radius: float) -> list[Piece]:
    """Return a loop of straight pieces with arcs of a radius [m] at its corners; ValueError: they do not fit."""
    if not radius:
        return pieces
    ends = np.array([piece.start for piece in pieces])
    along = np.roll(ends, -1, axis=0) - ends
    lengths = np.linalg.norm(along, axis=1)
    along = along / lengths[:, None]
    before = np.roll(along, 1, axis=0)
    turn = np.arctan2(before[:, 0] * along[:, 1] - before[:, 1] * along[:, 0], (before * along).sum(axis=1))
    cut = radius * np.abs(np.tan(turn / 2))
    lacking = cut + np.roll(cut, -1) - lengths
    if (worst := int(lacking.argmax())) is not None and lacking[worst] > END * lengths[worst]:
        raise ValueError(f"the arcs at both ends of side {worst} need {lengths[worst] + lacking[worst]:.6g} m of it")
    loop: list[Piece] = []
    for index, piece in enumerate(pieces):
        if abs(turn[index]) > 1e-9:
            side = math.copysign(1.0, turn[index])
            first = ends[index] - cut[index] * before[index]
            centre = first + side * radius * np.array([-before[index, 1], before[index, 0]])
            angle = math.atan2(*(first - centre)[::-1])
            loop.append(Arc(piece.condition, piece.edge, f"the arc at corner {index}", centre, radius * np.eye(2),
                            (angle, angle + turn[index])))  # fmt: skip
        following = (index + 1) % len(pieces)
        low, high = ends[index] + cut[index] * along[index], ends[following] - cut[following] * along[index]
        if np.linalg.norm(high - low) > 1e-9 * lengths[index]:
            loop.append(Straight(piece.condition, piece.edge, piece.name, np.stack([low, high])))
    return loop

"""Closed outlines with holes: checks, what is inside, chords, and parts of the edge with conditions of their own."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from warp_plate.outline.pieces import TURN, Monotone, Piece

# Parts of the longer side: pieces nearer than the first touch, a point of an edge may be as far off it as the second.
TOUCH, OFF = 1e-9, 1e-3
# Smallest area of a plate as a part of its bounding box.
LEAST_AREA = 1e-3
# A hole is narrow whose area is less than this part of a circle's of the same length of the edge; it is slanted if its
# bounding box is wider than so many of its mean widths.
NARROW, SLANTED = 0.5, 2.5
# Parameters of a piece nearer to its end than this are its end.
SNAP = 1e-6


@dataclass(frozen=True, eq=False)
class Outline:
    """A plate's outline and its holes; :func:`make_outline` checks them.

    Loops have the plate on their left: the first one, the outer edge, is counterclockwise, the others are clockwise.
    """

    loops: tuple[tuple[Piece, ...], ...]

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """All pieces, those of the outer edge first."""
        return tuple(piece for loop in self.loops for piece in loop)

    @cached_property
    def bounds(self) -> tuple[float, float, float, float]:
        """Smallest rectangle x0, x1, y0, y1 [m] that holds the outline."""
        return bounds(self.loops[0])

    @cached_property
    def area(self) -> float:
        """Area without holes [m²]."""
        return sum(piece.area for piece in self.pieces)

    @cached_property
    def length(self) -> float:
        """Length of all edges [m]."""
        return sum(piece.length for piece in self.pieces)

    @property
    def widening(self) -> str:
        """What to widen of a plate that is too narrow, for messages."""
        longest, width = max(self.pieces, key=lambda piece: piece.length), 2e3 * self.area / self.length
        where = f"the longest piece, {longest.edge}, {longest.name}"
        return f"the mean width between edges is {width:.3g} mm; widen it beside {where}"

    @cached_property
    def monotone(self) -> tuple[tuple[Monotone, ...], tuple[Monotone, ...]]:
        """The parts of the edges on which x is monotone, and those on which y is."""
        along_x, along_y = ([part for piece in self.pieces for part in piece.monotone(axis)] for axis in (0, 1))
        return _joined(along_x), _joined(along_y)

    def contains(self, points: np.ndarray | Sequence[tuple[float, float]]) -> np.ndarray:
        """Return whether points (..., 2) [m] are on the plate, those on an edge within rounding included."""
        points = np.asarray(points, dtype=float)
        x, y = points[..., 0], points[..., 1]
        slack = TOUCH * max(self.bounds[1], self.bounds[3])
        inside = np.zeros(x.shape, dtype=bool)
        on_edge = np.zeros(x.shape, dtype=bool)
        for axis, parts in enumerate(self.monotone):
            along, other = (x, y) if axis == 0 else (y, x)
            for part in parts:
                near = (along >= part.low - slack) & (along <= part.high + slack)
                edge = part.across(np.clip(along[near], part.low, part.high))
                on_edge[near] |= np.abs(other[near] - edge) <= slack
                if axis == 1:
                    inside[near] ^= (y[near] >= part.low) & (y[near] < part.high) & (edge > x[near])
        return inside | on_edge

    def crossings(self, axis: int, at: float) -> list[tuple[float, Piece]]:
        """Return where a line along x (0) or y (1) crosses the edges, rising [m], and which pieces; ``at`` [m] is the
        line's other coordinate."""
        crossed = [
            (float(part.across(np.array([at]))[0]), part.piece)
            for part in self.monotone[1 - axis]
            if part.low <= at < part.high
        ]
        return sorted(crossed, key=lambda crossing: crossing[0])

    def chords(self, axis: int, at: float) -> list[tuple[float, float]]:
        """Return the intervals [m] of a line along x (0) or y (1) that are on the plate; see :meth:`crossings`."""
        places = [place for place, _ in self.crossings(axis, at)]
        return list(zip(places[::2], places[1::2], strict=False))

    def holds(self, x0: float, x1: float, y0: float, y1: float) -> bool:
        """Return whether a rectangle [m] is on the plate: its sides are, and no hole is inside it."""
        sides = ((0, y0, x0, x1), (0, y1, x0, x1), (1, x0, y0, y1), (1, x1, y0, y1))
        if not all(any(first <= low and high <= last for first, last in self.chords(axis, at))
                   for axis, at, low, high in sides):  # fmt: skip
            return False
        return not any(x0 < x < x1 and y0 < y < y1 for x, y in (hole[0].start for hole in self.loops[1:]))

    def polygons(self, turn: float = TURN) -> list[np.ndarray]:
        """Return the corners (n, 2) [m] of a polygon for each loop, the outer edge first, arcs in steps of ``turn``.

        Where pieces meet within rounding, there is one corner: shapely's polygons may not cross themselves.
        """
        return [np.concatenate([piece.polyline(turn)[:-1] for piece in loop]) for loop in self.loops]

    def share(self, corners: np.ndarray) -> float:
        """Return the part of a polygon (corners, 2) [m] that is on the plate."""
        shared = shared_areas([corners], [self.polygons()[0]]) - shared_areas([corners], self.polygons()[1:]).sum()
        return float(shared[0, 0] / shared_areas([corners], [corners])[0, 0])

    @property
    def slanted_slits(self) -> list[tuple[Piece, ...]]:
        """Holes that are long and narrow, and neither along x nor along y."""
        slits = []
        for hole in self.loops[1:]:
            area, around = -sum(piece.area for piece in hole), sum(piece.length for piece in hole)
            x0, x1, y0, y1 = bounds(hole)
            narrow = 4 * np.pi * area < NARROW * around**2
            if narrow and min(x1 - x0, y1 - y0) > SLANTED * 2 * area / around:
                slits.append(hole)
        return slits

    def corners(self) -> Iterator[tuple[Piece, Piece, float]]:
        """Yield the pieces before and after each corner or change of condition, and the angle of the plate between
        them [rad]: above π at re-entrant corners."""
        for loop in self.loops:
            if len(loop) == 1:
                continue
            for before, after in zip(loop, (*loop[1:], loop[0]), strict=True):
                (x0, y0), (x1, y1) = before.tangents(1.0), after.tangents(0.0)
                turn = float(np.arctan2(x0 * y1 - y0 * x1, x0 * x1 + y0 * y1))
                if abs(turn) > SNAP or before.condition != after.condition:
                    yield before, after, np.pi - turn


def shared_areas(first: Sequence[np.ndarray], second: Sequence[np.ndarray]) -> np.ndarray:
    """Return (first, second) areas [m²] that polygons (corners, 2) share with others."""
    import shapely

    one, two = (np.array([shapely.Polygon(corners) for corners in polygons]) for polygons in (first, second))
    return np.asarray(shapely.area(shapely.intersection(one[:, None], two)))


def make_outline(loops: Mapping[str, Sequence[Piece]], parts: Mapping[str, Any] | None = None) -> Outline:
    """Return a checked outline of loops by their keys, the outer edge first.

    ``parts`` are pieces of the outer edge with another condition, by their keys such as "parts[0]": (first point, last
    point, condition), counterclockwise.

    Raises:
        ValueError: A loop is open, crosses or touches itself or another one, or a hole is off the plate.
    """
    for key, loop in loops.items():
        size = max(np.ptp([piece.points(np.linspace(0, 1, 9)) for piece in loop], axis=(0, 1)))
        for before, after in zip(loop, (*loop[1:], loop[0]), strict=True):
            if np.linalg.norm(before.end - after.start) > TOUCH * size:
                raise ValueError(f"{key}: is open between {before.name} and {after.name}; join their ends")
    _check_crossings(loops)
    oriented = []
    for index, loop in enumerate(loops.values()):
        clockwise = sum(piece.area for piece in loop) < 0
        oriented.append(tuple(piece.reversed() for piece in reversed(loop)) if clockwise == (index == 0) else loop)
    outer, *holes = (Outline((tuple(loop),)) for loop in oriented)
    for key, hole in zip(list(loops)[1:], holes, strict=True):
        if not outer.contains(hole.pieces[0].start):
            raise ValueError(f"{key}: is off the plate; move it inside the outline")
    boxes = np.array([hole.bounds for hole in holes]).reshape(-1, 4)
    for index, (key, hole) in enumerate(zip(list(loops)[1:], holes, strict=True)):
        x, y = start = hole.pieces[0].start
        around = (boxes[:, 0] <= x) & (x <= boxes[:, 1]) & (boxes[:, 2] <= y) & (y <= boxes[:, 3])
        if any(other != index and holes[other].contains(start) for other in np.flatnonzero(around)):
            raise ValueError(f"{key}: is inside another hole; delete it")
    outline = Outline(tuple(tuple(loop) for loop in oriented))
    x0, x1, y0, y1 = outline.bounds
    if not outline.area > LEAST_AREA * (x1 - x0) * (y1 - y0):
        raise ValueError(f"{next(iter(loops))}: encloses less than {LEAST_AREA:g} of its bounding box; widen it")
    return _with_parts(outline, parts or {})


def _joined(parts: list[Monotone]) -> tuple[Monotone, ...]:
    """Return monotone parts whose ends are equal numbers where they differ by rounding, so that no line passes between
    the ends of two that follow each other."""
    ends = np.unique([end for part in parts for end in (part.low, part.high)])
    starts = ends[np.concatenate([[True], np.diff(ends) > TOUCH * np.ptp(ends)])]
    low, high = (
        starts[np.searchsorted(starts, [getattr(part, end) for part in parts], side="right") - 1].tolist()
        for end in ("low", "high")
    )
    return tuple(replace(part, low=low[i], high=high[i]) for i, part in enumerate(parts) if high[i] > low[i])


def bounds(loop: Sequence[Piece]) -> tuple[float, float, float, float]:
    """Return the smallest rectangle x0, x1, y0, y1 [m] that holds a loop."""
    limits = []
    for axis in (0, 1):
        values = [piece.points(np.array([0.0, 1.0, *piece.extremes(axis)]))[:, axis] for piece in loop]
        limits += [float(np.concatenate(values).min()), float(np.concatenate(values).max())]
    return limits[0], limits[1], limits[2], limits[3]


def inner_line(loop: Sequence[Piece]) -> tuple[np.ndarray, float]:
    """Return the ends (2, 2) [m] of the middle line of the smallest turned rectangle around a convex loop, as far as it
    is inside the loop, and the rectangle's width [m]."""
    import shapely

    polygon = shapely.Polygon(np.concatenate([piece.polyline()[:-1] for piece in loop]))
    box = np.array(polygon.minimum_rotated_rectangle.exterior.coords)[:4]
    if np.linalg.norm(box[1] - box[0]) < np.linalg.norm(box[2] - box[1]):
        box = np.roll(box, 1, axis=0)
    line = shapely.LineString([(box[0] + box[3]) / 2, (box[1] + box[2]) / 2])
    return np.array(polygon.intersection(line).coords), float(np.linalg.norm(box[2] - box[1]))


def _check_crossings(loops: Mapping[str, Sequence[Piece]]) -> None:
    """Raise ValueError, naming the pieces, if any two of them cross or touch but at the ends of neighbours."""
    import shapely

    listed = [(key, piece) for key, loop in loops.items() for piece in loop]
    lines = np.array([shapely.LineString(piece.polyline()) for _, piece in listed])
    size = np.ptp(shapely.get_coordinates(lines), axis=0).max()
    tree = shapely.STRtree(lines)
    # Line by line: the first pair that crosses is refused before all of them, maybe the square of the lines, are known.
    pairs = ((first, second) for first, line in enumerate(lines)
             for second in tree.query(line, "dwithin", TOUCH * size) if first <= second)  # fmt: skip
    for first, second in pairs:
        (key, one), (other, two) = listed[first], listed[second]
        if first == second:
            if one.length < TOUCH * size:
                shortest = f"no arc of less than {TOUCH * size:.3g} m"
                raise ValueError(f"{key}: {one.name} has no length; write no point twice and {shortest}")
            continue
        joints = ((one.end, two.start), (one.start, two.end))
        ends = [end for end, start in joints if np.linalg.norm(end - start) <= TOUCH * size]
        shared = shapely.intersection(lines[first], lines[second])
        places = shapely.get_coordinates(shared) if not shapely.is_empty(shared) else np.empty((0, 2))
        apart = [place for place in places if all(np.linalg.norm(place - end) > 1e3 * TOUCH * size for end in ends)]
        if apart or not (key == other and ends):
            of = "" if key == other else f" of {other}"
            at = (apart or [one.start])[0]
            raise ValueError(f"{key}: {one.name} crosses or touches {two.name}{of} near ({at[0]:.6g}, {at[1]:.6g}) m")


def _with_parts(outline: Outline, parts: Mapping[str, Any]) -> Outline:
    """Return the outline with parts of its outer edge under other conditions; ValueError: a point is off the edge."""
    loop = list(outline.loops[0])
    size = max(outline.bounds)
    for key, (first, last, condition) in parts.items():
        places = []
        for name, point in (("from_point", first), ("to_point", last)):
            nearest = [piece.nearest(point) for piece in loop]
            index = int(np.argmin([distance for _, distance in nearest]))
            t, distance = nearest[index]
            if distance > OFF * size:
                x, y = loop[index].points(t)
                raise ValueError(f"edges.{key}.{name}: {list(point)} is {distance:.3g} m off the outline; "
                                 f"its nearest point is [{x:.6g}, {y:.6g}]")  # fmt: skip
            places.append(index + (0.0 if t < SNAP else 1.0 if t > 1 - SNAP else t))
        start, end = (place % len(loop) for place in places)
        cut: list[Piece] = []
        for index, piece in enumerate(loop):
            inner = sorted({place - index for place in (start, end) if index < place < index + 1})
            for low, high in pairwise([0.0, *inner, 1.0]):
                middle = index + (low + high) / 2
                within = start < middle < end if start < end else middle > start or middle < end
                part = piece if (low, high) == (0.0, 1.0) else piece.part(low, high)
                cut.append(part.on(condition, key) if within else part)
        loop = cut
    return Outline((tuple(loop), *outline.loops[1:]))

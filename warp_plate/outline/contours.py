"""Contours of drawings: pieces joined by their ends, smooth curves flattened to arcs, and both as rows of numbers."""

import cmath
import math
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from warp_plate.outline.outline import bounds
from warp_plate.outline.pieces import Arc, Piece, Straight

# Parts of a drawing's longer side: ends of pieces that are nearer are joined; a piece that is shorter has no length.
JOIN, NO_LENGTH = 1e-6, 1e-10
# Relative difference of ellipses whose arcs are those of one.
SAME = 1e-9
# Points of a curve whose distance from two arcs is computed, and the part of the tolerance that it may take.
SAMPLES, SAFE = 32, 0.8
# Largest turn [rad] of an arc that replaces a part of a curve; arcs that turn less than the second are straight.
MOST_TURN, LEAST_TURN = math.pi / 2, 1e-9
DEEPEST = 24

Curve = Callable[[float], tuple[complex, complex]]  # Point x + iy and derivative at a parameter


def piece_of_row(row: Sequence[float], ahead: Sequence[float], name: str, condition: object, edge: str) -> Piece:
    """Return a piece from its row of numbers to the first point of the row ``ahead``: the inverse of
    :func:`rows_of_loop`. ValueError: an arc has no radius."""
    start = np.array(row[:2])
    if len(row) == 2:
        return Straight(condition, edge, name, np.stack([start, np.array(ahead[:2])]))
    centre = np.array(row[2:4])
    first = start - centre
    second = np.array(row[4:6]) - centre if len(row) == 7 else np.array([-first[1], first[0]])
    axes = np.stack([first, second], axis=1)
    if not abs(np.linalg.det(axes)) > 0:
        raise ValueError("has no radius; write a centre off the points")
    return Arc(condition, edge, name, centre, axes, (0.0, row[-1]))


def rows_of_loop(loop: Iterable[Piece]) -> list[list[float]]:
    """Return a row of numbers for each piece of a loop.

    ``[x, y]`` begins a straight line, ``[x, y, cx, cy, angle]`` an arc about a centre by an angle [rad], positive
    counterclockwise, and ``[x, y, cx, cy, qx, qy, angle]`` an arc of an ellipse: centre + cos(s) (p − centre) +
    sin(s) (q − centre) for s from 0 to the angle, p = (x, y).
    """
    rows = []
    for piece in loop:
        row = piece.start.tolist()
        if isinstance(piece, Arc):
            angle = piece.angles[0]
            cosine, sine = math.cos(angle), math.sin(angle)
            first, second = (piece.axes @ np.array([[cosine, -sine], [sine, cosine]])).T
            across, sweep = np.array([-first[1], first[0]]), piece.angles[1] - angle
            side = math.copysign(1.0, float(across @ second))
            round_ = np.linalg.norm(second - side * across) < 1e-12 * np.linalg.norm(first)
            row += piece.centre.tolist()
            row += [side * sweep] if round_ else [*(piece.centre + second).tolist(), sweep]
        rows.append(row)
    return rows


def mapped(piece: Piece, matrix: np.ndarray, shift: np.ndarray) -> Piece:
    """Return a piece under the map p ↦ matrix p + shift."""
    if isinstance(piece, Straight):
        return replace(piece, ends=piece.ends @ matrix.T + shift)
    assert isinstance(piece, Arc)
    return replace(piece, centre=matrix @ piece.centre + shift, axes=matrix @ piece.axes)


def joined(pieces: Sequence[Piece]) -> list[list[Piece]]:
    """Return the closed contours that pieces form whose ends meet, in any order and direction, largest area first.

    Raises:
        ValueError: An end meets none or several others; the message names piece and coordinates.
    """
    x0, x1, y0, y1 = bounds(pieces)
    size = max(x1 - x0, y1 - y0)
    contours = [[piece] for piece in pieces if piece.closed]
    pieces = [piece for piece in pieces if not piece.closed and piece.length > NO_LENGTH * size]
    partners = _partners(pieces, JOIN * size)
    left = set(range(len(pieces)))
    while left:
        loop, at = [], 2 * min(left)  # the end at which a piece is entered: 2 i its start, 2 i + 1 its end
        while at // 2 in left:
            left.remove(at // 2)
            piece = pieces[at // 2]
            before, after = partners[at], partners[at ^ 1]
            entered, leaving = ((_end(pieces, i) + _end(pieces, j)) / 2 for i, j in ((at, before), (at ^ 1, after)))
            loop.append(_between(piece.reversed() if at % 2 else piece, entered, leaving))
            at = after
        contours.append(_whole(loop))
    return sorted(contours, key=lambda loop: -abs(sum(piece.area for piece in loop)))


def _whole(loop: list[Piece]) -> list[Piece]:
    """Return a loop, as one piece if it consists of the arcs of one ellipse, into which programs cut circles."""
    arcs = [piece for piece in loop if isinstance(piece, Arc)]
    shapes = np.array([arc.axes @ arc.axes.T for arc in arcs])
    if len(arcs) < len(loop) or np.ptp(shapes, axis=0).max() > SAME * np.abs(shapes).max():
        return loop
    apart = np.ptp([arc.centre for arc in arcs], axis=0).max()
    sweeps = [arc.angles[1] - arc.angles[0] for arc in arcs]
    if apart**2 > SAME**2 * np.abs(shapes).max() or abs(sum(map(abs, sweeps)) - 2 * math.pi) > SAME:
        return loop
    first = arcs[0].angles[0]
    return [replace(arcs[0], angles=(first, first + math.copysign(2 * math.pi, sweeps[0])))]


def _end(pieces: Sequence[Piece], end: int) -> np.ndarray:
    return pieces[end // 2].end if end % 2 else pieces[end // 2].start


def _partners(pieces: Sequence[Piece], distance: float) -> list[int]:
    """Return the end that meets each end."""
    import shapely

    points = shapely.points(np.array([_end(pieces, end) for end in range(2 * len(pieces))]).reshape(-1, 2))
    near: list[list[int]] = [[] for _ in points]
    for one, other in shapely.STRtree(points).query(points, predicate="dwithin", distance=distance).T.tolist():
        if one != other:
            near[one].append(other)
    for end, others in enumerate(near):
        where = f"{pieces[end // 2].name} ends at ({points[end].x:.9g}, {points[end].y:.9g})"
        if not others:
            raise ValueError(f"{where}, where nothing begins; close the contour")
        if len(others) > 1:
            met = textwrap.shorten(", ".join(dict.fromkeys(pieces[other // 2].name for other in others)), 200)
            raise ValueError(f"{where}, where it meets {met}; contours must not touch, nor pieces be there twice")
    return [others[0] for others in near]


def _between(piece: Piece, start: np.ndarray, end: np.ndarray) -> Piece:
    """Return a piece turned and scaled so that its ends are two points, to which they are near."""
    old, new = complex(*(piece.end - piece.start)), complex(*(end - start))
    if old == new and (piece.start == start).all():
        return piece
    ratio = new / old
    matrix = np.array([[ratio.real, -ratio.imag], [ratio.imag, ratio.real]])
    return mapped(piece, matrix, start - matrix @ piece.start)


def chord(start: complex, end: complex, name: str) -> Piece:
    """Return the straight piece between two points x + iy."""
    return Straight(None, "", name, np.array([[start.real, start.imag], [end.real, end.imag]]))


def arcs_of_curve(curve: Curve, low: float, high: float, tolerance: float, name: str) -> Iterator[Piece]:
    """Yield arcs, two for each part of a smooth curve (a biarc), that join smoothly and stay within a tolerance."""
    yield from _biarcs(curve, low, high, tolerance, name, 0)


def _biarcs(curve: Curve, low: float, high: float, tolerance: float, name: str, depth: int) -> Iterator[Piece]:
    start, end = curve(low)[0], curve(high)[0]
    along = end - start
    if not abs(along):
        if depth or abs(curve((low + high) / 2)[0] - start) <= tolerance:
            return
    else:
        first, last = _direction(curve, low, high), _direction(curve, high, low)
        both = first + last
        projected = (along * both.conjugate()).real
        root = math.sqrt(projected**2 + 2 * (1 - (first * last.conjugate()).real) * abs(along) ** 2)
        if projected + root > 1e-9 * abs(along):
            reach = abs(along) ** 2 / (projected + root)
            joint = start + reach * first + (along - reach * both) / 2
            arcs = [arc for arc in ((start, first, joint), (end, -last, joint)) if arc[0] != arc[2]]
            points = [curve(low + (high - low) * index / SAMPLES)[0] for index in range(1, SAMPLES)]
            turned = max(abs(_turn(*arc)) for arc in arcs)
            if turned <= MOST_TURN and max(min(_off(p, *arc) for arc in arcs) for p in points) <= SAFE * tolerance:
                pieces = [_arc(*arc, name) for arc in arcs]
                yield from [*pieces[:-1], pieces[-1].reversed()]
                return
    if depth == DEEPEST:
        yield chord(start, end, name)
        return
    middle = (low + high) / 2
    yield from _biarcs(curve, low, middle, tolerance, name, depth + 1)
    yield from _biarcs(curve, middle, high, tolerance, name, depth + 1)


def _direction(curve: Curve, at: float, other: float) -> complex:
    """Return the direction of a curve at an end, in the sense of rising parameters."""
    point, slope = curve(at)
    if abs(slope) * abs(other - at) < 1e-9 * abs(curve(other)[0] - point):  # the first control points are equal
        slope = (curve(at + 1e-4 * (other - at))[0] - point) * (1 if other > at else -1)
    return slope / abs(slope) if slope else 1.0 + 0j


def _turn(start: complex, direction: complex, end: complex) -> float:
    """Return the turn [rad] of the arc from a point in a direction to another point."""
    return 2 * cmath.phase((end - start) * direction.conjugate())


def _off(point: complex, start: complex, direction: complex, end: complex) -> float:
    """Return the distance of a point from the circle of an arc."""
    turn, along = _turn(start, direction, end), end - start
    if abs(turn) < LEAST_TURN:
        return abs(((point - start) * along.conjugate()).imag) / abs(along)
    radius = abs(along) / (2 * math.sin(turn / 2))
    return abs(abs(point - start - 1j * direction * radius) - abs(radius))


def _arc(start: complex, direction: complex, end: complex, name: str) -> Piece:
    turn, along = _turn(start, direction, end), end - start
    if abs(turn) < LEAST_TURN:
        return chord(start, end, name)
    radius = abs(along) / (2 * math.sin(turn / 2))
    centre = start + 1j * direction * radius
    angle = cmath.phase(start - centre)
    return Arc(None, "", name, np.array([centre.real, centre.imag]), abs(radius) * np.eye(2), (angle, angle + turn))

"""The functions that a plate's splines need besides, by its corners, holes and supports."""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise
from operator import itemgetter

import numpy as np

from warp_plate.modal.spaces.singular import (
    NOTCH,
    ON_EDGE,
    Singular,
    along_line,
    along_ring,
    around_hole,
    at_corner,
    at_point,
    clear,
    is_round,
    is_singular,
    on_edge,
)
from warp_plate.modal.spaces.slots import around_slot, functions_of, middle_line
from warp_plate.outline.outline import Outline
from warp_plate.outline.pieces import Arc, Piece
from warp_plate.scene.fields import Point
from warp_plate.scene.model import Scene
from warp_plate.scene.outline import Support

# Functions along a line besides one for each interval, and waves for each interval of a ring.
LINE_FUNCTIONS, RING_WAVES = 8, 0.35
# About so many functions a corner, a notch and a round hole take; if more are needed than the fourth, knots nearer to
# each other cost less. At most as many as the last with those about slots.
CORNER_FUNCTIONS, NOTCH_FUNCTIONS, HOLE_FUNCTIONS, MOST_FUNCTIONS, MOST_WITH_SLOTS = 6, 36, 24, 250, 300

# Lines whose angle has a smaller sine do not cross.
PARALLEL = 1e-6
# Places nearer to a line than this part of its length part it.
BESIDE = 0.2


def added_functions(scene: Scene, interval: float) -> tuple[Singular, ...]:
    """Return the functions that a plate's splines of an interval [m] need besides, the same object for the same."""
    assert scene.outline is not None
    if not adds_functions(scene):
        return ()
    supports = tuple(support for _, support in parted(tuple(scene.supports)))
    return _added(scene.outline, supports, scene.plate.poisson_ratio, interval)


@lru_cache
def parted(supports: tuple[Support, ...]) -> tuple[tuple[int, Support], ...]:
    """Return supports with their indices, lines parted where others meet them, for their forces are singular there, and
    beside points and ends of others, where they change at short distances."""
    parts = []
    for index, support in enumerate(supports):
        if support.line is None:
            parts.append((index, support))
            continue
        start, end = np.array(support.line)
        slack, places = ON_EDGE / math.dist(start, end), [0.0]
        others = [other for other in supports if other is not support]
        meetings = (_meeting(support.line, other.line) for other in others if other.line)
        places += [at for at in sorted(filter(None, meetings)) if slack < at < 1 - slack]
        beside = [place for other in others for place in other.ends]
        for at, away in sorted((_beside(support.line, place) for place in beside), key=itemgetter(1)):
            if slack < away < BESIDE and all(abs(at - other) > away / 2 for other in (*places, 1.0)):
                places.append(at)
        apart = [low for low, high in pairwise([*sorted(places), 1.0]) if high - low > slack]
        points = [tuple((start + at * (end - start)).tolist()) for at in (*apart, 1.0)]
        parts += [(index, support.model_copy(update={"line": ends})) for ends in pairwise(points)]
    return tuple(parts)


def _beside(line: tuple[Point, Point], place: Point) -> tuple[float, float]:
    """Return where along a line, from 0 to 1, a place is, and its distance from there, both as parts of the length; the
    distance is infinite beyond the ends."""
    start, end = (complex(*point) for point in line)
    at = (complex(*place) - start) / (end - start)
    return at.real, abs(at.imag) if 0 < at.real < 1 else math.inf


def _meeting(line: tuple[Point, Point], other: tuple[Point, Point]) -> float | None:
    """Return the place from 0 to 1 where another line meets a line; None if it does not."""
    (start, end), (first, last) = np.array(line), np.array(other)
    sides = np.stack([end - start, first - last], axis=1)
    length, across = np.linalg.norm(sides, axis=0)
    if abs(np.linalg.det(sides)) < PARALLEL * length * across:
        return None
    at, passed = np.linalg.solve(sides, first - start).tolist()
    return at if -ON_EDGE <= passed * across <= across + ON_EDGE else None


def adds_functions(scene: Scene) -> bool:
    """Return whether functions are added: to isotropic plates with few corners and holes."""
    return scene.effects.rigidities is None and _is_simple(scene.outline)


@lru_cache
def _is_simple(outline: Outline) -> bool:
    return _functions(outline, slots_of(outline)) < MOST_FUNCTIONS


@lru_cache
def slots_of(outline: Outline) -> tuple[tuple[Piece, ...], ...]:
    """Return the holes with middle lines, about which functions are added; none if these would be too many."""
    slots = tuple(hole for hole in outline.loops[1:] if middle_line(hole) is not None)
    return slots if _functions(outline, slots) + sum(map(functions_of, slots)) < MOST_WITH_SLOTS else ()


def _functions(outline: Outline, slots: tuple[tuple[Piece, ...], ...]) -> int:
    """Return about the number of functions that are added at corners and round holes but for some holes."""
    rest = Outline(tuple(loop for loop in outline.loops if loop not in slots))
    corners = (angle for before, after, angle in rest.corners() if is_singular(before, after, angle))
    at_corners = sum(NOTCH_FUNCTIONS if angle > NOTCH else CORNER_FUNCTIONS for angle in corners)
    return at_corners + HOLE_FUNCTIONS * sum(map(is_round, rest.loops[1:]))


@lru_cache
def _added(outline: Outline, supports: tuple[Support, ...], ratio: float, interval: float) -> tuple[Singular, ...]:
    functions: list[Singular | None] = []
    slots = slots_of(outline)
    for before, after, angle in Outline(tuple(loop for loop in outline.loops if loop not in slots)).corners():
        if is_singular(before, after, angle):
            first = math.atan2(*after.tangents(0.0)[::-1])
            reach = clear(outline, complex(*after.start), -np.exp(1j * (first + angle / 2)))
            kinds = _kind(after), _kind(before)
            functions.append(at_corner(after.start, first, angle, kinds, ratio, interval, reach))
    for support in supports:
        if support.ring is not None:
            ring = support.piece("")
            assert isinstance(ring, Arc)
            functions.append(along_ring(ring, math.ceil(RING_WAVES * ring.length / interval) + 1))
        elif support.line is not None:
            ends = np.array(support.line)
            count = line_functions(math.dist(*ends), interval)
            functions.append(along_line(ends, [not on_edge(outline, end) for end in ends], count, outline, interval))
        elif not on_edge(outline, point := np.array(support.point)):
            functions.append(at_point(point, interval))
    for loop in outline.loops[1:]:
        if is_round(loop):
            functions.append(around_hole(loop[0], interval))
        elif loop in slots:
            functions += around_slot(outline, loop, interval)
    return tuple(function for function in functions if function is not None)


def line_functions(length: float, interval: float) -> int:
    """Return the number of functions about a line support of a length [m]."""
    return math.ceil(length / interval) + LINE_FUNCTIONS


def ties_banks(scene: Scene) -> bool:
    """Return whether splines tie both sides of a narrow slanted hole to each other."""
    outline = scene.outline
    if outline is None:
        return False
    slots = slots_of(outline) if adds_functions(scene) else ()
    return any(hole not in slots for hole in outline.slanted_slits)


def _kind(piece: Piece) -> str:
    return piece.condition if isinstance(piece.condition, str) else "free"

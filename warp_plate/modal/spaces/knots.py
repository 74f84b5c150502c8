"""Lines across which the section of a plate or its load is not smooth, and the splines that follow them.

Where the rigidity jumps, at the edges of layers, only the slope is continuous; where it has a kink, at the columns of a
map of thickness, the curvature; and where the load jumps, at the edges of a patch with a mass, the third derivative.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np

from warp_plate.effects.edges import Edges, ElasticEdge
from warp_plate.modal.spaces.added import adds_functions, parted, slots_of
from warp_plate.modal.spaces.singular import ON_EDGE, STRAIGHT, is_round, is_singular, on_edge
from warp_plate.modal.spaces.splines import Splines, make_splines
from warp_plate.outline.outline import Outline, bounds
from warp_plate.outline.pieces import Arc
from warp_plate.plate.section import Laminate
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import Point
from warp_plate.scene.model import Scene
from warp_plate.scene.outline import Support

# Intervals between knots along the longer side: at least so many, and so many for each half-wave at the highest
# frequency; along the shorter side fewer, but of less size.
FEWEST, PER_HALF_WAVE = 18, 2.6
# The same for plates with an outline, as a part of these; the fewest for responses from rest, to which many modes add.
FEWER, FEWEST_FROM_REST = 0.7, 36
# Intervals for each mean width, twice the area over the length of all edges: edges near each other must not share them.
PER_WIDTH = 2.0
# Degree of the splines, of those of a section with jumps or up to FEW_KINKS kinks along a side, and with more: each
# repeats knots, fewer of a low degree.
DEGREE, DEGREE_OF_JUMPS, DEGREE_OF_KINKS, FEW_KINKS = 7, 5, 4, 10
# Up to this many patches with masses, knots are added at their edges, across which the load jumps.
MOST_PATCHES = 8
# The curvature alone is continuous across a line of a map where the slope of a factor changes by more than KINK times
# its value over the columns' distance, if there are no more than MOST_KINKS of them along either side.
KINK, MOST_KINKS = 0.01, 36
# Intervals, as parts of the others, near a corner between a clamped and a free edge, where the moments are singular.
CORNER_INTERVALS = (0.3, 0.09)
# The same on either side of the edges of layers, whose corners are singular too: fewer if there are many edges.
LAYER_INTERVALS = (0.3, 0.09, 0.027)
# Intervals, in place of one, within the bounding box of a layer that is no rectangle.
SHAPED_INTERVALS = 3
# Interval at a hole as a part of its width, and at a singular corner as a part of the square of the others over the
# side, so that more functions show the error; their growth with the distance, and samples of that along a side.
HOLE_INTERVAL, CORNER_INTERVAL, HOLE_GROWTH, CORNER_GROWTH, SAMPLES = 0.1, 0.06, 0.6, 0.7, 2000
# Interval at places where functions are added as a part of the distance to the next edge or support.
APART, APART_OF_LINES = 1.0, 0.5
# Interval at the end of a line support on a free edge as a part of the others.
END_INTERVAL = 0.15
# Interval at an arc of a corner that is narrower than the others, as a part of its width.
ARC_INTERVAL = 0.5
# Least interval as a part of the others, and most further knots: with many places intervals are larger there.
LEAST_INTERVAL, MOST_GRADED = 1e-4, 28
# None are in gaps narrower than this part of an interval.
NARROW = 0.3
# Parts of a side: edges of layers nearer than the first count as one, and those nearer than the second are refused, for
# splines between them are so stiff that rounding hides the plate.
SAME, CLOSE = 1e-6, 1e-4
# Part of a side: of lines of loads nearer than this one counts, for the same reason; this costs no digits elsewhere.
BESIDE = 7e-4


def plate_splines(
    laminate: Laminate, edges: Edges, axis: int, intervals: int, further: Sequence[tuple[float, int]] = ()
) -> Splines:
    """Return the functions along x (0) or y (1) of a plate, with about a number of intervals between knots; ``further``
    places [m] where derivatives above a number of them jump."""
    length, degree = laminate.size[axis], _degree(laminate)
    ends, sides = ((edges.left, edges.right), (edges.bottom, edges.top))[:: 1 if axis == 0 else -1]
    knots = [line for line in lines(laminate, axis, degree) if line[1] < degree]
    for place, derivatives in further:
        others = (0.0, length, *(other for other, continuous in knots if continuous <= derivatives))
        if all(abs(place - other) > BESIDE * length for other in others):
            knots.append((place, derivatives))
    for end, place in zip(ends, (0.0, length), strict=True):
        if any(_singular(end, side) for side in sides):
            sign = 1 if place == 0 else -1
            knots += [(place + sign * part * length / intervals, degree - 1) for part in CORNER_INTERVALS]
    knots += [(place, degree - 1) for place in _near_layers(laminate, axis, length / intervals)]
    low, high = ("free" if isinstance(end, ElasticEdge) else end for end in ends)
    return make_splines(length, (low, high), intervals, degree, tuple(knots))


def outline_splines(scene: Scene, laminate: Laminate, axis: int, intervals: int) -> Splines:
    """Return the same of a plate with an outline: splines along a side of its bounding box, without conditions."""
    length, degree = laminate.size[axis], _degree(laminate)
    knots = [line for line in lines(laminate, axis, degree) if line[1] < degree]
    knots += [(place, degree - 1) for place in _near_layers(laminate, axis, length / intervals)]
    # The shear force jumps across the line of a support.
    lines_across = [support.line for support in scene.supports if support.line and not adds_functions(scene)]
    knots += [(start[axis], 2) for start, end in lines_across if start[axis] == end[axis]]
    graded = _graded(scene, axis, length / intervals)
    if graded.size:
        near = np.array([place for place, _ in knots])[:, None]
        gaps = np.minimum(np.diff(graded[:-1]), np.diff(graded[1:]))
        apart = ~(np.abs(near - graded[1:-1]) < NARROW * gaps).any(axis=0)
        knots += [(place, degree - 1) for place in graded[1:-1][apart].tolist()]
        intervals = 1
    return make_splines(length, ("free", "free"), intervals, degree, tuple(knots))


def _graded(scene: Scene, axis: int, interval: float) -> np.ndarray:
    """Return the knots along x (0) or y (1) [m] of a plate with an outline, ends included: nearer to each other at
    small holes, arcs and corners where moments are singular; none if there are no such places."""
    outline, side, added = scene.outline, scene.plate.size[axis], adds_functions(scene)
    assert outline is not None
    spans = []
    slots = slots_of(outline) if added else ()
    for hole in outline.loops[1:]:
        if hole in slots:
            continue
        low, high = bounds(hole)[2 * axis : 2 * axis + 2]
        if added and is_round(hole):
            centre, radius = hole[0].centre, hole[0].least_radius
            spans.append((low, high, APART * _apart(scene, centre, radius), HOLE_GROWTH))
            continue
        radii = [piece.least_radius for piece in hole if isinstance(piece, Arc)]
        width = min(high - low, 4 * min(radii)) if len(radii) == len(hole) else high - low
        spans.append((low, high, HOLE_INTERVAL * width, HOLE_GROWTH))
    for arc in outline.pieces:
        if isinstance(arc, Arc) and (arc.condition == "supported" or (arc.hollow and arc.condition != "free")):
            low, high = bounds([arc])[2 * axis : 2 * axis + 2]
            if not arc.closed and high - low < interval:
                spans.append((low, high, ARC_INTERVAL * (high - low), CORNER_GROWTH))
    plain = CORNER_INTERVAL * interval**2 / side
    of_slots = {piece for slot in slots for piece in slot}
    corners = [after.start for before, after, angle in outline.corners()
               if is_singular(before, after, angle) and after not in of_slots]  # fmt: skip
    places = [(place, APART * _apart(scene, place) if added else plain) for place in corners]
    for _, support in parted(tuple(scene.supports)):
        for end in (np.array(end) for end in support.ends if not _on_edge(support, end, outline)):
            part = APART_OF_LINES if support.line else APART
            places.append((end, part * _apart(scene, end) if added and not on_edge(outline, end) else plain))
        free = (piece for piece in outline.pieces if added and support.line and piece.condition == "free")
        places += [(np.array(end), END_INTERVAL * interval) for piece in free for end in support.ends
                   if piece.nearest(end)[1] < ON_EDGE]  # fmt: skip
    spans += [(place[axis], place[axis], least, CORNER_GROWTH) for place, least in places]
    for least in np.geomspace(LEAST_INTERVAL, 1, 40) * interval:
        knots = _spread(side, interval, [(*span[:2], max(span[2], least), span[3]) for span in spans])
        if knots.size <= MOST_GRADED + side / interval:
            break
    return knots if knots.size > side / interval + 1.5 else np.empty(0)


def _spread(side: float, interval: float, spans: list[tuple[float, float, float, float]]) -> np.ndarray:
    """Return knots from 0 to a side [m] an interval apart; nearer at spans (low, high, interval, growth)."""
    least = min((size for _, _, size, _ in spans), default=interval)
    places = np.linspace(0, side, max(SAMPLES, math.ceil(8 * side / least)))
    middle = (places[1:] + places[:-1]) / 2
    size = np.full(middle.size, interval)
    for start, end, smallest, growth in spans:
        beyond = np.maximum(np.abs(middle - (start + end) / 2) - (end - start) / 2, 0)
        size = np.minimum(size, smallest + growth * beyond)
    passed = np.concatenate([[0.0], np.cumsum(np.diff(places) / size)])
    return np.interp(np.linspace(0, passed[-1], math.ceil(passed[-1]) + 1), passed, places)


def _on_edge(support: Support, end: Point, outline: Outline) -> bool:
    """Return whether the end of a support's line lies on an edge, or its point on a corner, where moments are not
    singular: a force on a convex corner bends the plate smoothly."""
    if support.point is not None:
        corners = (after.start for _, after, angle in outline.corners() if angle < math.pi - STRAIGHT)
        return any(math.dist(corner, end) < ON_EDGE for corner in corners)
    return on_edge(outline, np.array(end))


def _apart(scene: Scene, place: np.ndarray, radius: float = 0.0) -> float:
    """Return the distance [m] of a place, or of a hole of a radius about it, from edges and supports, and from the far
    ends of those that meet it."""
    assert scene.outline is not None
    starts, along, first, ends = _segments(
        scene.outline, tuple(support for _, support in parted(tuple(scene.supports)))
    )
    passed = np.clip(((place - starts) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), ON_EDGE**2), 0, 1)
    away = np.linalg.norm(starts + passed[:, None] * along - place, axis=1)
    away = np.minimum.reduceat(away, first) - radius
    far = np.linalg.norm(ends - place, axis=2).max(axis=1) - radius
    away = np.where(away > radius / 100 + ON_EDGE, away, np.where(far > radius / 100 + ON_EDGE, far, math.inf))
    return float(away.min())


@lru_cache
def _segments(outline: Outline, supports: tuple[Support, ...]) -> tuple[np.ndarray, ...]:
    """Return starts and vectors (segments, 2) [m] of polylines of edges and supports, the index of the first segment of
    each, and their ends (curves, 2, 2) [m]."""
    curves = [support.piece("") for _, support in parted(supports)]
    lines = [curve.polyline() for curve in (*outline.pieces, *curves) if curve is not None]
    lines += [np.array([support.point] * 2) for support in supports if support.point is not None]
    first = np.cumsum([0, *(len(line) - 1 for line in lines[:-1])])
    starts = np.concatenate([line[:-1] for line in lines])
    along = np.concatenate([np.diff(line, axis=0) for line in lines])
    return starts, along, first, np.array([line[[0, -1]] for line in lines])


def lines(laminate: Laminate, axis: int, degree: int = DEGREE) -> list[tuple[float, int]]:
    """Return where section or load are not smooth along x (0) or y (1) [m], and the derivatives of splines there."""
    places: list[tuple[float, int]] = []
    if len(laminate.loaded) <= MOST_PATCHES:
        areas = (patch.area for patch in laminate.loaded)
        places += [(position, degree - 2) for area in areas if area for position in area[2 * axis : 2 * axis + 2]]
    places += [(place, 1) for place in laminate.layer_edges(axis)]
    kinks = _kinks(laminate)
    followed = _most(kinks) <= MOST_KINKS
    return places + [(place, 2 if sharp and followed else degree) for place, sharp in kinks[axis].items()]


def _kinks(laminate: Laminate) -> tuple[dict[float, bool], dict[float, bool]]:
    """Return the inner lines of the maps along x and along y [m], and whether each is a kink that counts."""
    kinks: tuple[dict[float, bool], dict[float, bool]] = {}, {}
    for array in laminate.maps.values():
        for axis, rows in enumerate((array.T, array)):
            sharp: np.ndarray = np.any(np.abs(np.diff(rows, 2, axis=0)) > KINK * rows[1:-1], axis=1)
            for index, counts in enumerate(sharp.tolist(), 1):
                place = laminate.size[axis] * index / (len(rows) - 1)
                kinks[axis][place] = kinks[axis].get(place, False) or counts
    return kinks


def _most(kinks: tuple[dict[float, bool], dict[float, bool]]) -> int:
    """Return the number of kinks along the side that has more of them."""
    return max(sum(sharp.values()) for sharp in kinks)


def _degree(laminate: Laminate) -> int:
    """Return the degree of the splines."""
    most = _most(_kinks(laminate))
    if laminate.layers or 0 < most <= FEW_KINKS or most > MOST_KINKS:
        return DEGREE_OF_JUMPS
    return DEGREE_OF_KINKS if most else DEGREE


def _near_layers(laminate: Laminate, axis: int, interval: float) -> list[float]:
    """Return further knots along x (0) or y (1) [m] near the edges of layers; SceneError: two edges nearly coincide."""
    sides = enumerate(laminate.size)
    edges = [{place for place in laminate.layer_edges(i) if 0 < place < side} for i, side in sides]
    places, parts = [], LAYER_INTERVALS[: max(1, 4 - len(edges[axis]) // 2)] if all(edges) else ()
    side = laminate.size[axis]
    for low, high in pairwise(sorted({0.0, side, *edges[axis]})):
        if SAME * side < high - low < CLOSE * side:
            raise SceneError(
                f"effects.layers: edges at {'xy'[axis]} = {low:.9g} and {high:.9g} m are too close for modes; let them "
                f"coincide or move them at least {CLOSE * side:.3g} m apart"
            )
        steps = [part * min(interval, high - low) for part in parts if high - low > NARROW * interval]
        places += [low + step for step in steps if low in edges[axis]]
        places += [high - step for step in steps if high in edges[axis]]
    # Curvatures jump across the edges of other layers, which no knots follow: the smaller the intervals the better.
    for layer in laminate.shaped_layers:
        low, high = layer.box[2 * axis : 2 * axis + 2]
        inner = np.linspace(low, high, math.ceil(SHAPED_INTERVALS * (high - low) / interval) + 1).tolist()
        places += [place for place in inner if 0 < place < side]
    return places


def _singular(first: object, second: object) -> bool:
    """Return whether moments are singular at the corner of two edges: a clamped or elastic one meets another kind."""
    held = [edge == "clamped" or isinstance(edge, ElasticEdge) for edge in (first, second)]
    loose = [edge == "free" or isinstance(edge, ElasticEdge) for edge in (first, second)]
    return first != second and ((held[0] and loose[1]) or (held[1] and loose[0]))


def intervals_for(
    size: tuple[float, float],
    outline: Outline | None,
    highest: float,
    wave: float,
    density: float,
    from_rest: bool = False,
) -> tuple[int, int]:
    """Return the number of intervals between knots along x and along y of a plate for natural frequencies and steady
    responses up to a frequency [Hz], or for responses ``from_rest``; ``wave`` as :func:`mean_wave_frequency`."""
    waves, longer, fewest = math.sqrt(highest / wave), max(size), FEWEST
    per_length = PER_HALF_WAVE * waves
    if outline is not None:  # whose splines have more continuous derivatives at the edges
        density *= FEWER
        fewest = FEWEST_FROM_REST if from_rest else FEWEST
        per_length = max(per_length, PER_WIDTH * outline.length / (2 * outline.area))
    counts = [math.ceil(max(fewest * math.sqrt(side / longer), per_length * side)) for side in size]
    x, y = (math.ceil(density * count) for count in counts)
    return x, y

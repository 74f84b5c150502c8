"""Difference operators on unit spacing along x; ``aspect`` is (spacing x / spacing y)².

The 13-point biharmonic is the Laplacian of the Laplacian. Taking it in these two steps halves the arithmetic where
a path can keep the inner Laplacian, the plate's curvature, and is where the edges enter: on a clamped edge the
mirror node doubles the curvature, on a simply supported edge the curvature is zero. So an edge is one factor on
the curvature of its nodes, 2 or 0 (1 inside), and no path needs a special case for it.

The fourth-order form is two such passes as well, each with five nodes along each axis. Its edges change the taps of
the two nodes next to them, in both passes; so near an edge taps are data.
"""

from functools import cache

import warp as wp


@cache
def make_laplacian(square_cells, real):
    """∇²u from the five nodes of the cross; ``real`` is wp.float32 or wp.float64."""

    @wp.func
    def laplacian_square(centre: real, west: real, east: real, south: real, north: real, aspect: real):
        return (west + east) + (south + north) - real(4.0) * centre

    @wp.func
    def laplacian_oblong(centre: real, west: real, east: real, south: real, north: real, aspect: real):
        along_x = west + east - real(2.0) * centre
        along_y = south + north - real(2.0) * centre
        return along_x + aspect * along_y

    return laplacian_square if square_cells else laplacian_oblong


@cache
def make_weighed(real):
    """A sum, and to it the taps times five nodes in a row; each step is one fused multiply-add."""
    taps_of = wp.types.vector(length=5, dtype=real)

    @wp.func
    def weighed(total: real, taps: taps_of, a: real, b: real, c: real, d: real, e: real):
        return taps[0] * a + (taps[1] * b + (taps[2] * c + (taps[3] * d + (taps[4] * e + total))))

    return weighed


@cache
def make_weighed_evenly(real):
    """The same for taps that are alike to both sides."""
    taps_of = wp.types.vector(length=5, dtype=real)

    @wp.func
    def weighed_evenly(total: real, taps: taps_of, a: real, b: real, c: real, d: real, e: real):
        return taps[0] * (a + e) + (taps[1] * (b + d) + (taps[2] * c + total))

    return weighed_evenly

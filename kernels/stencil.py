"""Finite differences on unit spacing along x; ``aspect`` is (spacing x / spacing y)².

The second-order biharmonic is the Laplacian of the Laplacian, 13 nodes in all. In two passes it costs half the
arithmetic, and edges become simple: where the inner Laplacian (the curvature) is stored, a clamped edge, whose mirror
node doubles it, and a supported edge, where it is zero, are the factors 2 and 0 on the curvature of the edge's nodes.

The fourth-order form is two such passes too, each with five nodes along each axis. Edges change the taps of the two
nodes next to them in both passes, so taps near an edge are data.
"""

from functools import cache

import warp as wp


@cache
def make_laplacian(square_cells, real):
    """Make ``laplacian``: ∇²u from the five nodes of the cross."""

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
def make_weighted_sum(real):
    """Make ``weighted_sum``: total + Σ taps · five nodes in a row; each step is one fused multiply-add."""
    Taps = wp.types.vector(length=5, dtype=real)

    @wp.func
    def weighted_sum(total: real, taps: Taps, a: real, b: real, c: real, d: real, e: real):
        return taps[0] * a + (taps[1] * b + (taps[2] * c + (taps[3] * d + (taps[4] * e + total))))

    return weighted_sum

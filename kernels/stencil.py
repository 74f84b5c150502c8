"""Difference operators on unit spacing along x; ``aspect`` is (spacing x / spacing y)².

The 13-point biharmonic is the Laplacian of the Laplacian. Taking it in these two steps halves the arithmetic where
a path can keep the inner Laplacian, the plate's curvature, and is where the edges enter: on a clamped edge the
mirror node doubles the curvature, on a simply supported edge the curvature is zero. So an edge is one factor on
the curvature of its nodes, 2 or 0 (1 inside), and no path needs a special case for it.
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

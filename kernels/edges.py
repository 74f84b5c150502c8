"""Edges in the block path of the moment form: nodes are counted row after row; flags say which edges they lie on."""

from functools import cache

import warp as wp

# Bits of a node's flags: the edges on which it lies, and LOADED where some load field is not zero.
LEFT, RIGHT, BOTTOM, TOP, LOADED = 1, 2, 4, 8, 16
FLAG_BITS = 5


@cache
def make_edges(real, nx, ny):
    """Make edge_flags, sum_of_neighbours and twist_factor for plates of nx × ny nodes."""

    @wp.func
    def edge_flags(i: int):
        """Return the edges, LEFT … TOP, on which node i lies; nodes are counted row after row."""
        line = i // nx
        column = i - line * nx
        edges = int(0)
        if column == 0:
            edges = edges | LEFT
        if column == wp.static(nx - 1):
            edges = edges | RIGHT
        if line == 0:
            edges = edges | BOTTOM
        if line == wp.static(ny - 1):
            edges = edges | TOP
        return edges

    @wp.func
    def sum_of_neighbours(x: wp.array[real], at: int, low: int, high: int, flags: int, step: int):
        """Add the neighbours ``step`` before and after a node; on the edge ``low`` or ``high``, twice the inner one.

        By selection: a factor would have to be read, and 0 · NaN is NaN.
        """
        before = x[at - step]
        after = x[at + step]
        mirrored = after
        if (flags & high) != 0:
            mirrored = before
        if (flags & low) != 0:
            before = after
        return before + mirrored

    @wp.func
    def twist_factor(flags: int, root_aspect: real):
        """Return the factor of the twists around a node: on an edge, half its cells are mirror images."""
        factor = root_aspect
        if (flags & (LEFT | RIGHT)) != 0:
            factor = real(2.0) * factor
        if (flags & (BOTTOM | TOP)) != 0:
            factor = real(2.0) * factor
        return factor

    return edge_flags, sum_of_neighbours, twist_factor

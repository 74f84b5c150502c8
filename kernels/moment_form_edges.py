"""Mirror images beyond an edge, for kernels that know of each node by a few bits on which edges it lies."""

from functools import cache

import warp as wp

# Bits of a node's kind, how many there are, and how many kinds fit in a word of 32 bits.
LEFT, RIGHT, BOTTOM, TOP, LOADED = 1, 2, 4, 8, 16
BITS, WORD = 5, 6


@cache
def make_edges(real, nx, ny):
    """edges_of(node, counted row after row), across(two neighbours of a node), cells_of(factor of its twists)."""

    @wp.func
    def edges_of(i: int):
        """LEFT ... TOP of a node."""
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
    def across(x: wp.array[real], at: int, low: int, high: int, kind: int, step: int):
        """The sum of a node's neighbours, ``step`` before and after it; on an edge, ``low`` or ``high`` in its kind, of
        the inner one and its mirror image. (A selection: a factor would have to be read, and 0 · NaN is NaN.)"""
        before = x[at - step]
        after = x[at + step]
        mirrored = after
        if (kind & high) != 0:
            mirrored = before
        if (kind & low) != 0:
            before = after
        return before + mirrored

    @wp.func
    def cells_of(kind: int, root_aspect: real):
        """Factor of the twists around a node: on an edge, half its cells are mirror images."""
        cells = root_aspect
        if (kind & (LEFT | RIGHT)) != 0:
            cells = real(2.0) * cells
        if (kind & (BOTTOM | TOP)) != 0:
            cells = real(2.0) * cells
        return cells

    return edges_of, across, cells_of

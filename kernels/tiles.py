"""Tiles of a plate that is larger than a multiprocessor holds: each takes several steps as if it were a plate.

A tile overlaps its neighbours. Its own edges are held where the plate's are not, and what is wrong there spreads by the
reach of the differences in each step; so a tile writes only the nodes beyond that, and those at the plate's edges.
"""

from dataclasses import dataclass

import warp as wp


@dataclass(frozen=True)
class Cut:
    """Tiles along one axis of a plate; all are equally long, and the last ones overlap more where it does not divide.

    Attributes:
        nodes: Nodes of the plate, edges included.
        count: Number of tiles.
        length: Nodes of a tile, its edges included.
        margin: Nodes inside a tile's edges that are wrong when it has taken its steps; edges of the plate have none.
    """

    nodes: int
    count: int = 1
    length: int = 0
    margin: int = 0

    @property
    def pitch(self):
        """Nodes from one tile to the next."""
        return self.length - 2 - 2 * self.margin


def whole(nodes):
    """Return the axis of a plate that is not cut."""
    return Cut(nodes, 1, nodes, 0)


def cut(nodes, count, margin):
    """Return so many tiles, as short as possible, or one if these would be as long as the plate."""
    length = 2 + -(-(nodes - 2 + 2 * margin * (count - 1)) // count)
    return Cut(nodes, count, length, margin) if length < nodes else whole(nodes)


def make_place(axis):
    """Make ``place``: of tile i its first node, and in its own numbers the first node that it writes and the end."""

    @wp.func
    def place(i: int):
        last = wp.static(axis.nodes - axis.length)
        start = wp.min(i * wp.static(axis.pitch), last)
        next_start = wp.min((i + 1) * wp.static(axis.pitch), last)
        first = int(0)
        end = next_start - start + wp.static(1 + axis.margin)
        if i > 0:
            first = wp.static(1 + axis.margin)
        if i == wp.static(axis.count - 1):
            end = wp.static(axis.length)
        return start, first, end

    return place

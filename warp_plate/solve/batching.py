"""How a large batch on a CUDA device is cut: while it steps a part, the host makes the next ones ready."""

from __future__ import annotations

import math

# So many states take turns: the device steps one, the next one is ready, and the host is at the third.
TURNS = 3
# The first part, for which the device waits, is small, but has so much work as keeps it busy; the others grow to so
# many times as many plates. (An H200 runs 2112 plates of the paper's scene side by side, which are just that part.)
FIRST_NODE_STEPS, LARGEST_PART = 1.65e9, 16


def first_part(node_steps_per_plate: int) -> int:
    """How many plates the first part has."""
    return math.ceil(FIRST_NODE_STEPS / node_steps_per_plate)


def part_sizes(plates: int, first: int) -> list[int]:
    """How many plates each part has: twice as many as the one before, and few in the last, whose end is waited for."""
    last = 2 * first
    sizes, rest, size = [], plates - last, first
    while rest > 0:
        sizes.append(min(size, rest))
        rest, size = rest - sizes[-1], min(2 * size, LARGEST_PART * first)
    return [*sizes, last]

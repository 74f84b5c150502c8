"""Capacity of a CUDA device: the largest plates that fit on the chip, and the number of plates in its memory."""

from __future__ import annotations

from collections.abc import Callable

import warp as wp

from warp_plate.kernels import resident_strips, resident_wide
from warp_plate.kernels.cuda import RESERVED_BYTES
from warp_plate.kernels.effects import KernelEffects
from warp_plate.kernels.moment_form_plan import plan_block
from warp_plate.plate.discretization import discretize
from warp_plate.scene.model import Scene
from warp_plate.solve.parts import CUDA_MEMORY_SHARE
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import bytes_per_plate

# Nodes of a side that are tried.
SIDES = range(5, 1024)


def largest_resident_sides(device: wp.Device) -> dict[str, int]:
    """Return the nodes along a side of the largest square float32 plate that fits on a chip, by kind of plate."""
    shared = device.max_shared_memory_per_block - RESERVED_BYTES
    free_edges = KernelEffects(moments=True)
    kinds: dict[str, Callable[[int], object]] = {
        "order 2": lambda side: next(resident_strips.plans(side, side, wp.float32, shared), None),
        "order 4": lambda side: next(resident_wide.plans(side, side, wp.float32, shared), None),
        "free edges": lambda side: plan_block(side, side, wp.float32, free_edges, 0, False, shared).on_chip,
    }
    return {kind: max(filter(fits, SIDES), default=0) for kind, fits in kinds.items()}


def plates_in_memory(scene: Scene, device: wp.Device) -> int:
    """Return how many plates of a scene fit in the free memory of a CUDA device at a time."""
    specialized = Specialized(discretize(scene), device)
    return int(CUDA_MEMORY_SHARE * device.free_memory / bytes_per_plate(specialized, 0))

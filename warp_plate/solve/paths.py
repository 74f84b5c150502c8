"""The ways to step a chunk of plates, by device and name, and which one a scene takes."""

from __future__ import annotations

from collections.abc import Callable

import warp as wp

from warp_plate.solve import cpu, cuda, streaming
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import Advance

MakePath = Callable[[Specialized], Advance]

PATHS: dict[str, dict[str, MakePath]] = {
    "cpu": {"resident": cpu.resident_path, "streaming": streaming.streaming_path},
    "cuda": {"resident": cuda.resident_path, "streaming": cuda.streaming_path},
}


def paths_of(device: wp.Device) -> dict[str, MakePath]:
    """The paths that a device has, by name."""
    return PATHS["cuda" if device.is_cuda else "cpu"]


def choose_path(specialized: Specialized) -> str:
    """The fastest path: resident wherever the plate fits on the chip."""
    return "resident" if specialized.device.is_cpu or cuda.fits_on_chip(specialized) else "streaming"

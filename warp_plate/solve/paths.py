"""The ways to step a chunk of plates, by device and name, and which one a scene takes."""

from __future__ import annotations

from collections.abc import Callable

import warp as wp

from warp_plate.solve import cpu, cuda, streaming
from warp_plate.solve import moment_form as general
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import Advance

MakePath = Callable[[Specialized], Advance]

PATHS: dict[str, dict[str, MakePath]] = {
    "cpu": {"resident": cpu.resident_path, "streaming": streaming.streaming_path},
    "cuda": {"resident": cuda.resident_path, "streaming": cuda.streaming_path},
}


# Of scenes that ask for more than the plain plate.
GENERAL: dict[str, MakePath] = {"resident": general.resident_path, "streaming": general.streaming_path}


def paths_of(device: wp.Device, plain: bool = True) -> dict[str, MakePath]:
    """The paths that a device has, by name; ``plain``: for a plain plate."""
    return PATHS["cuda" if device.is_cuda else "cpu"] if plain else GENERAL


def why_streaming(specialized: Specialized, traced: bool = False) -> str | None:
    """Why plates cannot run resident, or, if they are ``traced``, do not; None where they do."""
    if specialized.device.is_cpu or not specialized.effects.plain:
        return None
    if not cuda.fits_on_chip(specialized):
        nx, ny = specialized.scheme.nodes
        return f"{nx} x {ny} nodes of order {specialized.scheme.order} do not fit on one multiprocessor"
    return "traces of points are taken between launches" if traced else None


def choose_path(specialized: Specialized) -> str:
    """The fastest path: resident wherever the plate fits on the chip."""
    return "streaming" if why_streaming(specialized) else "resident"

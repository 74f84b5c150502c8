"""The paths, by device and name, and the choice of one for a scene."""

from __future__ import annotations

from collections.abc import Callable

import warp as wp

from warp_plate.kernels.cuda import LANES
from warp_plate.solve import cpu, cuda, moment_form, streaming
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import Advance

MakePath = Callable[[Specialized], Advance]

# Paths of plain plates on a CPU and on CUDA, and those of all other scenes.
CPU: dict[str, MakePath] = {"resident": cpu.resident_path, "streaming": streaming.streaming_path}
CUDA: dict[str, MakePath] = {"resident": cuda.resident_path, "streaming": cuda.streaming_path}
MOMENT_FORM: dict[str, MakePath] = {"resident": moment_form.resident_path, "streaming": moment_form.streaming_path}


def paths_of(device: wp.Device, plain: bool = True) -> dict[str, MakePath]:
    """Return the paths of a device by name, for a plain plate or for the moment form."""
    return MOMENT_FORM if not plain else CUDA if device.is_cuda else CPU


def why_streaming(specialized: Specialized, traced: bool = False) -> str | None:
    """Return why plates (with ``traced`` points) do not run resident, or None if they do."""
    if specialized.device.is_cpu:
        return None
    nx, ny = specialized.scheme.nodes
    if not specialized.effects.plain:
        if moment_form.takes_blocks(specialized) and not moment_form.plan_of(specialized, few=False).on_chip:
            return f"{nx} x {ny} nodes with their moments do not fit on one multiprocessor"
        return None
    if not cuda.fits_on_chip(specialized):
        return f"{nx} x {ny} nodes of order {specialized.scheme.order} do not fit on one multiprocessor"
    return "traces of points are taken between launches" if traced else None


def describe_plan(specialized: Specialized) -> str:
    """Return how the fastest path distributes plates over the device."""
    device = specialized.device
    if device.is_cpu:
        return f"all steps of a plate in one launch, on {specialized.threads} threads"
    if reason := why_streaming(specialized):
        return f"one or a few steps a launch, for {reason}"
    if specialized.effects.plain:
        plan = None if cuda.takes_lanes(specialized) else cuda.plan_of(specialized)
        return f"all steps in one launch, a plate on {plan.warps if plan else 1} warps of {LANES} threads"
    block = moment_form.plan_of(specialized, few=False)
    place = "on the chip"
    if not block.on_chip:
        place = f"in device memory: they exceed the {specialized.shared_bytes / 1024:.0f} KiB of a block"
    return f"all steps in one launch, a plate on {block.threads} threads, its working fields {place}"


def choose_path(specialized: Specialized) -> str:
    """Return the fastest path: resident wherever the plate fits on the chip."""
    return "streaming" if why_streaming(specialized) else "resident"

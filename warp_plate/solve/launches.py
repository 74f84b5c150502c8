"""Launches that are done again and again: put together once, and repeated without what each takes in Python."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from warp_plate.solve.state import State

# ``wp.launch``, or what takes the same and records the launch instead.
Launcher = Callable[..., Any]


def repeat(device: wp.Device, launches: Callable[..., object], state: State, *which: int) -> None:
    """``launches(wp.launch, state, *which)``, put together when it is called with these numbers for the first time.

    They are kept with the state, whose addresses they hold: as a CUDA graph; on CPU one by one. Buffers that take turns
    must end where they began. No other thread may use the device's stream meanwhile.
    """
    # Of what a state has, waves may be others the next time, and buffers that take turns may have been left turned.
    name = (launches, *which, state.has_plate_waves, state.u.ptr)
    if name not in state.beside:
        state.beside[name] = _put_together(device, lambda launch: launches(launch, state, *which))
    state.beside[name]()


def _put_together(device: wp.Device, launches: Callable[[Launcher], object]) -> Callable[[], object]:
    if device.is_cuda:
        with wp.ScopedCapture(device=device) as capture:
            launches(wp.launch)
        return lambda: wp.capture_launch(capture.graph)
    # (Warp's graphs on CPU are faster still, but they capture what any thread launches on the CPU, and threads do.)
    recorded: list[wp.Launch] = []
    launches(lambda kernel, **given: recorded.append(wp.launch(kernel, **given, record_cmd=True)))

    def again() -> None:
        for one in recorded:
            one.launch()

    return again

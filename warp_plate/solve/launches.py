"""Sequences of launches that are recorded once and repeated, without Python's overhead for each launch."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import warp as wp

from warp_plate.solve.state import State

# ``wp.launch``, or a function with its arguments that records the launch instead.
Launcher = Callable[..., Any]


def repeat(device: wp.Device, launches: Callable[..., object], state: State, *numbers: int) -> None:
    """Run ``launches(wp.launch, state, *numbers)``, recorded when it is called with these numbers for the first time.

    Recordings are kept with the state, whose addresses they hold: as a CUDA graph, on CPU as a list. Buffers that take
    turns must end where they began. No other thread may use the device's stream meanwhile.
    """
    # A state may have other waves the next time, and buffers may have been left in the other turn.
    key = (launches, *numbers, state.has_plate_waves, state.u.ptr)
    if key not in state.beside:
        state.beside[key] = _record(device, lambda launch: launches(launch, state, *numbers))
    state.beside[key]()


def _record(device: wp.Device, launches: Callable[[Launcher], object]) -> Callable[[], object]:
    if device.is_cuda:
        with wp.ScopedCapture(device=device) as capture:
            launches(wp.launch)
        return lambda: wp.capture_launch(capture.graph)
    # Warp's graphs on CPU would be faster, but they capture the launches of all threads.
    recorded: list[wp.Launch] = []
    launches(lambda kernel, **arguments: recorded.append(wp.launch(kernel, **arguments, record_cmd=True)))

    def replay() -> None:
        for launch in recorded:
            launch.launch()

    return replay

"""The plain streaming path of every device, and launches repeated from records, which saves Python's overhead."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import warp as wp

from warp_plate.kernels import streaming
from warp_plate.kernels.temporal_blocking import READ_LATER
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import Advance, State

# ``wp.launch``, or a function with its arguments that records the launch instead.
Launcher = Callable[..., Any]
# Launches that are recorded together; even, so that alternating buffers end where they began.
STEPS = 16
# (launch, state, plates, clock, offset, levels, summed): make the launch of ``levels`` steps from clock[0] + offset on.
LaunchTiles = Callable[[Launcher, State, int, wp.array, int, int, bool], None]


def repeat(device: wp.Device, launches: Callable[..., object], state: State, *numbers: int) -> None:
    """Run ``launches(wp.launch, state, *numbers)``, recorded when it is called with these numbers for the first time.

    Recordings are kept with the state, because they hold its addresses: as a CUDA graph, on CPU as a list. Buffers
    that alternate must end where they began. No other thread may use the device's stream meanwhile.
    """
    # A state may have other waves the next time, and its alternating buffers may have been left exchanged.
    key = (launches, *numbers, state.has_plate_waves, state.u.ptr)
    if key not in state.recordings:
        state.recordings[key] = _record(device, lambda launch: launches(launch, state, *numbers))
    state.recordings[key]()


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


def record_nodes(
    launch: Launcher, record_trace: wp.Kernel, state: State, plates: int, clock: wp.array, offset: int
) -> None:
    """Record the traced nodes of a state, if there are any, at step clock[0] + offset."""
    if state.nodes.shape[0]:
        inputs = [clock, offset, state.fields]
        launch(record_trace, dim=(plates, state.nodes.shape[0]), inputs=inputs, device=clock.device)


def several_steps_a_launch(specialized: Specialized, most_levels: int, launch_tiles: LaunchTiles) -> Advance:
    """Return a path of temporal blocking: ``most_levels`` steps a launch, one where traced nodes are recorded."""
    device, record_trace = specialized.device, streaming.make_record_trace(specialized.real)
    specialized.load(record_trace, streaming.advance_clock)
    clock = wp.zeros(1, dtype=int, device=device)

    def launches(launch: Launcher, state: State, plates: int, count: int, levels: int, summed: bool) -> None:
        for index in range(count):
            launch_tiles(launch, state, plates, clock, index * levels, levels, summed)
            state.alternate()
            record_nodes(launch, record_trace, state, plates, clock, index)
        launch(streaming.advance_clock, dim=1, inputs=[clock, count * levels], device=device)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        clock.fill_(start)
        levels = 1 if state.nodes.shape[0] else most_levels  # a trace needs every step
        for low, high, summed in split_at_window(specialized, start, stop):
            blocks, rest = divmod(high - low, levels)
            runs, blocks = divmod(blocks, STEPS)
            for _ in range(runs):
                repeat(device, launches, state, plates, STEPS, levels, summed)
            if blocks:
                launches(wp.launch, state, plates, blocks, levels, summed)
            if rest:
                launches(wp.launch, state, plates, rest, 1, summed)

    return advance


def split_at_window(specialized: Specialized, start: int, stop: int) -> list[tuple[int, int, bool]]:
    """Return (first, last + 1, inside) of the runs of steps before, inside and after the window."""
    first, last = (min(max(step, start), stop) for step in specialized.scheme.window)
    runs = ((start, first, False), (first, last, True), (last, stop, False))
    return [run for run in runs if run[1] > run[0]]


def loaded_ahead(specialized: Specialized, margin: int, rows: int, later: Sequence[int] = ()) -> wp.array:
    """Return bits of the loaded rows, ``rows`` of them from each on, from 2·margin below the tensor to as many above.

    A round of temporal blocking moves these rows: bit b is set where the row b above is loaded, and bit READ_LATER
    where one of the words ``later`` rows above has a bit.
    """
    padded = np.pad(np.array(specialized.loaded_rows, dtype=np.int32), (2 * margin, 2 * margin + rows))
    count = specialized.rows + 4 * margin
    words = np.sum([padded[bit : bit + count] << bit for bit in range(rows)], axis=0)
    loaded = np.pad(words != 0, (0, max(later, default=0)))
    read_later = sum(loaded[distance : distance + count] for distance in later)
    words += np.sign(read_later) << READ_LATER
    return wp.array(words.astype(np.int32), dtype=int, device=specialized.device)


def streaming_path(specialized: Specialized) -> Advance:
    """Return the path with two launches per step and a thread per node."""
    device, real, effects = specialized.device, specialized.real, specialized.effects
    compute_curvature = streaming.make_compute_curvature(effects, real)
    update_nodes = streaming.make_update_nodes(effects, real)
    record_trace = streaming.make_record_trace(real)
    specialized.load(compute_curvature, update_nodes, record_trace, streaming.advance_clock)
    nx, ny = specialized.scheme.nodes
    bend_x, bend_y, move_x, move_y = specialized.taps
    window, clock = wp.vec2i(*specialized.scheme.window), wp.zeros(1, dtype=int, device=device)

    def launches(launch: Launcher, state: State, plates: int, count: int) -> None:
        curvature = state.u_next
        for offset in range(count):
            inputs = [bend_x, bend_y, state.u]
            launch(compute_curvature, dim=(plates, ny, nx), inputs=inputs, outputs=[curvature], device=device)
            launch(
                update_nodes,
                dim=(plates, ny - 2, nx - 2),
                inputs=[specialized.parameters, move_x, move_y, window, clock, offset, state.drive, curvature],
                outputs=[state.fields],
                device=device,
            )
            record_nodes(launch, record_trace, state, plates, clock, offset)
        launch(streaming.advance_clock, dim=1, inputs=[clock, count], device=device)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        clock.fill_(start)
        runs, rest = divmod(stop - start, STEPS)
        for _ in range(runs):
            repeat(device, launches, state, plates, STEPS)
        launches(wp.launch, state, plates, rest)

    return advance

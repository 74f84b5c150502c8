"""The plain streaming path of every device: launches for each step, captured in CUDA graphs where there are any."""

from __future__ import annotations

from collections.abc import Callable

import warp as wp

from warp_plate.kernels import record, streaming
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import Advance, State

# Steps in one captured graph.
GRAPH_STEPS = 16


def streaming_path(specialized: Specialized) -> Advance:
    """Two launches a step, a thread a node."""
    device = specialized.device
    launches = _launches(specialized)
    clock = wp.zeros(1, dtype=int, device=device)
    graphs: dict[tuple[int, ...], wp.Graph] = {}

    def replay(state: State, plates: int) -> None:
        # A graph holds addresses: it serves one number of plates and one state.
        arrays = (state.u, state.u_next, state.rate, state.squares, state.in_phase, state.nodes, state.trace)
        key = (plates, state.wave.ptr, *(array.ptr or 0 for array in arrays))
        if key not in graphs:
            with wp.ScopedCapture(device=device) as capture:
                launches(state, plates, clock, GRAPH_STEPS)
            graphs[key] = capture.graph
        wp.capture_launch(graphs[key])

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        clock.fill_(start)
        whole, rest = divmod(stop - start, GRAPH_STEPS) if device.is_cuda else (0, stop - start)
        for _ in range(whole):
            replay(state, plates)
        launches(state, plates, clock, rest)

    return advance


def _launches(specialized: Specialized) -> Callable[[State, int, wp.array, int], None]:
    """(state, plates, clock, steps): the launches of so many steps from the clock's on; the clock is moved on."""
    device, real, effects = specialized.device, specialized.real, specialized.effects
    bend, move = streaming.make_bend(effects, real), streaming.make_move(effects, real)
    keep = record.make_record(real)
    for kernel in (bend, move, keep, record.advance_clock):
        wp.load_module(module=kernel.module, device=device)
    nx, ny = specialized.scheme.nodes
    bend_x, bend_y, move_x, move_y = specialized.taps
    shared = [specialized.parameters, move_x, move_y]
    window = wp.vec2i(*specialized.scheme.window)

    def launches(state: State, plates: int, clock: wp.array, steps: int) -> None:
        for offset in range(steps):
            curvature = state.u_next
            wp.launch(
                bend, dim=(plates, ny, nx), inputs=[bend_x, bend_y, state.u], outputs=[curvature], device=device
            )
            wp.launch(
                move,
                dim=(plates, ny - 2, nx - 2),
                inputs=[*shared, state.wave, window, clock, offset, state.in_phase, state.quadrature, curvature],
                outputs=[state.u, state.rate, state.squares],
                device=device,
            )
            if state.nodes.shape[0]:
                inputs, outputs = [clock, offset, state.nodes, state.u], [state.trace]
                wp.launch(keep, dim=(plates, state.nodes.shape[0]), inputs=inputs, outputs=outputs, device=device)
        wp.launch(record.advance_clock, dim=1, inputs=[clock, steps], device=device)

    return launches

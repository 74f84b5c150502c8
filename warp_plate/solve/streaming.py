"""The plain streaming path of every device, and how any path steps that takes a few launches for a step."""

from __future__ import annotations

from collections.abc import Callable

import warp as wp

from warp_plate.kernels import record, streaming
from warp_plate.solve.launches import Launcher, repeat
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import Advance, State

# Steps whose launches are put together.
STEPS = 16
# (launch, state, plates, clock, offset): the launches of step clock[0] + offset.
Step = Callable[[Launcher, State, int, wp.array, int], None]


def step_by_step(specialized: Specialized, step: Step) -> Advance:
    """Steps of a few launches each, after which the trace is kept."""
    device, keep = specialized.device, record.make_record(specialized.real)
    for kernel in (keep, record.advance_clock):
        wp.load_module(module=kernel.module, device=device)
    clock = wp.zeros(1, dtype=int, device=device)

    def steps(launch: Launcher, state: State, plates: int, count: int) -> None:
        for offset in range(count):
            step(launch, state, plates, clock, offset)
            if state.nodes.shape[0]:
                inputs, outputs = [clock, offset, state.nodes, state.u], [state.trace]
                launch(keep, dim=(plates, state.nodes.shape[0]), inputs=inputs, outputs=outputs, device=device)
        launch(record.advance_clock, dim=1, inputs=[clock, count], device=device)

    def advance(state: State, plates: int, start: int, stop: int) -> None:
        clock.fill_(start)
        whole, rest = divmod(stop - start, STEPS)
        for _ in range(whole):
            repeat(device, steps, state, plates, STEPS)
        steps(wp.launch, state, plates, rest)

    return advance


def streaming_path(specialized: Specialized) -> Advance:
    """Two launches a step, a thread a node."""
    device, real, effects = specialized.device, specialized.real, specialized.effects
    bend, move = streaming.make_bend(effects, real), streaming.make_move(effects, real)
    for kernel in (bend, move):
        wp.load_module(module=kernel.module, device=device)
    nx, ny = specialized.scheme.nodes
    bend_x, bend_y, move_x, move_y = specialized.taps
    shared = [specialized.parameters, move_x, move_y]
    window = wp.vec2i(*specialized.scheme.window)

    def step(launch: Launcher, state: State, plates: int, clock: wp.array, offset: int) -> None:
        curvature = state.u_next
        launch(bend, dim=(plates, ny, nx), inputs=[bend_x, bend_y, state.u], outputs=[curvature], device=device)
        launch(
            move,
            dim=(plates, ny - 2, nx - 2),
            inputs=[*shared, state.wave, window, clock, offset, state.in_phase, state.quadrature, curvature],
            outputs=[state.u, state.rate, state.squares],
            device=device,
        )

    return step_by_step(specialized, step)

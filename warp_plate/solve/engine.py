"""A scene's kernels on one device, ready to run: put drives in, step plates, take sums out.

Everything here is in the kernels' scaled numbers; ``solver`` turns them into SI units.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp

from warp_plate.kernels.energy import make_sum_along_columns, make_sum_columns
from warp_plate.kernels.load import make_spread_drives
from warp_plate.scene.errors import SceneError
from warp_plate.solve.paths import choose_path, paths_of
from warp_plate.solve.per_plate import PerPlateKernels, make_per_plate_kernels
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import Advance, State


@dataclass(frozen=True)
class Engine:
    """The compiled kernels of a specialized scene; ``advance(state, plates, start, stop)`` steps plates."""

    specialized: Specialized
    path: str
    advance: Advance
    spread_drives: wp.Kernel
    per_plate: PerPlateKernels
    sum_along_columns: wp.Kernel
    sum_columns: wp.Kernel


def make_engine(specialized: Specialized, path: str = "auto") -> Engine:
    """Compile, or read from Warp's cache, all that a run needs.

    Raises:
        SceneError: no such path on this device, or the plate does not fit it.
    """
    device = specialized.device
    path = choose_path(specialized) if path == "auto" else path
    if path not in paths_of(device):
        raise SceneError(f"path = {path!r}: no such path; there are: auto, {', '.join(paths_of(device))}")
    spread, along_columns, columns = (
        make_spread_drives(specialized.real), make_sum_along_columns(specialized.real), make_sum_columns()
    )
    for kernel in (spread, along_columns, columns):
        wp.load_module(module=kernel.module, device=device)
    advance = paths_of(device, specialized.effects.plain)[path](specialized)
    return Engine(specialized, path, advance, spread, make_per_plate_kernels(specialized), along_columns, columns)


def load_drives(engine: Engine, state: State, plates: int, edges: np.ndarray | None = None) -> None:
    """Turn the coefficients that wait on the host into load fields of the first plates; the others stay.

    edges: (plates, actuators, 4) x0, x1, y0, y1 [m] of actuators in places of each plate's own; None: the scene's.
    """
    specialized = engine.specialized
    wp.copy(state.coefficients, state.host.coefficients, count=plates * state.coefficients[0].size)
    spread, inputs = engine.spread_drives, [specialized.support, specialized.patches]
    if edges is not None:
        engine.per_plate.put_places(state, edges)
        spread, inputs = engine.per_plate.spread_moved_drives, [*engine.per_plate.inputs, state.along_x, state.along_y]
    wp.launch(
        spread,
        dim=(plates, specialized.effects.terms, specialized.support.shape[0]),
        inputs=[state.coefficients, *inputs],
        outputs=[state.loads],
        device=specialized.device,
    )


def queue_region_sums(engine: Engine, state: State, plates: int) -> Callable[[], np.ndarray]:
    """Have the weighted sums of rate² over the window made and copied to the host, for the first plates.

    Returns:
        What waits for them: (plates, regions), a view that the state's next run overwrites.
    """
    specialized = engine.specialized
    regions, _, columns = specialized.weights.shape
    wp.launch(
        engine.sum_along_columns,
        dim=(plates, regions, columns),
        inputs=[state.squares, specialized.weights],
        outputs=[state.column_sums],
        device=specialized.device,
    )
    inputs, outputs = [state.column_sums], [state.energy]
    wp.launch(engine.sum_columns, dim=(plates, regions), inputs=inputs, outputs=outputs, device=specialized.device)
    wp.copy(state.host.energy, state.energy, count=plates * regions)
    done = wp.get_stream(specialized.device).record_event() if specialized.device.is_cuda else None
    energy = state.host.energy  # and not the state, whose room may be wanted

    def wait() -> np.ndarray:
        if done is not None:
            wp.synchronize_event(done)
        return np.asarray(energy.numpy()[:plates])

    return wait

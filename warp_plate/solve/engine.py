"""The compiled kernels of a scene on one device: write loads, step plates, sum energies.

All numbers are in the kernels' scaled units; ``solver`` converts to SI.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import warp as wp

from warp_plate.kernels.energy import make_sum_over_rows, sum_over_columns
from warp_plate.kernels.load import make_write_loads
from warp_plate.scene.errors import SceneError
from warp_plate.solve.paths import choose_path, paths_of
from warp_plate.solve.per_plate import PerPlateKernels, make_per_plate_kernels
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import Advance, State


@dataclass(frozen=True)
class Engine:
    """The compiled kernels of a specialized scene.

    Attributes:
        specialized: The scene on the device.
        path: Name of the path.
        advance: Steps plates, see ``state.Advance``.
        write_loads: Kernel of the load fields.
        per_plate: Kernels for what differs from plate to plate.
        sum_over_rows: First kernel of the energies.
    """

    specialized: Specialized
    path: str
    advance: Advance
    write_loads: wp.Kernel
    per_plate: PerPlateKernels
    sum_over_rows: wp.Kernel


def make_engine(specialized: Specialized, path: str = "auto") -> Engine:
    """Compile the kernels of a run, or load them from Warp's cache.

    Raises:
        SceneError: The device has no such path, or the plate does not fit it.
    """
    device = specialized.device
    path = choose_path(specialized) if path == "auto" else path
    if path not in paths_of(device):
        raise SceneError(f"path = {path!r}: no such path; there are: auto, {', '.join(paths_of(device))}")
    write_loads, sum_over_rows = make_write_loads(specialized.real), make_sum_over_rows(specialized.real)
    for kernel in (write_loads, sum_over_rows, sum_over_columns):
        wp.load_module(module=kernel.module, device=device)
    advance = paths_of(device, specialized.effects.plain)[path](specialized)
    return Engine(specialized, path, advance, write_loads, make_per_plate_kernels(specialized), sum_over_rows)


def load_drives(engine: Engine, state: State, plates: int, edges: np.ndarray | None = None) -> None:
    """Copy the coefficients of the first plates to the device and write their load fields.

    Args:
        engine: The kernels.
        state: Plates, with coefficients in ``state.host``.
        plates: Number of plates to load; the others keep their loads.
        edges: (plates, actuators, 4) x0, x1, y0, y1 [m] of each plate's actuators (default: the scene's).
    """
    specialized = engine.specialized
    wp.copy(state.coefficients, state.host.coefficients, count=plates * state.coefficients[0].size)
    kernel, inputs = engine.write_loads, [specialized.support, specialized.patches]
    if edges is not None:
        per_plate = engine.per_plate
        per_plate.put_places(state, edges)
        kernel, inputs = per_plate.write_placed_loads, [*per_plate.inputs, state.along_x, state.along_y]
    wp.launch(
        kernel,
        dim=(plates, specialized.effects.terms, specialized.support.shape[0]),
        inputs=[state.coefficients, *inputs],
        outputs=[state.loads],
        device=specialized.device,
    )


def queue_region_sums(engine: Engine, state: State, plates: int) -> Callable[[], np.ndarray]:
    """Queue the weighted sums of rate² over the window for the first plates, and their copy to the host.

    Returns:
        Function that waits for the sums and returns them, (plates, regions), as a view that the next run overwrites.
    """
    specialized = engine.specialized
    regions, _, columns = specialized.weights.shape
    wp.launch(
        engine.sum_over_rows,
        dim=(plates, regions, columns),
        inputs=[state.squares, specialized.weights],
        outputs=[state.column_sums],
        device=specialized.device,
    )
    inputs, outputs = [state.column_sums], [state.energy]
    wp.launch(sum_over_columns, dim=(plates, regions), inputs=inputs, outputs=outputs, device=specialized.device)
    wp.copy(state.host.energy, state.energy, count=plates * regions)
    done = wp.get_stream(specialized.device).record_event() if specialized.device.is_cuda else None
    energy = state.host.energy  # and not the state, which may be released

    def wait() -> np.ndarray:
        if done is not None:
            wp.synchronize_event(done)
        return np.asarray(energy.numpy()[:plates])

    return wait

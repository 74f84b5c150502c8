"""A scene's kernels on one device, ready to run: put drives in, step plates, take sums out.

Everything here is in the kernels' scaled numbers; ``solver`` turns them into SI units.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from warp_plate.kernels.energy import make_sum_along_columns, make_sum_columns
from warp_plate.kernels.load import make_spread_drives
from warp_plate.scene.errors import SceneError
from warp_plate.solve.paths import choose_path, paths_of
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import Advance, State


@dataclass(frozen=True)
class Engine:
    """The compiled kernels of a specialized scene; ``advance(state, plates, start, stop)`` steps plates."""

    specialized: Specialized
    path: str
    advance: Advance
    spread_drives: wp.Kernel
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
    kernels = (make_spread_drives(specialized.real), make_sum_along_columns(specialized.real), make_sum_columns())
    for kernel in kernels:
        wp.load_module(module=kernel.module, device=device)
    return Engine(specialized, path, paths_of(device, specialized.effects.plain)[path](specialized), *kernels)


def load_drives(engine: Engine, state: State, coefficients: np.ndarray) -> None:
    """Turn coefficients (plates, terms, actuators) into load fields of the first plates; the others stay."""
    specialized = engine.specialized
    plates, terms, _ = coefficients.shape
    parts = np.zeros(state.coefficients.shape, dtype=specialized.scene.grid.precision)
    parts[:plates] = coefficients
    state.coefficients.assign(parts)
    wp.launch(
        engine.spread_drives,
        dim=(plates, terms, specialized.support.shape[0]),
        inputs=[state.coefficients, specialized.support, specialized.patches],
        outputs=[state.loads],
        device=specialized.device,
    )


def region_sums(engine: Engine, state: State, plates: int) -> np.ndarray:
    """(plates, regions) weighted sums of rate² over the window, for the first plates."""
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
    sums: np.ndarray = state.energy.numpy()[:plates]
    return sums

"""The compiled kernels of a scene on one device: write loads, step plates, sum energies.

All numbers are in the kernels' scaled units; ``batching`` converts to SI.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import warp as wp

from warp_plate.kernels.energy import make_sum_over_rows, sum_over_columns
from warp_plate.kernels.load import make_write_loads
from warp_plate.kernels.peak import make_keep_largest
from warp_plate.scene.errors import SceneError
from warp_plate.solve.paths import choose_path, paths_of
from warp_plate.solve.per_plate import PerPlateKernels
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import State
from warp_plate.solve.status import largest_rate_per_step
from warp_plate.solve.streaming import Launcher, repeat


class Engine:
    """The kernels of a specialized scene, compiled or loaded from Warp's cache.

    Attributes:
        specialized: The scene on the device.
        path: Name of the path, "resident" or "streaming".
        advance: Steps plates, see ``state.Advance``.
        per_plate: Kernels for what differs from plate to plate.
        largest_rate: Rate that no bounded plate exceeds per step since the start, see ``solve.status``.

    Raises:
        SceneError: The device has no such path, or the plate does not fit it.
    """

    def __init__(self, specialized: Specialized, path: str = "auto") -> None:
        device, real = specialized.device, specialized.real
        self.specialized = specialized
        self.path = choose_path(specialized) if path == "auto" else path
        paths = paths_of(device, specialized.effects.plain)
        if self.path not in paths:
            raise SceneError(f"path = {path!r}: no such path; there are: auto, {', '.join(paths)}")
        self._write_loads, self._sum_over_rows = make_write_loads(real), make_sum_over_rows(real)
        self._keep_largest = make_keep_largest(real)
        specialized.load(self._write_loads, self._sum_over_rows, sum_over_columns)
        self.advance = paths[self.path](specialized)
        self.per_plate = PerPlateKernels(specialized)
        self.largest_rate = largest_rate_per_step(specialized)

    def load_drives(self, state: State, plates: int, edges: np.ndarray | None = None) -> None:
        """Copy the coefficients of the first plates to the device and write their load fields.

        Args:
            state: Plates, with coefficients in ``state.host_coefficients``.
            plates: Number of plates to load; the others keep their loads.
            edges: (plates, actuators, 4) x0, x1, y0, y1 [m] of each plate's actuators (default: the scene's).
        """
        wp.copy(state.coefficients, state.host_coefficients, count=plates * state.coefficients[0].size)
        self.write_loads(state, plates, edges)

    def write_loads(self, state: State, plates: int, edges: np.ndarray | None = None) -> None:
        """Write the load fields of the first plates from ``state.coefficients``; ``edges`` as in ``load_drives``."""
        specialized = self.specialized
        kernel, inputs = self._write_loads, [specialized.support, specialized.patches]
        if edges is not None:
            kernel, inputs = self.per_plate.put_places(state, edges)
        wp.launch(
            kernel,
            dim=(plates, specialized.effects.terms, specialized.support.shape[0]),
            inputs=[state.coefficients, *inputs],
            outputs=[state.loads],
            device=specialized.device,
        )

    def keep_largest(self, u: wp.array, largest: wp.array) -> Callable[[], None]:
        """Return a function that queues that ``largest`` keeps the largest magnitudes of u.

        Both are (plates, rows, columns).
        """
        kernel, device = self._keep_largest, self.specialized.device
        self.specialized.load(kernel)
        launch = wp.launch(kernel, dim=u.shape, inputs=[u], outputs=[largest], device=device, record_cmd=True)
        return launch.launch

    def sum_regions(self, state: State, plates: int) -> None:
        """Queue the weighted sums of rate² over the window for the first plates, into ``state.energy``."""
        device, weights = self.specialized.device, self.specialized.weights
        regions, _, columns = weights.shape
        inputs, outputs = [state.squares, weights], [state.column_sums]
        wp.launch(self._sum_over_rows, (plates, regions, columns), inputs=inputs, outputs=outputs, device=device)
        wp.launch(
            sum_over_columns, (plates, regions), inputs=[state.column_sums], outputs=[state.energy], device=device
        )

    def sums_to_host(self, state: State, plates: int) -> None:
        """Queue the sums of :meth:`sum_regions`, and their copy to the host."""
        self.sum_regions(state, plates)
        wp.copy(state.host_energy, state.energy, count=plates * state.energy.shape[1])

    def run_whole(self, state: State, plates: int) -> None:
        """Queue a run from rest to the end of the window, from ``host_coefficients`` to ``host_energy``.

        On CUDA all of it becomes one recorded call when a state takes so many plates for the second time.
        """
        key = (self.run_whole, plates, state.has_plate_waves)
        if key in state.beside:
            repeat(self.specialized.device, self._queue_whole, state, plates)
        else:
            state.beside[key] = True
            self._queue_whole(wp.launch, state, plates)

    def _queue_whole(self, launch: Launcher, state: State, plates: int) -> None:
        self.load_drives(state, plates)
        state.clear(plates)
        self.advance(state, plates, 0, self.specialized.scheme.steps)
        self.sums_to_host(state, plates)

    def wait_for_sums(self, state: State, plates: int) -> Callable[[], np.ndarray]:
        """Return a function that waits for what is queued now.

        It returns the sums, (plates, regions), as a view that the next run overwrites.
        """
        device = self.specialized.device
        done = wp.get_stream(device).record_event() if device.is_cuda else None
        energy = state.host_energy  # and not the state, which may be released

        def wait() -> np.ndarray:
            if done is not None:
                wp.synchronize_event(done)
            return np.asarray(energy.numpy()[:plates])

        return wait

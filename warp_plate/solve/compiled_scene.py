"""The compiled kernels of a scene on one device: write waves and loads, step plates by a path, sum energies.

All numbers are in the kernels' scaled units; ``batching`` converts to SI.
"""

from collections.abc import Callable

import numpy as np
import warp as wp

from warp_plate.kernels.cuda import LANES
from warp_plate.kernels.energy import make_sum_over_rows, sum_over_columns
from warp_plate.kernels.loads import (
    Envelope,
    make_accumulate_waves,
    make_weigh_spans,
    make_write_loads,
    make_write_placed_loads,
    make_write_tones,
)
from warp_plate.plate.designs import PerPlateValues
from warp_plate.plate.shapes import lagrange
from warp_plate.plate.signals import waves_per_plate
from warp_plate.plate.weights import node_positions
from warp_plate.scene.errors import SceneError
from warp_plate.solve import cpu, cuda, moment_form, streaming
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import Advance, State
from warp_plate.solve.streaming import Launcher, repeat

MakePath = Callable[[Specialized], Advance]

# Paths of plain plates on a CPU and on CUDA, and those of all other scenes.
CPU: dict[str, MakePath] = {"resident": cpu.resident_path, "streaming": streaming.streaming_path}
CUDA: dict[str, MakePath] = {"resident": cuda.resident_path, "streaming": cuda.streaming_path}
MOMENT_FORM: dict[str, MakePath] = {"resident": moment_form.resident_path, "streaming": moment_form.streaming_path}
# Largest block of samples of waves that the host computes at once.
HOST_NUMBERS = 2**24


def paths_of(specialized: Specialized) -> dict[str, MakePath]:
    """Return the paths of a scene on its device by name."""
    if specialized.effects.plain:
        return CUDA if specialized.device.is_cuda else CPU
    return MOMENT_FORM if moment_form.takes_blocks(specialized) else {"resident": MOMENT_FORM["resident"]}


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


def choose_path(specialized: Specialized) -> str:
    """Return the fastest path: resident wherever the plate fits on the chip."""
    return "streaming" if why_streaming(specialized) else "resident"


def describe_plan(specialized: Specialized) -> str:
    """Return how the fastest path distributes plates over the device."""
    if specialized.device.is_cpu:
        return f"all steps of a plate in one launch, on {specialized.threads} threads"
    if reason := why_streaming(specialized):
        return f"one or a few steps a launch, for {reason}"
    if specialized.effects.plain:
        plan = None if cuda.takes_lanes(specialized) else cuda.plan_of(specialized)
        return f"all steps in one launch, a plate on {LANES * plan.warps if plan else LANES} threads"
    block = moment_form.plan_of(specialized, few=False)
    place = "on the chip" if block.on_chip else "in device memory"
    return f"all steps in one launch, a plate on {block.threads} threads, its working fields {place}"


class CompiledScene:
    """The kernels of a specialized scene, compiled or loaded from Warp's cache."""

    def __init__(self, specialized: Specialized, path: str = "auto") -> None:
        scene, real = specialized.scene, specialized.real
        self.specialized = specialized
        self.path = choose_path(specialized) if path == "auto" else path
        paths = paths_of(specialized)
        if self.path not in paths:
            raise SceneError(f"path = {path!r}: no such path for this scene; there are: auto, {', '.join(paths)}")
        self._write_loads, self._sum_over_rows = make_write_loads(real), make_sum_over_rows(real)
        specialized.load(self._write_loads, self._sum_over_rows, sum_over_columns)
        if specialized.discretization.carriers:
            self._write_tones = make_write_tones(real, scene.drive.burst is not None)
            self._accumulate_waves = make_accumulate_waves(real)
            specialized.load(self._write_tones, self._accumulate_waves)
        if specialized.discretization.per_plate.centre:
            self._weigh_spans = make_weigh_spans(scene.grid.load == "moments")
            self._write_placed_loads = make_write_placed_loads(real)
            specialized.load(self._weigh_spans, self._write_placed_loads)
        self._positions = [self._doubles(axis) for axis in node_positions(scene)]
        self._share = self._doubles(specialized.share)
        self.advance = paths[self.path](specialized)

    def _doubles(self, values: np.ndarray) -> wp.array:
        return wp.array(values, dtype=wp.float64, device=self.specialized.device)

    def put_waves(self, state: State, values: PerPlateValues) -> np.ndarray:
        """Write the waves of a run, and return the (1 or plates, terms) powers of two by which they are divided.

        Tones are computed on the device; sweeps, and squares of voltages, on the host.
        """
        specialized = self.specialized
        if values.frequency is None:
            state.use_waves(per_plate=False)
            return specialized.sizes[None]
        state.use_waves(per_plate=True)
        drive = specialized.scene.drive
        put = self._put_tones if drive.chirp is None and drive.electrostatic is None else self._put_host_waves
        put(state, values.frequency, values.delay)
        terms, device = specialized.effects.terms, specialized.device
        if specialized.quantity == "velocity":
            return np.ones((1, terms))
        sizes = wp.zeros((len(values.frequency), terms), dtype=wp.float64, device=device)
        wp.launch(self._accumulate_waves, sizes.shape, inputs=[state.plate_waves], outputs=[sizes], device=device)
        return np.asarray(sizes.numpy())

    def _put_tones(self, state: State, frequency: np.ndarray, delay: np.ndarray | None) -> None:
        scheme, burst, envelope = self.specialized.scheme, self.specialized.scene.drive.burst, Envelope()
        if burst is not None:
            envelope.duration, envelope.ramp, envelope.period = burst.duration, burst.ramp, burst.period or 0.0
        delay = np.zeros_like(frequency) if delay is None else delay
        wp.launch(
            self._write_tones,
            dim=(len(frequency), scheme.steps, self.specialized.discretization.carriers),
            inputs=[self._doubles(frequency), self._doubles(delay), scheme.time_step, envelope],
            outputs=[state.plate_waves],
            device=self.specialized.device,
        )

    def _put_host_waves(self, state: State, frequency: np.ndarray, delay: np.ndarray | None) -> None:
        scene, scheme = self.specialized.scene, self.specialized.scheme
        block = max(1, HOST_NUMBERS // (scheme.steps * self.specialized.effects.terms))
        for first in range(0, len(frequency), block):
            some = slice(first, min(first + block, len(frequency)))
            delays = None if delay is None else delay[some]
            waves = waves_per_plate(scene, scheme.time_step, scheme.steps, frequency[some], delays)
            state.plate_waves[some].assign(waves.astype(scene.grid.precision))

    def load_drives(self, state: State, plates: int, edges: np.ndarray | None = None) -> None:
        """Copy the coefficients of the first plates to the device and write their load fields.

        ``edges`` (plates, actuators, 4): x0, x1, y0, y1 [m] of each plate's actuators (default: the scene's).
        """
        wp.copy(state.coefficients, state.host_coefficients, count=plates * state.coefficients[0].size)
        self.write_loads(state, plates, edges)

    def write_loads(self, state: State, plates: int, edges: np.ndarray | None = None) -> None:
        """Write the load fields of the first plates from ``state.coefficients``; ``edges`` as in ``load_drives``."""
        specialized = self.specialized
        kernel, inputs = self._write_loads, [specialized.support, specialized.patches]
        if edges is not None:
            self._weigh_patches(state, edges)
            kernel = self._write_placed_loads
            inputs = [specialized.support, self._share, state.along_x, state.along_y]
        wp.launch(
            kernel,
            dim=(plates, specialized.effects.terms, specialized.support.shape[0]),
            inputs=[state.coefficients, *inputs],
            outputs=[state.loads],
            device=specialized.device,
        )

    def _weigh_patches(self, state: State, edges: np.ndarray) -> None:
        """Compute the weights of patches with ``edges`` (plates, actuators, 4) [m] along both axes."""
        device, rectangles = self.specialized.device, self._doubles(edges)
        to_weights = wp.mat44d(*lagrange(4, 4).powers.ravel().tolist())
        for first, positions, along in zip((0, 2), self._positions, (state.along_x, state.along_y), strict=True):
            inputs = [rectangles, first, positions, to_weights]
            wp.launch(self._weigh_spans, edges.shape[:2], inputs=inputs, outputs=[along], device=device)

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

        The second run of a state with the same number of plates is recorded, and later ones repeat the recording.
        """
        key = (plates, state.has_plate_waves)
        if key in state.whole_runs:
            repeat(self.specialized.device, self._queue_whole, state, plates)
        else:
            state.whole_runs.add(key)
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
        energy = state.host_energy  # ``wait`` holds this array and not the state, which may be released

        def wait() -> np.ndarray:
            if done is not None:
                wp.synchronize_event(done)
            return np.asarray(energy.numpy()[:plates])

        return wait

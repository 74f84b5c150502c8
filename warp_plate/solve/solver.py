"""Runs any number of plates of one scene, each under its own drives."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from warp_plate.kernels import energy as energy_kernels
from warp_plate.kernels.load import make_spread_drives
from warp_plate.plate.weights import REGIONS
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.paths import choose_path, load, paths_of
from warp_plate.solve.specialize import Specialized, effect_names, specialize
from warp_plate.solve.state import State, bytes_per_plate, make_state

# One chunk of plates takes at most this many bytes on CPU, and this part of the free memory of a CUDA device.
CPU_CHUNK_BYTES = 256 * 2**20
CUDA_CHUNK_SHARE = 0.6
# A launch does about this much work, so that progress is shown and Ctrl-C is heard.
SEGMENT_NODE_STEPS = {"cpu": 2e8, "cuda": 5e10}

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Run:
    """What the plates did.

    energy: (plates, regions) kinetic energy averaged over the window [J]; NaN where a plate's numbers left the
    finite ones. regions: their names. displacement: (plates, times, ny, nx) [m]; times: (times,) [s], those of the
    grid that lie nearest to the ones asked for. trace: (plates, points, steps) [m]; trace_times: (steps,) [s].
    node_steps: nodes updated × steps × plates.
    """

    energy: np.ndarray
    regions: tuple[str, ...]
    displacement: np.ndarray
    times: np.ndarray
    trace: np.ndarray
    trace_times: np.ndarray
    node_steps: int

    @property
    def finite(self) -> np.ndarray:
        """(plates,) whether a plate's energies are numbers."""
        return np.isfinite(self.energy).all(axis=1)


class PlateSolver:
    """A scene compiled for a device.

    Args:
        scene: what to simulate.
        device: "cpu", "cuda", "cuda:1", ..., or "auto" for the first CUDA device, else the CPU.
        path: "auto", "resident" (all steps in one launch) or "streaming" (a launch a step).
        chunk: plates that run at once; left out: as many as memory holds.
        threads: of the CPU; left out: as many as it has.

    Raises:
        SceneError: unstable time step, an actuator that covers no node, no such device or path.
    """

    def __init__(
        self,
        scene: Scene,
        device: str = "auto",
        path: str = "auto",
        chunk: int | None = None,
        threads: int | None = None,
    ) -> None:
        started = time.perf_counter()
        self.scene = scene
        self.device = find_device(device)
        self._specialized = specialize(scene, self.device, threads)
        self.path = choose_path(self._specialized) if path == "auto" else path
        if self.path not in paths_of(self.device):
            raise SceneError(f"path = {path!r}: no such path; there are: auto, {', '.join(paths_of(self.device))}")
        self._advance = paths_of(self.device)[self.path](self._specialized)
        self._spread_drives = make_spread_drives(self._specialized.real)
        self._sum_along_rows = energy_kernels.make_sum_along_rows(self._specialized.real)
        self._sum_rows = energy_kernels.make_sum_rows()
        for kernel in (self._spread_drives, self._sum_along_rows, self._sum_rows):
            load(kernel, self.device)
        self._chunk = chunk
        self._state: State | None = None
        self.node_steps = 0  # of all runs so far
        self.compile_seconds = time.perf_counter() - started

    @property
    def specialized(self) -> Specialized:
        """Compile key, scheme and device arrays."""
        return self._specialized

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects in the compiled kernel."""
        return effect_names(self.scene)

    @property
    def node_steps_per_plate(self) -> int:
        """Nodes updated × steps."""
        return self._specialized.interior_nodes * self._specialized.scheme.steps

    def run(
        self,
        drives: np.ndarray | Sequence[Sequence[complex]] | tuple[np.ndarray, np.ndarray],
        times: Sequence[float] = (),
        points: Sequence[tuple[float, float]] = (),
        progress: Progress | None = None,
    ) -> Run:
        """Simulate one plate a drive from rest to the end of the window.

        Args:
            drives: (plates, actuators) complex phasors Z [N/m²], the load being Re(Z exp(iωt)) on each patch; or a
                tuple (magnitude, phase) of such arrays, Z = magnitude · exp(−i phase).
            times: at which to keep the displacement [s].
            points: (x, y) [m] at which to keep the displacement of every step (bilinear between nodes).
            progress: called with (node-steps done, node-steps in all) between launches.

        Raises:
            SceneError: drives of another shape.
        """
        phasors = as_phasors(drives, len(self.scene.actuators))
        specialized, scheme = self._specialized, self._specialized.scheme
        plates, (nx, ny) = len(phasors), scheme.nodes
        if points and self.device.is_cuda and self.path == "resident":
            # A plate that stays in registers shows nothing between launches: traces are streamed.
            streaming = PlateSolver(self.scene, self.device.alias, "streaming", self._chunk)
            self.compile_seconds += streaming.compile_seconds
            traced = streaming.run(drives, times, points, progress)
            self.node_steps += traced.node_steps
            return traced
        snapshots = [scheme.step_of(t) for t in times]
        corners, shares = _bilinear(points, scheme.nodes, self.scene.plate.size)
        nodes = wp.array(corners.reshape(-1, 2) + np.array([1, 0], np.int32), dtype=int, device=self.device)
        energy = np.empty((plates, len(REGIONS)))
        displacement = np.empty((plates, len(snapshots), ny, nx))
        trace = np.empty((plates, len(points), scheme.steps))
        chunk = self._plates_at_once(plates, nodes.shape[0])
        total = plates * self.node_steps_per_plate
        for first in range(0, plates, chunk):
            some = slice(first, min(first + chunk, plates))
            scale = self._start(phasors[some], chunk, nodes)
            done = first * self.node_steps_per_plate
            self._march(len(scale), snapshots, displacement[some], lambda n, at=done: progress and progress(at + n, total))
            energy[some] = self._energy(len(scale)) * scale[:, None] ** 2
            displacement[some] *= scale[:, None, None, None] * scheme.load_scale
            trace[some] = self._trace(len(scale), shares) * scale[:, None, None] * scheme.load_scale
        self.node_steps += total
        return Run(
            energy=energy,
            regions=REGIONS,
            displacement=displacement,
            times=np.array(snapshots) * scheme.time_step,
            trace=trace,
            trace_times=scheme.time_step * np.arange(1, scheme.steps + 1) if points else np.empty(0),
            node_steps=total,
        )

    def _plates_at_once(self, plates: int, traced_nodes: int) -> int:
        if self._chunk is not None:
            return min(self._chunk, plates)
        budget = CUDA_CHUNK_SHARE * self.device.free_memory if self.device.is_cuda else CPU_CHUNK_BYTES
        if self._state is not None and self.device.is_cuda:
            budget += self._state.capacity * bytes_per_plate(self._specialized, self._state.nodes.shape[0])
        return max(1, min(plates, int(budget / bytes_per_plate(self._specialized, traced_nodes))))

    def _start(self, phasors: np.ndarray, capacity: int, nodes: wp.array) -> np.ndarray:
        """Put plates at rest under their loads; returns (plates,) the drive [N/m²] that each is scaled by."""
        state = self._state
        if state is None or state.capacity < capacity or nodes.shape[0] or state.nodes.shape[0]:
            self._state = None  # frees the old room before the new one is taken
            state = self._state = make_state(self._specialized, capacity, nodes)
        scale = np.abs(phasors).max(axis=1)
        scaled = phasors / np.where(scale > 0, scale, 1)[:, None]
        drives = np.zeros(state.drives.shape)
        drives[: len(phasors)] = np.stack([scaled.real, -scaled.imag], axis=1)
        state.drives.assign(drives.astype(self.scene.grid.precision))
        state.clear()
        wp.launch(
            self._spread_drives,
            dim=(len(phasors), self._specialized.support.shape[0]),
            inputs=[state.drives, self._specialized.support, self._specialized.patches],
            outputs=[state.in_phase, state.quadrature],
            device=self.device,
        )
        return scale

    def _march(
        self, plates: int, snapshots: list[int], displacement: np.ndarray, tell: Callable[[int], object]
    ) -> None:
        """All steps of the plates in the state, stopping where a displacement is kept or progress is due."""
        state, scheme = self._state, self._specialized.scheme
        assert state is not None
        node_steps = plates * self._specialized.interior_nodes
        segment = max(1, int(SEGMENT_NODE_STEPS["cuda" if self.device.is_cuda else "cpu"] / node_steps))
        stops = sorted({*range(segment, scheme.steps, segment), *snapshots, scheme.steps})
        step = 0
        for stop in stops:
            if stop > step:
                self._advance(state, plates, step, stop)
                step = stop
            if stop in snapshots:
                nx, ny = scheme.nodes
                field = state.u.numpy()[:plates, 1 : ny + 1, :nx]
                for index in [i for i, snapshot in enumerate(snapshots) if snapshot == stop]:
                    displacement[:, index] = field
            if stop < scheme.steps:
                wp.synchronize_device(self.device)
                tell(step * node_steps)
        wp.synchronize_device(self.device)
        tell(step * node_steps)

    def _energy(self, plates: int) -> np.ndarray:
        """(plates, regions) kinetic energy [J] for drives scaled to 1 N/m²."""
        state, weights = self._state, self._specialized.weights
        assert state is not None
        regions, rows, _ = weights.shape
        wp.launch(
            self._sum_along_rows,
            dim=(plates, regions, rows),
            inputs=[state.squares, weights],
            outputs=[state.row_sums],
            device=self.device,
        )
        wp.launch(
            self._sum_rows, dim=(plates, regions), inputs=[state.row_sums], outputs=[state.energy], device=self.device
        )
        return state.energy.numpy()[:plates] * kinetic_energy_unit(self._specialized)

    def _trace(self, plates: int, shares: np.ndarray) -> np.ndarray:
        state = self._state
        assert state is not None
        if not len(shares):
            return np.empty((plates, 0, self._specialized.scheme.steps))
        corners = state.trace.numpy()[:plates].reshape(plates, len(shares), 4, -1)
        return np.einsum("mpcn,pc->mpn", corners.astype(float), shares)


def kinetic_energy_unit(specialized: Specialized) -> float:
    """½ρH·hx·hy·(load_scale/Δt)²/steps [J]: turns the kernels' weighted sums of rate² into mean energy."""
    scheme = specialized.scheme
    (hx, hy), (first, last) = scheme.spacing, scheme.window
    speed = scheme.load_scale / scheme.time_step
    return 0.5 * scheme.surface_density * hx * hy * speed**2 / (last - first)


def as_phasors(drives: object, actuators: int) -> np.ndarray:
    """(plates, actuators) complex phasors from phasors or (magnitude, phase).

    Raises:
        SceneError: another shape, or not numbers.
    """
    try:
        if isinstance(drives, tuple) and len(drives) == 2:
            magnitude, phase = (np.asarray(part, dtype=float) for part in drives)
            phasors = magnitude * np.exp(-1j * phase)
        else:
            phasors = np.asarray(drives, dtype=complex)
    except (TypeError, ValueError) as error:
        raise SceneError(f"drives: not an array of numbers ({error})") from None
    if phasors.ndim != 2 or phasors.shape[1] != actuators:
        raise SceneError(f"drives: shape {phasors.shape} instead of (plates, {actuators}), one column an actuator")
    return phasors


def find_device(name: str) -> wp.Device:
    """The Warp device of a name; "auto" is the first CUDA device, else the CPU.

    Raises:
        SceneError: Warp knows no such device here.
    """
    wp.config.log_level = max(wp.config.log_level, wp.LOG_ERROR)  # Warp greets on standard output otherwise
    with _quiet_standard_error():
        wp.init()
    try:
        return wp.get_device(("cuda:0" if wp.is_cuda_available() else "cpu") if name == "auto" else name)
    except (ValueError, RuntimeError):
        known = ", ".join(["auto", *(device.alias for device in wp.get_devices())])
        raise SceneError(f"device = {name!r}: not on this machine; there are: {known}") from None


@contextlib.contextmanager
def _quiet_standard_error() -> Iterator[None]:
    """Drop what Warp's C++ side says where there is no CUDA driver: on most machines that is no fault."""
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def _bilinear(
    points: Sequence[tuple[float, float]], nodes: tuple[int, int], size: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """(points, 4, 2) row and column of the nodes around each point, (points, 4) their shares."""
    where = np.asarray(points, dtype=float).reshape(-1, 2) / size * (np.array(nodes) - 1)
    low = np.clip(np.floor(where).astype(int), 0, np.array(nodes) - 2)
    part = where - low
    steps = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])  # (row, column)
    corners = low[:, None, ::-1] + steps
    across = np.where(steps[:, 1] == 1, part[:, None, 0], 1 - part[:, None, 0])
    along = np.where(steps[:, 0] == 1, part[:, None, 1], 1 - part[:, None, 1])
    return corners.astype(np.int32), across * along

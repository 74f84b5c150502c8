"""Runs any number of plates of one scene, each under its own drives."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from warp_plate.plate.designs import NOTHING_OWN, Designs, Own, OwnValues, check_designs
from warp_plate.plate.weights import NO_AREAS, Region, bilinear
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import find_device
from warp_plate.solve.engine import load_drives, make_engine, region_sums
from warp_plate.solve.paths import why_streaming
from warp_plate.solve.scaling import scaled_coefficients
from warp_plate.solve.specialize import Quantity, Specialized, effect_names, specialize
from warp_plate.solve.state import State, bytes_per_plate, make_state
from warp_plate.solve.status import fastest_per_step, judge_plates, outgrown, watched_steps

# A launch does about this much work, so that progress is shown and Ctrl-C is heard.
SEGMENT_NODE_STEPS = {"cpu": 1e9, "cuda": 5e10}
# One chunk of plates takes at most this part of the free memory of a CUDA device. On CPU it takes this many bytes, and
# no more plates than one launch can take to the end of the run: a launch copies plates into the cache and out again.
CUDA_CHUNK_SHARE = 0.6
CPU_CHUNK_BYTES = 256 * 2**20
FEWEST_PLATES = 64

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Run:
    """What the plates did.

    energy: (plates, regions) kinetic energy ½∫ρH v² averaged over the window [J]; of a solver of displacements the same
    with u in place of v [kg·m²], u being that at the end of each of the window's steps. NaN for a plate whose status is
    not "ok", such as one whose drive is of a size beyond SMALLEST_DRIVE ... LARGEST_DRIVE. regions: their names;
    masses: (regions,) [kg]. displacement:
    (plates, times, ny, nx) [m]; times: (times,) [s], those of the grid that lie nearest to the ones asked for. trace:
    (plates, points, steps) [m]; trace_times: (steps,) [s]. node_steps: nodes updated × steps × plates. status:
    (plates,) "ok" or what went wrong, see ``solve.status``; caught: (plates,) time at which a plate was seen to grow
    without bound [s], NaN where it was not.
    """

    energy: np.ndarray
    regions: tuple[str, ...]
    masses: np.ndarray
    displacement: np.ndarray
    times: np.ndarray
    trace: np.ndarray
    trace_times: np.ndarray
    node_steps: int
    status: np.ndarray
    caught: np.ndarray

    @property
    def finite(self) -> np.ndarray:
        """(plates,) whether a plate's energies are numbers."""
        return np.isfinite(self.energy).all(axis=1)

    @property
    def mean_square(self) -> np.ndarray:
        """(plates, regions) velocity² [m²/s²], or displacement² [m²]: mean over the window and the region's mass."""
        return 2 * self.energy / self.masses

    def fault(self, plate: int) -> str:
        """What went wrong with a plate, for people; "ok" where nothing did."""
        when = f" by t = {self.caught[plate]:.4g} s" if math.isfinite(self.caught[plate]) else ""
        return f"{self.status[plate]}{when}"


class PlateSolver:
    """A scene compiled for a device.

    Args:
        scene: what to simulate.
        device: "cpu", "cuda", "cuda:1", ..., or "auto" for the first CUDA device, else the CPU.
        path: "auto", "resident" (all steps in one launch) or "streaming" (a launch a step).
        chunk: plates that run at once, at least 1; left out: as many as memory holds.
        threads: of the CPU; left out: as many as it has.
        allow_unstable: whether to take a time step above the stability limit too.
        areas: by name, further regions whose energy runs give beside the plate's and the target's: rectangles x0, x1,
            y0, y1 [m], shapes, or weights (ny, nx) in cells.
        own: what plates may have of their own beside drives, see ``plate.designs``. The time step is the scene's: it
            must carry their frequencies.
        quantity: "velocity" or "displacement", of which energies are, see :class:`Run`.
        share: the part of the memory for plates that this solver may take, where several have plates at a time.

    Raises:
        SceneError: unstable time step, an actuator that covers no node, no such device or path; a scene that cannot
            have what ``own`` asks for (a frequency or a delay where a file is the carrier, a delay without
            drive.burst, places where grid.load = "nodes"), or displacements of a scene that is not linear.
    """

    def __init__(
        self,
        scene: Scene,
        device: str = "auto",
        path: str = "auto",
        chunk: int | None = None,
        threads: int | None = None,
        allow_unstable: bool = False,
        areas: Mapping[str, Region] = NO_AREAS,
        own: Own = NOTHING_OWN,
        quantity: Quantity = "velocity",
        share: float = 1.0,
    ) -> None:
        started = time.perf_counter()
        if chunk is not None and chunk < 1:
            raise SceneError(f"chunk = {chunk}: must be at least 1 plate")
        self.scene = scene
        self.device = find_device(device)
        specialized = specialize(scene, self.device, threads, allow_unstable, areas, own, quantity)
        self.engine = make_engine(specialized, path)
        self.path = self.engine.path
        self._chunk = chunk
        self._areas = areas
        self._share = share
        self._state: State | None = None
        self.node_steps = 0  # of all runs so far
        self.compile_seconds = time.perf_counter() - started

    @property
    def specialized(self) -> Specialized:
        """Compile key, scheme and device arrays."""
        return self.engine.specialized

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects in the compiled kernel."""
        return effect_names(self.scene, several_waves=self.specialized.carriers > 1)

    def path_words(self, traced: bool = False) -> str:
        """How plates are stepped, for people: the path, and why it streams where it could not do better."""
        reason = why_streaming(self.specialized, traced)
        return f"streaming ({reason})" if reason else self.path

    @property
    def node_steps_per_plate(self) -> int:
        """Nodes updated × steps."""
        return self.specialized.interior_nodes * self.specialized.scheme.steps

    def run(
        self,
        drives: np.ndarray | Sequence[Sequence[complex]] | tuple[np.ndarray, np.ndarray] | Designs,
        times: Sequence[float] = (),
        points: Sequence[tuple[float, float]] = (),
        progress: Progress | None = None,
    ) -> Run:
        """Simulate one plate a drive from rest to the end of the window.

        Args:
            drives: (plates, actuators) complex phasors Z [N/m²], the load being Re(Z exp(iωt)) on each patch, or what
                the scene's drive makes of Z (see ``plate.signals``); or a tuple (magnitude, phase) of such arrays, Z =
                magnitude · exp(−i phase); or Designs, of which every plate may have frequencies, places and delays of
                its own.
            times: at which to keep the displacement [s].
            points: (x, y) [m] at which to keep the displacement of every step (bilinear between nodes).
            progress: called with (node-steps done, node-steps in all) between launches.

        Raises:
            SceneError: drives of another shape or kind, a time outside the run, a point off the plate; designs that
                this solver was not made for, or that ``plate.designs.check_designs`` refuses; times or points of a
                solver of displacements, whose plates move by running sums.
        """
        designs = drives if isinstance(drives, Designs) else Designs(as_phasors(drives, len(self.scene.actuators)))
        phasors = as_phasors(designs.drives, len(self.scene.actuators))
        scheme = self.specialized.scheme
        self._check(times, points)
        values = check_designs(designs, self.scene, self.specialized.own, scheme.time_step)
        plates, (nx, ny) = len(phasors), scheme.nodes
        if points and self.device.is_cuda and self.path == "resident":
            # A plate that stays in registers shows nothing between launches: traces are streamed.
            streaming = PlateSolver(
                self.scene, self.device.alias, "streaming", self._chunk, allow_unstable=True, areas=self._areas,
                own=self.specialized.own,
            )
            self.compile_seconds += streaming.compile_seconds
            traced = streaming.run(drives, times, points, progress)
            self.node_steps += traced.node_steps
            return traced
        snapshots = [scheme.step_of(t) for t in times]
        corners, shares = bilinear(points, scheme.nodes, self.scene.plate.size)
        nodes: wp.array = wp.array(corners.reshape(-1, 2) + np.array([1, 0], np.int32), dtype=int, device=self.device)
        energy = np.empty((plates, len(self.specialized.regions)))
        displacement = np.full((plates, len(snapshots), ny, nx), np.nan)
        trace = np.empty((plates, len(points), scheme.steps))
        status, caught = np.empty(plates, dtype=object), np.full(plates, np.nan)
        fastest = scheme.steps * fastest_per_step(self.specialized)
        chunk = self._plates_at_once(max(plates, 1), nodes.shape[0])
        total = plates * self.node_steps_per_plate
        for first in range(0, plates, chunk):
            some = slice(first, min(first + chunk, plates))
            state, scale = self._start(phasors[some], values[some], chunk, nodes)
            count, before = len(scale), first * self.node_steps_per_plate

            def tell(done: int, before: int = before) -> None:
                if progress is not None:
                    progress(before + done, total)

            reached, seen = self._march(state, count, snapshots, displacement[some], tell)
            caught[some][seen >= 0] = seen[seen >= 0] * scheme.time_step
            sums = region_sums(self.engine, state, count)
            most = (scheme.window[1] - scheme.window[0]) * fastest**2
            judge_plates(
                phasors[some], scale, seen, sums, energy_unit(self.specialized), most, energy[some], status[some]
            )
            unit = scale * scheme.load_scale
            with np.errstate(invalid="ignore", over="ignore"):  # of plates that left the finite numbers
                displacement[some] *= unit[:, None, None, None]
                if points:
                    corner_traces = state.trace.numpy()[:count].reshape(count, len(points), 4, -1).astype(float)
                    trace[some] = np.einsum("mpcn,pc->mpn", corner_traces, shares) * unit[:, None, None]
                    trace[some, :, reached:] = np.nan
        self.node_steps += total
        return Run(
            energy=energy,
            regions=self.specialized.regions,
            masses=self.specialized.masses,
            displacement=displacement,
            times=np.array(snapshots) * scheme.time_step,
            trace=trace,
            trace_times=scheme.time_step * np.arange(1, scheme.steps + 1) if points else np.empty(0),
            node_steps=total,
            status=status,
            caught=caught,
        )

    def _check(self, times: Sequence[float], points: Sequence[tuple[float, float]]) -> None:
        end = self.specialized.scheme.steps * self.specialized.scheme.time_step
        for name, values, each in (("times", times, ()), ("points", points, (2,))):
            try:
                shape = _numbers(values, "biuf").shape
            except (TypeError, ValueError):
                shape = ()
            if shape != (0,) and (not shape or shape[1:] != each):
                raise SceneError(f"{name}: must be a list of {'numbers' if each == () else 'pairs of numbers'}")
        if self.specialized.quantity == "displacement" and len(times) + len(points):
            raise SceneError('times, points: a solver with quantity = "displacement" keeps none; make another')
        for time_asked in times:
            if not 0 <= time_asked <= self.scene.window.end * (1 + 1e-9):
                raise SceneError(f"times: {time_asked:g} s is outside the run, which goes from 0 to {end:g} s")
        width, height = self.scene.plate.size
        for x, y in points:
            if not (0 <= x <= width and 0 <= y <= height):
                raise SceneError(f"points: {[x, y]} is off the plate of {[width, height]} m")

    def _plates_at_once(self, plates: int, traced_nodes: int) -> int:
        if self._chunk is not None:
            return min(self._chunk, plates)
        budget = self._share * (
            CUDA_CHUNK_SHARE * self.device.free_memory if self.device.is_cuda else CPU_CHUNK_BYTES
        )
        if self._state is not None and self.device.is_cuda:
            budget += self._state.capacity * bytes_per_plate(self.specialized, self._state.nodes.shape[0])
        each = bytes_per_plate(self.specialized, traced_nodes)
        if self.device.is_cuda and each > budget:
            raise SceneError(
                f"grid.nodes = {list(self.scene.grid.nodes)}: a plate takes {each / 2**30:.3g} GiB, and "
                f"{budget / 2**30:.3g} GiB of {self.device.alias} may be taken; use fewer nodes or record.points"
            )
        most = int(budget / each)
        if self.device.is_cpu:
            most = min(most, max(FEWEST_PLATES, int(SEGMENT_NODE_STEPS["cpu"] / self.node_steps_per_plate)))
        return max(1, min(plates, most))

    def _start(
        self, phasors: np.ndarray, values: OwnValues, capacity: int, nodes: wp.array
    ) -> tuple[State, np.ndarray]:
        """Plates at rest under their loads, and (plates,) the pressure [N/m²] that each is scaled by."""
        state = self._state
        if state is None or state.capacity < capacity or nodes.shape[0] or state.nodes.shape[0]:
            self._state = None  # frees the old room before the new one is taken
            state = self._state = make_state(self.specialized, capacity, nodes)
        specialized, precision = self.specialized, self.scene.grid.precision
        travelling = specialized.moving.largest if specialized.moving else 0.0
        sizes = self.engine.own.put_waves(state, values)
        room = np.zeros(state.coefficients.shape, precision)
        scale = scaled_coefficients(specialized.signals, phasors, sizes, travelling, room)
        load_drives(self.engine, state, room, len(scale), values.edges)
        units = np.zeros(state.capacity)
        units[: len(scale)] = scale * specialized.scheme.load_scale
        with np.errstate(over="ignore", invalid="ignore"):
            state.units.assign(units.astype(precision))
        if specialized.moving:
            moving = np.zeros(state.capacity)
            moving[: len(scale)] = travelling / np.where(scale == 0, 1, scale)
            state.moving.assign(moving.astype(precision))
        state.clear()
        return state, scale

    def _march(
        self, state: State, plates: int, snapshots: list[int], displacement: np.ndarray, tell: Callable[[int], None]
    ) -> tuple[int, np.ndarray]:
        """All steps of the plates in the state, stopping where a displacement is kept or progress is due.

        Returns the steps taken, which are fewer where no plate is left that does not grow without bound, and (plates,)
        the step at which a plate was seen to grow, or −1.
        """
        scheme = self.specialized.scheme
        nx, ny = scheme.nodes
        node_steps = plates * self.specialized.interior_nodes
        segment = max(1, int(SEGMENT_NODE_STEPS["cuda" if self.device.is_cuda else "cpu"] / node_steps))
        watched = watched_steps(self.specialized, plates)
        segment = min(segment, watched or segment)
        fastest, seen = fastest_per_step(self.specialized), np.full(plates, -1)
        step = 0
        for stop in sorted({*range(0, scheme.steps, segment), *snapshots, scheme.steps}):
            if stop > step:
                self.engine.advance(state, plates, step, stop)
                step = stop
                if watched:
                    seen[(seen < 0) & outgrown(state.rate.numpy()[:plates], step * fastest)] = step
            if stop in snapshots:
                kept = [index for index, snapshot in enumerate(snapshots) if snapshot == stop]
                displacement[:, kept] = state.u[:plates].numpy()[:, None, 1 : ny + 1, :nx]
            wp.synchronize_device(self.device)
            tell(step * node_steps)
            if (seen >= 0).all():
                break
        return step, seen


def energy_unit(specialized: Specialized) -> float:
    """½ρH·hx·hy·(load_scale/Δt)²/steps [J], of displacements without Δt [kg·m²]: turns weighted sums of rate² into
    energy averaged over the window."""
    scheme = specialized.scheme
    (hx, hy), (first, last) = scheme.spacing, scheme.window
    speed = scheme.load_scale / (scheme.time_step if specialized.quantity == "velocity" else 1.0)
    return 0.5 * scheme.surface_density * hx * hy * speed**2 / (last - first)


def as_phasors(drives: object, actuators: int) -> np.ndarray:
    """(plates, actuators) complex phasors from phasors or (magnitude, phase).

    Raises:
        SceneError: another shape, or not numbers.
    """
    try:
        if isinstance(drives, tuple) and len(drives) == 2:
            magnitude, phase = (_numbers(part, "biuf") for part in drives)
            with np.errstate(invalid="ignore"):  # a drive that is not finite harms its own plate alone
                phasors = magnitude * np.exp(-1j * phase)
        else:
            phasors = _numbers(drives, "biufc").astype(complex, copy=False)
    except (TypeError, ValueError) as error:
        raise SceneError(f"drives: not an array of numbers ({error})") from None
    if phasors.ndim != 2 or phasors.shape[1] != actuators:
        raise SceneError(f"drives: shape {phasors.shape} instead of (plates, {actuators}), one column an actuator")
    return phasors


def _numbers(values: object, kinds: str) -> np.ndarray:
    """As an array, of one of NumPy's kinds: nothing is read out of texts or dates, and nothing masked is taken."""
    array = np.asarray(values)
    if array.size and (array.dtype.kind not in kinds or np.ma.is_masked(values)):
        raise TypeError(f"{array.dtype}{', masked' if np.ma.is_masked(values) else ''}")
    return array

"""Runs any number of plates of one scene, each under its own drives."""

from __future__ import annotations

import itertools
import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial

import numpy as np
import warp as wp

from warp_plate.interrupts import check_interrupt
from warp_plate.plate.designs import (
    NO_PER_PLATE,
    Batch,
    Designs,
    PerPlate,
    PerPlateValues,
    as_numbers,
    as_phasors,
    check_designs,
)
from warp_plate.plate.discretization import Discretization, discretize
from warp_plate.plate.weights import NO_AREAS, Region, bilinear
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.batching import TURNS, first_part, part_sizes
from warp_plate.solve.devices import find_device
from warp_plate.solve.engine import load_drives, make_engine, queue_region_sums
from warp_plate.solve.paths import why_streaming
from warp_plate.solve.run import Run
from warp_plate.solve.scaling import energy_unit, scaled_coefficients
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
Each = Callable[[slice, np.ndarray], object]
End = Callable[[], None]


class PlateSolver:
    """A scene compiled for a device.

    Args:
        scene: what to simulate; or its discretization, whose per_plate and allow_unstable then hold.
        device: "cpu", "cuda", "cuda:1", ..., or "auto" for the first CUDA device, else the CPU.
        path: "auto", "resident" (all steps in one launch) or "streaming" (many launches).
        chunk: plates that run at once, at least 1; left out: as many as memory holds.
        threads: of the CPU; left out: as many as it has.
        allow_unstable: whether to take a time step above the stability limit too.
        areas: by name, further regions whose energy runs give beside the plate's and the target's: rectangles x0, x1,
            y0, y1 [m], shapes, or weights (ny, nx) in cells.
        per_plate: what may differ between plates beside drives, see ``plate.designs``. The scene's time step
            must carry their frequencies.
        quantity: "velocity" or "displacement", of which energies are, see :class:`Run`.
        share: the part of the memory for plates that this solver may take, where several have plates at a time.

    Raises:
        SceneError: unstable time step, an actuator that covers no node, no such device or path; a scene that cannot
            have what ``per_plate`` asks for (a frequency or a delay where a file is the carrier, a delay without
            drive.burst, places where grid.load = "nodes"), or displacements of a scene that is not linear.
    """

    def __init__(
        self,
        scene: Scene | Discretization,
        device: str = "auto",
        path: str = "auto",
        chunk: int | None = None,
        threads: int | None = None,
        allow_unstable: bool = False,
        areas: Mapping[str, Region] = NO_AREAS,
        per_plate: PerPlate = NO_PER_PLATE,
        quantity: Quantity = "velocity",
        share: float = 1.0,
    ) -> None:
        started = time.perf_counter()
        if chunk is not None and chunk < 1:
            raise SceneError(f"chunk = {chunk}: must be at least 1 plate")
        self.device = find_device(device)
        if isinstance(scene, Scene):
            scene = discretize(scene, per_plate, allow_unstable)
        self.scene = scene.scene
        specialized = specialize(scene, self.device, threads, areas, quantity)
        self.engine = make_engine(specialized, path)
        self.path = self.engine.path
        self._chunk = chunk
        self._areas = areas
        self._share = share
        self._states: list[State] = []  # which take turns
        self._ends: deque[tuple[State, End]] = deque()  # of parts that the device may be at, the oldest first
        self._untraced: wp.array = wp.empty((0, 2), dtype=int, device=self.device)
        self._fastest = fastest_per_step(specialized)
        self.node_steps = 0  # of all runs so far
        self.compile_seconds = time.perf_counter() - started

    @property
    def specialized(self) -> Specialized:
        """Compile key, scheme and device arrays."""
        return self.engine.specialized

    @property
    def discretization(self) -> Discretization:
        """The scene on its grid, for further solvers and whoever needs its scheme, loads or regions."""
        return self.engine.specialized.discretization

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
        drives: np.ndarray | Sequence[Sequence[complex]] | tuple[np.ndarray, np.ndarray] | Batch,
        times: Sequence[float] = (),
        points: Sequence[tuple[float, float]] = (),
        progress: Progress | None = None,
        each: Each | None = None,
    ) -> Run:
        """Simulate one plate a drive from rest to the end of the window.

        Args:
            drives: (plates, actuators) complex phasors Z [N/m²], the load being Re(Z exp(iωt)) on each patch, or what
                the scene's drive makes of Z (see ``plate.signals``); or a tuple (magnitude, phase) of such arrays, Z =
                magnitude · exp(−i phase); or Designs, of which every plate may have frequencies, places and delays of
                its own; or what gives them part by part.
            times: at which to keep the displacement [s].
            points: (x, y) [m] at which to keep the displacement of every step (bilinear between nodes).
            progress: called with (node-steps done, node-steps in all) between launches.
            each: called with (which plates, their energies) for some after the other, as soon as they are known.

        Raises:
            SceneError: drives of another shape or kind, a time outside the run, a point off the plate; designs that
                this solver was not made for, or that ``plate.designs.check_designs`` refuses; times or points of a
                solver of displacements, whose plates move by running sums.
        """
        with self._dropping() as ends:
            return self._begin(drives, times, points, progress, each, ends=ends)()

    def begin(self, drives: np.ndarray | Batch) -> Callable[[], Run]:
        """What gives ``run(drives)``; a CUDA device begins with it now, and goes on to the next one begun."""
        if not self._overlaps:
            return partial(self.run, drives)
        with self._dropping() as ends:
            return self._begin(drives, ahead=True, ends=ends)

    @contextmanager
    def _dropping(self) -> Iterator[list[End]]:
        """For the ends of a run: where it is cut short, nobody waits for them."""
        ends: list[End] = []
        try:
            yield ends
        except BaseException:
            self._ends = deque(one for one in self._ends if one[1] not in ends)
            raise

    def _begin(
        self,
        drives: np.ndarray | Sequence[Sequence[complex]] | tuple[np.ndarray, np.ndarray] | Batch,
        times: Sequence[float] = (),
        points: Sequence[tuple[float, float]] = (),
        progress: Progress | None = None,
        each: Each | None = None,
        ahead: bool = False,
        *,
        ends: list[End],
    ) -> Callable[[], Run]:
        batch = drives if isinstance(drives, Batch) else Designs(as_phasors(drives, len(self.scene.actuators)))
        scheme, (nx, ny) = self.specialized.scheme, self.specialized.scheme.nodes
        self._check(times, points)
        whole = self._checked(batch) if isinstance(batch, Designs) else None
        plates = len(batch)
        if points and self.device.is_cuda and self.path == "resident":
            # A plate that stays in registers shows nothing between launches: traces are streamed.
            streaming = PlateSolver(
                self.discretization, self.device.alias, "streaming", self._chunk, areas=self._areas
            )
            self.compile_seconds += streaming.compile_seconds
            traced = streaming.run(drives, times, points, progress, each)
            self.node_steps += traced.node_steps
            return lambda: traced
        snapshots = [scheme.step_of(t) for t in times]
        nodes = self._untraced
        if points:
            corners, shares = bilinear(points, scheme.nodes, self.scene.plate.size)
            nodes = wp.array(corners.reshape(-1, 2) + np.array([1, 0], np.int32), dtype=int, device=self.device)
        energy = np.empty((plates, len(self.specialized.regions)))
        displacement = np.full((plates, len(snapshots), ny, nx), np.nan)
        trace = np.empty((plates, len(points), scheme.steps))
        faults: dict[int, tuple[str, float]] = {}
        fastest = scheme.steps * self._fastest
        parts, count = self._parts(plates, nodes.shape[0], ahead)
        states, several = self._rooms(parts, nodes, count), count > 1
        total = plates * self.node_steps_per_plate
        most, joules = (scheme.window[1] - scheme.window[0]) * fastest**2, energy_unit(self.specialized)

        def end(
            some: slice, phasors: np.ndarray, scale: np.ndarray, seen: np.ndarray, sums: Callable[[], np.ndarray]
        ) -> None:
            words = judge_plates(phasors, scale, seen, sums(), joules, most, energy[some])
            for plate, word in words.items():
                caught = seen[plate] * scheme.time_step if seen[plate] >= 0 else math.nan
                faults[some.start + plate] = word, caught
            if each is not None:
                each(some, energy[some])
            if progress is not None and several:
                progress(some.stop * self.node_steps_per_plate, total)

        for some in parts:
            phasors, values = (whole[0][some], whole[1][some]) if whole else self._checked(batch[some])
            self._wait(len(states) - 1)
            state = next(one for one in states if all(one is not used for used, _ in self._ends))
            scale, before = self._start(state, phasors, values), some.start * self.node_steps_per_plate

            def tell(done: int, before: int = before) -> None:
                if progress is not None:
                    progress(before + done, total)

            reached, seen = self._march(state, len(scale), snapshots, displacement[some], tell, several)
            sums = queue_region_sums(self.engine, state, len(scale))
            ends.append(partial(end, some, phasors, scale, seen, sums))
            self._ends.append((state, ends[-1]))
            unit = scale * scheme.load_scale
            with np.errstate(invalid="ignore", over="ignore"):  # of plates that left the finite numbers
                displacement[some] *= unit[:, None, None, None]
                if points:
                    corner_traces = state.trace.numpy()[: len(scale)].reshape(len(scale), len(points), 4, -1)
                    trace[some] = np.einsum("mpcn,pc->mpn", corner_traces.astype(float), shares) * unit[:, None, None]
                    trace[some, :, reached:] = np.nan

        def finish() -> Run:
            while ends and any(one is ends[-1] for _, one in self._ends):
                self._wait(len(self._ends) - 1)
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
                faults=faults,
            )

        return finish

    def _wait(self, most: int) -> None:
        """Until the device is at no more than so many parts."""
        while len(self._ends) > most:
            self._ends[0][1]()
            self._ends.popleft()

    def _check(self, times: Sequence[float], points: Sequence[tuple[float, float]]) -> None:
        end = self.specialized.scheme.steps * self.specialized.scheme.time_step
        for name, values, each in (("times", times, ()), ("points", points, (2,))):
            try:
                shape = as_numbers(values, "biuf").shape
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

    def _checked(self, designs: Designs) -> tuple[np.ndarray, PerPlateValues]:
        phasors = as_phasors(designs.drives, len(self.scene.actuators))
        return phasors, check_designs(
            designs, self.scene, self.specialized.per_plate, self.specialized.scheme.time_step
        )

    @property
    def _overlaps(self) -> bool:
        """Whether the host may work on one part while the device steps another."""
        return self.device.is_cuda and self._chunk is None

    def _parts(self, plates: int, traced_nodes: int, ahead: bool) -> tuple[list[slice], int]:
        """What is run at once, one part after the other, and how many states take turns at that."""
        first = first_part(self.node_steps_per_plate)
        cut = self._overlaps and not traced_nodes and not self._ends and plates >= 4 * first
        sizes, count = part_sizes(plates, first) if cut else [plates], TURNS if cut or ahead else 1
        wanted = count * max(1, *sizes)
        most = self._plates_at_once(wanted, traced_nodes)
        if most < count:
            count = 1  # a plate takes so much room that there is none for a second one
        whole = [0, *itertools.accumulate(sizes)]
        cuts = whole if most >= wanted else [*range(0, plates, max(1, most // count)), plates]
        return [slice(*ends) for ends in itertools.pairwise(cuts) if plates], count

    def _plates_at_once(self, plates: int, traced_nodes: int) -> int:
        """For how many of these plates there is room."""
        if self._chunk is not None:
            return min(self._chunk, plates)
        held = sum(state.capacity for state in self._states)
        if self.device.is_cuda and plates <= held and not traced_nodes:
            return plates  # without asking the driver, which may take its time
        budget = self._share * (
            CUDA_CHUNK_SHARE * self.device.free_memory if self.device.is_cuda else CPU_CHUNK_BYTES
        )
        if self.device.is_cuda:
            for state in self._states:
                budget += state.capacity * bytes_per_plate(self.specialized, state.nodes.shape[0])
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

    def _rooms(self, parts: Sequence[slice], nodes: wp.array, count: int) -> list[State]:
        """One state, or some that take turns, each large enough for any part."""
        capacity = max((part.stop - part.start for part in parts), default=1)
        if count < 2 or len(self._states) < 2:
            self._wait(0)
        states = self._states[:count]
        traced = nodes.shape[0] or any(state.nodes.shape[0] for state in states)
        if len(states) < count or traced or any(state.capacity < capacity for state in states):
            self._wait(0)
            states.clear()
            self._states.clear()  # frees the old room before the new one is taken
            self._states += [make_state(self.specialized, capacity, nodes) for _ in range(count)]
        return self._states[:count]

    def _start(self, state: State, phasors: np.ndarray, values: PerPlateValues) -> np.ndarray:
        """Put plates at rest under their loads; returns (plates,) the pressure [N/m²] that each is scaled by."""
        specialized, precision = self.specialized, self.scene.grid.precision
        travelling = specialized.moving.largest if specialized.moving else 0.0
        sizes = self.engine.per_plate.put_waves(state, values)
        room = state.host.coefficients.numpy()
        scale = scaled_coefficients(specialized.signals, phasors, sizes, travelling, room)
        load_drives(self.engine, state, len(scale), values.edges)
        if not specialized.effects.plain:
            with np.errstate(over="ignore", invalid="ignore"):
                state.host.units.numpy()[: len(scale)] = scale * specialized.scheme.load_scale
            wp.copy(state.units, state.host.units, count=len(scale))
        if specialized.moving:
            moving = np.zeros(state.capacity)
            moving[: len(scale)] = travelling / np.where(scale == 0, 1, scale)
            state.moving.assign(moving.astype(precision))
        state.clear(len(scale))
        return scale

    def _march(
        self,
        state: State,
        plates: int,
        snapshots: list[int],
        displacement: np.ndarray,
        tell: Callable[[int], None],
        queued: bool,
    ) -> tuple[int, np.ndarray]:
        """All steps of the plates in the state, stopping where a displacement is kept or progress is due.

        With ``queued`` it does not wait for the last ones.

        Returns the steps taken, which are fewer where no plate is left that does not grow without bound, and (plates,)
        the step at which a plate was seen to grow, or −1.
        """
        scheme = self.specialized.scheme
        nx, ny = scheme.nodes
        node_steps = plates * self.specialized.interior_nodes
        segment = max(1, int(SEGMENT_NODE_STEPS["cuda" if self.device.is_cuda else "cpu"] / node_steps))
        watched = watched_steps(self.specialized, plates)
        segment = min(segment, watched or segment)
        seen = np.full(plates, -1)
        step = 0
        for stop in sorted({*range(segment, scheme.steps, segment), *snapshots, scheme.steps}):
            if stop > step:
                self.engine.advance(state, plates, step, stop)
                step = stop
                if watched:
                    seen[(seen < 0) & outgrown(state.rate.numpy()[:plates], step * self._fastest)] = step
            if stop in snapshots:
                kept = [index for index, snapshot in enumerate(snapshots) if snapshot == stop]
                displacement[:, kept] = state.u[:plates].numpy()[:, None, 1 : ny + 1, :nx]
            if stop < scheme.steps or not queued:
                wp.synchronize_device(self.device)
                tell(step * node_steps)
                check_interrupt()
            if (seen >= 0).all():
                break
        return step, seen

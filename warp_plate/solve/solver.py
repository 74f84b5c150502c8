"""Time stepping of any number of plates of one scene, each under its own drives."""

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from typing import Any, Concatenate, NoReturn, ParamSpec, TypeVar

import numpy as np
import warp as wp

from warp_plate.plate.designs import (
    NO_PER_PLATE,
    Designs,
    PerPlate,
    PerPlateValues,
    as_numbers,
    as_phasors,
    check_designs,
)
from warp_plate.plate.scheme import Discretization, discretize
from warp_plate.plate.weights import NO_AREAS, RegionLike, bilinear
from warp_plate.scene.errors import SceneError, check_type, check_whole
from warp_plate.scene.model import Scene
from warp_plate.solve.batching import Batch, import_drives
from warp_plate.solve.compiled_scene import CompiledScene, paths_of, why_streaming
from warp_plate.solve.devices import LOADING, MOST_THREADS, find_device
from warp_plate.solve.parts import Records, run_parts, run_parts_on_device, states_for
from warp_plate.solve.run import Progress, Run
from warp_plate.solve.specialize import Quantity, Specialized, effect_names
from warp_plate.solve.state import State

Drives = np.ndarray | Sequence[Sequence[complex]] | tuple[np.ndarray, np.ndarray] | Designs

P = ParamSpec("P")
T = TypeVar("T")
# Locks of CUDA devices by alias: all solvers of one queue their work on the same stream.
_DEVICE_LOCKS: dict[str, Any] = {}


def _one_at_a_time(method: Callable[Concatenate["PlateSolver", P], T]) -> Callable[Concatenate["PlateSolver", P], T]:
    """Let a method wait until no other thread uses the arrays of its solver, on CUDA those of the device's solvers; a
    method that is called within another, by a function that shows progress, raises a RuntimeError."""

    @wraps(method)
    def alone(solver: "PlateSolver", /, *arguments: P.args, **options: P.kwargs) -> T:
        with solver._lock:
            if solver._busy:
                raise RuntimeError("progress: uses the solver whose progress it shows; make another solver for it")
            solver._busy = True
            try:
                return method(solver, *arguments, **options)
            finally:
                solver._busy = False

    return alone


def refuse_pickling(solver: object) -> NoReturn:
    """Raise a TypeError that says what to do instead; for ``__reduce__``, which copies use too."""
    raise TypeError(f"cannot pickle or copy a {type(solver).__name__}: make it again from its scene")


class PlateSolver:
    """A scene compiled for a device.

    :meth:`run` takes plates from rest to the end of the window. To inspect them during a run, set them up and step them
    yourself::

        solver = PlateSolver(Scene.load("paper"), "cpu")
        solver.setup([[1, 0, 0, 0], [1, 1, 1, 1]])  # two plates at rest under their loads
        while solver.time < 0.02:
            solver.step(10)
            print(solver.time, np.abs(solver.displacement).max(axis=(1, 2)))

    Such steps give bit-identical displacements to :meth:`run`, and on the CPU bit-identical energies.
    A run neither uses nor changes plates that were set up. Threads may share a solver: they wait for each other.

    Args:
        scene: The scene, or its discretization, whose ``per_plate`` and ``allow_unstable`` then hold.
        device: "cpu", "cuda", "cuda:1", ..., or "auto" for the first CUDA device if there is one, otherwise the CPU.
        path: "auto", "resident" (all steps in one launch) or "streaming" (many launches).
        chunk: Number of plates to run at once (default: as many as memory holds).
        threads: Threads of the CPU (default: as many as it has).
        allow_unstable: Accept a time step above the stability limit.
        areas: Further regions whose energy runs return, by name: rectangles x0, x1, y0, y1 [m], shapes, or weights
            (ny, nx) in cells.
        per_plate: Quantities that may differ between plates besides their drives, see ``plate.designs``.
        quantity: "velocity" or "displacement", the quantity whose energies runs return, see :class:`Run`.
        memory_share: Fraction of the memory for plates to use, if several solvers hold plates at the same time.

    Attributes:
        device: The Warp device.
        compiled: The compiled kernels.
        path: Name of the path.
        specialized: Compile key and device arrays.
        discretization: The scene on its grid.
        scheme: Grid and time steps.
        regions: Names of the regions for which runs return energies.
        node_steps_per_plate: Nodes updated × steps.
        states: Device arrays that runs use.
        node_steps: Nodes updated × steps × plates of all runs so far.

    Raises:
        SceneError: The time step is unstable, an actuator covers no node, there is no such device or path, the scene
            does not support ``per_plate``, or displacements of a nonlinear scene are requested.
    """

    def __init__(
        self,
        scene: Scene | Discretization,
        device: str = "auto",
        path: str = "auto",
        chunk: int | None = None,
        threads: int | None = None,
        allow_unstable: bool = False,
        areas: Mapping[str, RegionLike] = NO_AREAS,
        per_plate: PerPlate = NO_PER_PLATE,
        quantity: Quantity = "velocity",
        memory_share: float = 1.0,
    ) -> None:
        started = time.perf_counter()
        if chunk is not None:
            check_whole("chunk", chunk)
        if threads is not None:
            check_whole("threads", threads, MOST_THREADS)
        check_type("path", path, str)
        check_type("quantity", quantity, str)
        check_type("scene", scene, Scene, Discretization)
        check_type("per_plate", per_plate, PerPlate)
        check_type("areas", areas, Mapping)
        self.device = find_device(device)
        self._lock, self._busy = threading.RLock(), False
        if self.device.is_cuda:
            self._lock = _DEVICE_LOCKS.setdefault(self.device.alias, self._lock)
        discretization = discretize(scene, per_plate, allow_unstable) if isinstance(scene, Scene) else scene
        self.scene = discretization.scene
        self.scene.check_stepped()
        with LOADING:
            self.compiled = CompiledScene(Specialized(discretization, self.device, threads, areas, quantity), path)
        self.path, self.specialized = self.compiled.path, self.compiled.specialized
        self.discretization, self.scheme = discretization, self.specialized.scheme
        self.regions = self.specialized.regions
        self.node_steps_per_plate = self.specialized.node_steps_per_plate
        self.states: list[State] = []
        self._chunk, self._areas, self._memory_share = chunk, areas, memory_share
        self._batch: Batch | None = None
        self.node_steps = 0
        self._setup_seconds = time.perf_counter() - started

    __reduce__ = refuse_pickling

    @property
    def compile_seconds(self) -> float:
        """Time that discretizing and compiling took so far [s]."""
        return self._setup_seconds + self.specialized.late_seconds

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects in the compiled kernel."""
        return effect_names(self.discretization)

    def describe_path(self, traced: bool = False) -> str:
        """Return the path and, if it streams for want of a better one, the reason; ``traced``: of runs with points."""
        reason = why_streaming(self.specialized, traced)
        return f"streaming ({reason})" if reason else self.path

    @_one_at_a_time
    def run(
        self,
        drives: Drives,
        times: Sequence[float] = (),
        points: Sequence[tuple[float, float]] = (),
        progress: Progress | None = None,
        peak_times: Sequence[float] = (),
    ) -> Run:
        """Simulate one plate for each drive, from rest to the end of the window.

        Args:
            drives: (plates, actuators) complex phasors Z [N/m²], the load being Re(Z exp(iωt)) on each patch, or what
                the scene's drive makes of Z (see ``plate.signals``); or a tuple (magnitude, phase) of such arrays,
                Z = magnitude · exp(−i phase); or Designs, whose plates may differ in more than drives.
            times: Times at which to keep the displacement [s].
            points: Points (x, y) [m] at which to keep the displacement of every step, bilinear between nodes.
            progress: Called with (node-steps done, node-steps in all) between launches; it may not use this solver.
            peak_times: Times at which to sample the displacement for its peak [s].

        Raises:
            SceneError: Drives have another shape or kind, ``check_designs`` refuses them, a time is outside the run, a
                point is off the plate, or times or points are asked of a solver of displacements.
        """
        phasors, values = self._check_drives(drives)
        self._check_records(times, points)
        self._check_records(peak_times)
        # On CUDA resident plates show nothing between launches.
        if points and self.device.is_cuda and self.path == "resident" and "streaming" in paths_of(self.specialized):
            streaming = PlateSolver(self.discretization, self.device.alias, "streaming", self._chunk, areas=self._areas)
            self._setup_seconds += streaming.compile_seconds
            run = streaming.run(drives, times, points, progress, peak_times)
            self.node_steps += run.node_steps
            return run
        scheme, plates = self.scheme, len(phasors)
        snapshots = [scheme.step_of(time_asked) for time_asked in times]
        run = Run(
            energy=np.empty((plates, len(self.regions))),
            regions=self.regions,
            masses=self.specialized.masses,
            displacement=np.full((plates, len(snapshots), *scheme.nodes[::-1]), np.nan),
            times=np.array(snapshots) * scheme.time_step,
            peak=np.zeros((plates, *scheme.nodes[::-1])),
            trace=np.empty((plates, len(points), scheme.steps)),
            trace_times=scheme.time_step * np.arange(1, scheme.steps + 1) if points else np.empty(0),
            node_steps=plates * self.node_steps_per_plate,
            faults={},
        )
        corners, shares = np.empty((0, 4, 2), np.int32), np.empty((0, 4))
        if len(points):
            corners, shares = bilinear(points, scheme.nodes, self.scene.plate.size)
        samples = {scheme.step_of(time_asked) for time_asked in peak_times}
        records = Records(snapshots, samples, corners, shares)
        try:
            states = self._states_for(plates, corners.reshape(-1, 2))
            run_parts(self.compiled, states, phasors, values, records, run, progress or (lambda done, total: None))
        except BaseException:  # an interrupted run leaves no work that uses its states
            wp.synchronize_device(self.device)
            raise
        self.node_steps += run.node_steps
        return run

    @_one_at_a_time
    def run_on_device(self, drives: object) -> wp.array:
        """Simulate plates as :meth:`run` does, under drives and with energies in arrays of this device.

        Nothing is copied to the host, and on CUDA the work is only queued, on Warp's current stream of the device.
        Handing arrays over by DLPack orders that stream after the producer's and before the consumer's. Only where
        plates may grow (large motion, a step above the limit) does the host wait, to look for growth. Gradients do not
        flow through.

        Args:
            drives: (plates, actuators, 2) real and imaginary parts of phasors Z as in :meth:`run`, float32 or float64,
                an array of Warp, Torch, CuPy, JAX, NumPy or another library with DLPack, in memory of this device. It
                is read in place: do not write to it before the energies are there.

        Returns:
            (plates, regions) energies [J] of ``Run.energy``, float64; NaN for faulty plates. It exports itself by
            DLPack, as to ``torch.from_dlpack``.

        Raises:
            SceneError: Drives have another shape or type, or are on another device.
        """
        pairs = import_drives(drives, len(self.scene.actuators), self.device)
        energy: wp.array = wp.empty((len(pairs), len(self.regions)), dtype=wp.float64, device=self.device)
        run_parts_on_device(self.compiled, self._states_for(len(pairs), np.empty((0, 2), int))[0], pairs, energy)
        # Queued work reads the drives: their memory stays as long as the energies.
        energy.drives = pairs  # type: ignore[attr-defined]
        self.node_steps += len(pairs) * self.node_steps_per_plate
        return energy

    @_one_at_a_time
    def setup(self, drives: Drives) -> None:
        """Put plates at rest under their loads, given as to :meth:`run`, to be stepped and read by hand."""
        if self.specialized.quantity == "displacement":
            raise SceneError('setup: a solver with quantity = "displacement" cannot be stepped by hand; make another')
        phasors, values = self._check_drives(drives)
        self._batch = Batch(self.compiled, State(self.specialized, max(1, len(phasors))), len(phasors))
        self._batch.load(phasors, values)

    @_one_at_a_time
    def step(self, count: int = 1) -> None:
        """Take the plates that were set up ``count`` time steps further, at most to the end of the window.

        Raises:
            SceneError: No plates are set up.
        """
        self._stepped.advance(min(self._stepped.step + count, self.scheme.steps))

    @property
    def time(self) -> float:
        """Time t_n = nΔt of the plates that were set up [s]."""
        return self._stepped.step * self.scheme.time_step

    @property
    @_one_at_a_time
    def displacement(self) -> np.ndarray:
        """(plates, ny, nx) displacement at ``time`` [m]."""
        return self._stepped.displacement

    @property
    @_one_at_a_time
    def velocity(self) -> np.ndarray:
        """(plates, ny, nx) velocity half a step before ``time`` [m/s]."""
        return self._stepped.velocity

    @property
    @_one_at_a_time
    def energy(self) -> np.ndarray:
        """(plates, regions) sum of the kinetic energies [J] of the window's steps so far over their final number.

        After the last step this is ``Run.energy``.
        """
        energy = np.empty((self._stepped.plates, len(self.regions)))
        self._stepped.queue_energies()(energy)
        return energy

    @property
    def _stepped(self) -> Batch:
        if self._batch is None:
            raise SceneError("no plates are set up; call setup(drives) first")
        return self._batch

    def _states_for(self, plates: int, corners: np.ndarray) -> list[State]:
        return states_for(self.specialized, self.states, plates, corners, self._chunk, self._memory_share)

    def _check_drives(self, drives: Drives) -> tuple[np.ndarray, PerPlateValues]:
        actuators, scheme = len(self.scene.actuators), self.specialized.scheme
        designs = drives if isinstance(drives, Designs) else Designs(as_phasors(drives, actuators))
        phasors = as_phasors(designs.drives, actuators)
        if designs.only_drives:
            return phasors, PerPlateValues()
        return phasors, check_designs(designs, self.scene, self.discretization.per_plate, scheme.time_step)

    def _check_records(self, times: Sequence[float], points: Sequence[tuple[float, float]] = ()) -> None:
        end = self.scheme.steps * self.scheme.time_step
        for name, values, item, kind in (("times", times, (), "numbers"), ("points", points, (2,), "pairs of numbers")):
            try:
                shape = as_numbers(values, "biuf").shape
            except (TypeError, ValueError):
                shape = ()
            if shape != (0,) and (not shape or shape[1:] != item):
                raise SceneError(f"{name}: must be a list of {kind}")
        if self.specialized.quantity == "displacement" and len(times) + len(points):
            raise SceneError('times, points: a solver with quantity = "displacement" keeps none; make another')
        for time_asked in times:
            if not 0 <= time_asked <= self.scene.window.end * (1 + 1e-9):
                raise SceneError(f"times: {time_asked:g} s is outside the run, which goes from 0 to {end:g} s")
        width, height = self.scene.plate.size
        for x, y in points:
            if not (0 <= x <= width and 0 <= y <= height):
                raise SceneError(f"points: {[x, y]} is off the plate of {[width, height]} m")

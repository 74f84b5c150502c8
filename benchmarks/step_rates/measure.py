"""Timing of the solver: each case is warmed up, synchronised and run several times; the median counts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from statistics import median
from typing import Any

import numpy as np
import warp as wp

from step_rates.cases import BenchCase, Kind
from step_rates.limits import DeviceLimits, measure_limits, seconds_of, share_of_limit
from warp_plate.accuracy.measure import describe_machine, describe_versions
from warp_plate.plate.memory import machine_memory
from warp_plate.plate.scheme import discretize
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.compiled_scene import CompiledScene
from warp_plate.solve.devices import find_device
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import Advance, State, bytes_per_plate

# Steps of the paper's run: the most that a timed run takes, and the steps of "seconds for a swarm".
PAPER_STEPS = 1250
# Fewest steps of a timed run, and the longest time that they may take [s].
FEWEST_STEPS, LONGEST_SECONDS = 32, 1.0
# Memory of a case: fraction of a CUDA device's free memory; on CPU fraction of the machine's memory, and bytes at most.
CUDA_MEMORY_SHARE, CPU_MEMORY_SHARE, CPU_MEMORY_BYTES = 0.8, 0.5, 2**32
# Size of the noise that plates start from [m, and m a step] and of their drives [N/m²], so that stretching is small.
SIZE = 1e-6
# Kinds of plates: tables that change the paper's scene, and the time step as a fraction of the paper's.
TABLES: dict[Kind, tuple[dict[str, dict[str, object]], float]] = {
    "plain": ({}, 1.0),
    "order4": ({"grid": {"order": 4, "load": "moments"}}, 0.5),
    "free": ({"edges": dict.fromkeys(("left", "right"), "free"), "effects": {"tension": {"x": 1.0, "y": 1.0}}}, 0.5),
    "stretching": ({"effects": {"stretching": {}}}, 0.5),
}
# Most repetitions of short runs.
MOST_RUNS = 100


@dataclass(frozen=True)
class TimingBudget:
    """The duration of a measurement."""

    seconds: float  # time of a run, which takes fewer steps than the paper's if necessary [s]
    runs: int  # fewest runs


FULL = {"cpu": TimingBudget(1.0, 5), "cuda": TimingBudget(0.25, 7)}
QUICK = {"cpu": TimingBudget(0.2, 3), "cuda": TimingBudget(0.1, 5)}


@dataclass(frozen=True)
class KernelSize:
    """Resources of a compiled CUDA kernel, per thread."""

    name: str
    registers: int
    local_bytes: int  # memory for spilled registers and arrays


@dataclass(frozen=True)
class BenchRow:
    """Timing of one case, with the path that it ran on; None where it was skipped."""

    device: str
    precision: str
    nodes: int
    plates: int
    steps: int | None = None  # steps of a timed run
    path: str | None = None
    seconds: float | None = None  # median time of a run [s]
    node_steps_per_second: float | None = None
    nanoseconds_per_node_step: float | None = None
    swarm_seconds: float | None = None  # time of the paper's 1250 steps [s]
    bytes_per_plate: int | None = None  # on the device
    limit: str | None = None  # limit that applies, "copy" or "arithmetic"
    share: float | None = None  # share of this limit
    status: str = "measured"  # or "skipped: ..."
    kind: Kind = "plain"
    kernels: Sequence[KernelSize] = ()  # that the case loads; none on CPU

    @property
    def measured(self) -> bool:
        """True if the case was timed."""
        return self.status == "measured"


@dataclass(frozen=True)
class BenchReport:
    """The result of a benchmark; ``limits`` by device."""

    machine: Mapping[str, Any]  # see ``describe_machine``, with all devices
    versions: Mapping[str, str]
    limits: Mapping[str, DeviceLimits]
    rows: Sequence[BenchRow]
    interrupted: bool


@dataclass(frozen=True)
class PreparedCase:
    """A case with its plates and drives on the device."""

    specialized: Specialized
    path: str
    advance: Advance
    state: State

    @property
    def node_steps(self) -> int:
        """Number of moving nodes of all plates."""
        return self.state.capacity * self.specialized.interior_nodes

    def seconds(self, steps: int) -> float:
        """Run steps, half of them before the window and half in it, as in the paper; return their time [s]."""
        start = (PAPER_STEPS - steps) // 2
        run = partial(self.advance, self.state, self.state.capacity, start, start + steps)
        return seconds_of(run, self.specialized.device)


def measure_all(
    cases: Sequence[BenchCase],
    pace: Mapping[str, TimingBudget],
    on_progress: Callable[[int, BenchCase], None] | None = None,
) -> BenchReport:
    """Measure the cases, and the limits of each device before its first case; Ctrl-C ends it with the rows so far.

    ``pace`` has the durations by "cpu" and "cuda"; ``on_progress`` takes the number of finished cases and the next one.

    Raises:
        SceneError: there is no such device, or WARP_PLATE_THREADS is not a number of threads.
        KeyboardInterrupt: no case has been measured yet.
    """
    machines = [describe_machine(device) for device in dict.fromkeys(case.device for case in cases)]
    machine = {**machines[0], "devices": {name: model for one in machines for name, model in one["devices"].items()}}
    limits, rows = dict[str, DeviceLimits](), list[BenchRow]()
    try:
        for case in cases:
            if on_progress is not None:
                on_progress(len(rows), case)
            device = find_device(case.device)
            if case.device not in limits:
                precisions = dict.fromkeys(other.precision for other in cases if other.device == case.device)
                limits[case.device] = measure_limits(device, precisions)
            rows.append(measure_case(case, limits[case.device], pace["cuda" if device.is_cuda else "cpu"]))
    except KeyboardInterrupt:
        if not rows:
            raise
    return BenchReport(machine, describe_versions(), limits, tuple(rows), interrupted=len(rows) < len(cases))


def measure_case(case: BenchCase, limits: DeviceLimits, pace: TimingBudget) -> BenchRow:
    """Return the timing of a case, or the reason why it was skipped."""
    row = BenchRow(case.device, case.precision, case.nodes, case.plates, kind=case.kind)
    try:
        ready = prepare(case)
        steps = choose_steps(ready, pace.seconds)
    except SceneError as reason:
        return replace(row, status=f"skipped: {reason}")
    seconds = median(time_runs(partial(ready.seconds, steps), pace))
    rate = ready.node_steps * steps / seconds
    limit, share = share_of_limit(ready.specialized, ready.path, rate, limits)
    return replace(
        row,
        steps=steps,
        path=ready.path,
        seconds=seconds,
        node_steps_per_second=rate,
        nanoseconds_per_node_step=1e9 / rate,
        swarm_seconds=ready.node_steps * PAPER_STEPS / rate,
        bytes_per_plate=bytes_per_plate(ready.specialized, 0),
        limit=limit,
        share=share,
        kernels=kernel_sizes(ready.specialized),
    )


def kernel_sizes(specialized: Specialized) -> list[KernelSize]:
    """Return the resources of each CUDA kernel that a scene has loaded; an empty list on CPU."""
    if specialized.device.is_cpu:
        return []
    sizes = []
    for kernel, block_dim in specialized.loaded_kernels.items():
        found = wp.get_cuda_kernel_properties(kernel, specialized.device, block_dim)
        name = f"{kernel.func.__module__.rpartition('.')[2]}.{kernel.func.__name__}"
        sizes.append(KernelSize(name, found["register_count"], found["local_memory_size"]))
    return sizes


def time_runs(run: Callable[[], float], pace: TimingBudget) -> list[float]:
    """Return the times of runs [s], as ``run`` returns them, after one to warm up; short runs are repeated more."""
    run()
    taken: list[float] = []
    while len(taken) < pace.runs or (sum(taken) < pace.seconds / 4 and len(taken) < MOST_RUNS):
        taken.append(run())
    return taken


def choose_steps(ready: PreparedCase, seconds: float) -> int:
    """Return an even number of steps that takes about this time [s], at most the steps of the paper's run.

    Raises:
        SceneError: the fewest steps take too long.
    """
    for steps in (4, FEWEST_STEPS, 8 * FEWEST_STEPS, PAPER_STEPS):
        took = ready.seconds(steps)
        if steps <= FEWEST_STEPS and took > LONGEST_SECONDS:
            raise SceneError(f"{steps} steps take {took:.1f} s, which is more than {LONGEST_SECONDS:g} s")
        if steps >= FEWEST_STEPS and took > seconds / 8:
            break
    return min(PAPER_STEPS, max(FEWEST_STEPS, int(steps * seconds / took) // 2 * 2))


def prepare(case: BenchCase) -> PreparedCase:
    """Compile the kernels of a case and load random drives.

    Plates start from noise. If they started at rest, the wave front would pass through denormal numbers, which slow a
    CPU down by up to two times in short runs of large plates.

    Raises:
        SceneError: there is no such device, the path cannot take this grid, or the plates do not fit into memory.
    """
    device = find_device(case.device)
    specialized = Specialized(discretize(paper_like(case.nodes, case.precision, case.kind)), device)
    needed, room = case.plates * bytes_per_plate(specialized, 0), memory_for_plates(device)
    if needed > room:
        raise SceneError(f"needs {needed / 2**30:.1f} GiB of memory, but only {room / 2**30:.1f} GiB may be used")
    compiled, state = CompiledScene(specialized, case.path), State(specialized, case.plates)
    random = np.random.default_rng(0)
    parts = random.uniform(-SIZE, SIZE, (2, case.plates, specialized.patches.shape[0]))
    state.host_coefficients.numpy()[:] = specialized.discretization.signals.coefficients(parts[0] + 1j * parts[1])
    compiled.load_drives(state, case.plates)
    compiled.advance(state, case.plates, 0, 1)  # some paths make arrays of their own at the first step
    for field in (state.u, state.rate):
        plate = np.zeros(field.shape[1:], dtype=case.precision)
        plate[2 : case.nodes, 1 : case.nodes - 1] = random.uniform(-SIZE, SIZE, (case.nodes - 2,) * 2)
        field.assign(np.broadcast_to(plate, field.shape))
    return PreparedCase(specialized, compiled.path, compiled.advance, state)


def paper_like(nodes: int, precision: str, kind: Kind = "plain") -> Scene:
    """Return the paper's scene on another grid, with times scaled like the stability limit, as a plate of this kind.

    It has again 1250 steps, half of them in the window, each the same fraction of the limit and of the drive's period.
    """
    scene = Scene.load("paper").model_dump()
    tables, part = TABLES[kind]
    scale = part * ((scene["grid"]["nodes"][0] - 1) / (nodes - 1)) ** 2
    scene["grid"] |= {"nodes": (nodes, nodes), "precision": precision, "load": "overlap"}
    scene["grid"]["time_step"] *= scale
    scene["window"] = {end: time * scale for end, time in scene["window"].items()}
    scene["drive"]["frequency"] /= scale
    scene["effects"]["damping"]["scheme"] = "centred"
    scene["record"]["times"] = ()
    for name, table in tables.items():
        scene[name] |= table
    return Scene.model_validate(scene)


def memory_for_plates(device: wp.Device) -> float:
    """Return the bytes of the device's memory that the plates of one case may take."""
    if device.is_cuda:
        return CUDA_MEMORY_SHARE * float(device.free_memory)
    return min(CPU_MEMORY_SHARE * machine_memory(), CPU_MEMORY_BYTES)

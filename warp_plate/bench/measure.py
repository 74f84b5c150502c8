"""Times the solver: each case warmed up, synchronised, and run several times, of which the median counts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from statistics import median

import numpy as np
import warp as wp

from warp_plate.bench.cases import BenchCase
from warp_plate.bench.clock import seconds_of
from warp_plate.bench.limits import DeviceLimits, measure_limits, share_of_limit
from warp_plate.bench.machine import Machine, describe_machine, describe_versions
from warp_plate.plate.discretization import discretize
from warp_plate.plate.memory import machine_memory
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import find_device
from warp_plate.solve.engine import load_drives, make_engine
from warp_plate.solve.specialize import Specialized, specialize
from warp_plate.solve.state import Advance, State, bytes_per_plate, make_state

# Steps of the paper's run: the most that a run takes here, and what "seconds for a swarm" are for.
PAPER_STEPS = 1250
# The fewest steps that say something, and the longest that they may take [s].
FEWEST_STEPS = 32
LONGEST_SECONDS = 1.0
# A case takes at most this part of a CUDA device's free memory, and of the machine's, or this many bytes, on CPU.
CUDA_MEMORY_SHARE, CPU_MEMORY_SHARE, CPU_MEMORY_BYTES = 0.8, 0.5, 2**32
# Short runs are repeated more often, up to this number.
MOST_RUNS = 100
NOTHING_TRACED = np.zeros((0, 2), dtype=np.int32)


@dataclass(frozen=True)
class TimingBudget:
    """seconds: that a run may take, fewer steps being taken where the whole would take longer; runs: at least."""

    seconds: float
    runs: int


FULL = {"cpu": TimingBudget(1.0, 5), "cuda": TimingBudget(0.25, 7)}
QUICK = {"cpu": TimingBudget(0.2, 3), "cuda": TimingBudget(0.1, 5)}


@dataclass(frozen=True)
class BenchRow:
    """One case's figures; None where it was skipped.

    path: the one taken; seconds: of one run of ``steps`` steps; swarm_seconds: for the paper's 1250 steps;
    limit: "copy" or "arithmetic"; share: of that limit (see ``limits``); status: "measured", or why not.
    """

    device: str
    precision: str
    nodes: int
    plates: int
    steps: int | None
    path: str | None
    seconds: float | None
    node_steps_per_second: float | None
    nanoseconds_per_node_step: float | None
    swarm_seconds: float | None
    bytes_per_plate: int | None
    limit: str | None
    share: float | None
    status: str

    @property
    def measured(self) -> bool:
        """Whether there are figures."""
        return self.status == "measured"


@dataclass(frozen=True)
class BenchReport:
    """Everything that one call of the benchmark found; limits: by device."""

    machine: Machine
    versions: Mapping[str, str]
    limits: Mapping[str, DeviceLimits]
    rows: Sequence[BenchRow]
    interrupted: bool

    def as_json(self) -> dict[str, object]:
        """Of numbers, texts, lists and mappings only."""
        return asdict(self)


class NotMeasured(Exception):
    """A case is too large for this machine; the message says in what."""


@dataclass(frozen=True)
class PreparedCase:
    """A case that can be run: plates with their drives on the device."""

    specialized: Specialized
    path: str
    advance: Advance
    state: State

    @property
    def node_steps(self) -> int:
        """Of one step of all plates."""
        return self.state.capacity * self.specialized.interior_nodes

    def run(self, steps: int) -> None:
        """Half of the steps before the window, half in it, as in the paper."""
        start = (PAPER_STEPS - steps) // 2
        self.advance(self.state, self.state.capacity, start, start + steps)


def measure_all(
    cases: Sequence[BenchCase],
    pace: Mapping[str, TimingBudget],
    on_progress: Callable[[int, BenchCase], None] | None = None,
) -> BenchReport:
    """Measure the cases, and the limits of each device before its first; Ctrl-C ends it with what is there.

    Args:
        cases: ordered by device.
        pace: by "cpu" and "cuda".
        on_progress: called with the number of cases done and the one that comes next.

    Raises:
        SceneError: no such device, or WARP_PLATE_THREADS is no number of threads.
        KeyboardInterrupt: nothing has been measured yet.
    """
    machine = describe_machine(list(dict.fromkeys(case.device for case in cases)))
    limits: dict[str, DeviceLimits] = {}
    rows: list[BenchRow] = []
    interrupted = False
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
        interrupted = True
    return BenchReport(machine, describe_versions(), limits, tuple(rows), interrupted)


def measure_case(case: BenchCase, limits: DeviceLimits, pace: TimingBudget) -> BenchRow:
    """The figures of a case, or the reason why it was skipped."""
    try:
        ready = prepare(case)
        steps = choose_steps(ready, pace.seconds)
    except (SceneError, NotMeasured) as reason:
        nothing = dict.fromkeys(list(BenchRow.__dataclass_fields__)[4:-1])
        return BenchRow(case.device, case.precision, case.nodes, case.plates, **nothing, status=f"skipped: {reason}")
    seconds = median(time_runs(partial(ready.run, steps), ready.specialized.device, pace))
    rate = ready.node_steps * steps / seconds
    limit, share = share_of_limit(ready.specialized, ready.path, rate, limits)
    return BenchRow(
        device=case.device,
        precision=case.precision,
        nodes=case.nodes,
        plates=case.plates,
        steps=steps,
        path=ready.path,
        seconds=seconds,
        node_steps_per_second=rate,
        nanoseconds_per_node_step=1e9 / rate,
        swarm_seconds=ready.node_steps * PAPER_STEPS / rate,
        bytes_per_plate=bytes_per_plate(ready.specialized, 0),
        limit=limit,
        share=share,
        status="measured",
    )


def time_runs(run: Callable[[], None], device: wp.Device, pace: TimingBudget) -> list[float]:
    """Seconds of each run, after one to warm up; more runs than asked for where they are short."""
    run()
    taken: list[float] = []
    while len(taken) < pace.runs or (sum(taken) < pace.seconds / 4 and len(taken) < MOST_RUNS):
        taken.append(seconds_of(run, device))
    return taken


def choose_steps(ready: PreparedCase, seconds: float) -> int:
    """An even number of steps that take about so many seconds, at most those of the paper's run.

    Raises:
        NotMeasured: even few steps would take too long.
    """
    for steps in (4, FEWEST_STEPS, 8 * FEWEST_STEPS, PAPER_STEPS):
        took = seconds_of(partial(ready.run, steps), ready.specialized.device)
        if steps <= FEWEST_STEPS and took > LONGEST_SECONDS:
            raise NotMeasured(f"{steps} steps take {took:.1f} s, which is over {LONGEST_SECONDS:g} s")
        if steps >= FEWEST_STEPS and took > seconds / 8:
            break
    return min(PAPER_STEPS, max(FEWEST_STEPS, int(steps * seconds / took) // 2 * 2))


def prepare(case: BenchCase) -> PreparedCase:
    """Compile the case and load random drives.

    Plates start from noise instead of from rest: a wave front that runs into a resting plate passes through denormal
    numbers, with which a CPU is slow; short runs of large plates took up to twice as long (measured).

    Raises:
        SceneError: no such device, or the path cannot take this size.
        NotMeasured: the plates do not fit into memory.
    """
    device = find_device(case.device)
    specialized = specialize(discretize(paper_like(case.nodes, case.precision)), device)
    needed, room = case.plates * bytes_per_plate(specialized, 0), memory_for_plates(device)
    if needed > room:
        raise NotMeasured(f"needs {needed / 2**30:.1f} GiB of memory, and {room / 2**30:.1f} GiB may be taken")
    engine = make_engine(specialized, case.path)
    state = make_state(specialized, case.plates, wp.array(NOTHING_TRACED, dtype=int, device=device))
    random = np.random.default_rng(0)
    parts = random.uniform(-1, 1, (2, case.plates, specialized.patches.shape[0]))
    coefficients = specialized.discretization.signals.coefficients(parts[0] + 1j * parts[1])
    state.host.coefficients.numpy()[:] = coefficients
    load_drives(engine, state, case.plates)
    inner = (case.nodes - 2, case.nodes - 2)
    for field in (state.u, state.rate):
        plate = np.zeros(field.shape[1:], dtype=case.precision)
        plate[2 : case.nodes, 1 : case.nodes - 1] = random.uniform(-1, 1, inner)
        field.assign(np.broadcast_to(plate, field.shape))
    return PreparedCase(specialized, engine.path, engine.advance, state)


def paper_like(nodes: int, precision: str) -> Scene:
    """The paper's panel on another grid, its times scaled as the stability limit is: again 1250 steps, half of them in
    the window, each as far below the limit and through as much of the drive's period as in the paper."""
    scene = Scene.load("paper").model_dump()
    scale = ((scene["grid"]["nodes"][0] - 1) / (nodes - 1)) ** 2
    scene["grid"] |= {"nodes": (nodes, nodes), "precision": precision, "load": "overlap"}
    scene["grid"]["time_step"] *= scale
    scene["window"] = {end: time * scale for end, time in scene["window"].items()}
    scene["drive"]["frequency"] /= scale
    scene["effects"]["damping"]["scheme"] = "centred"
    scene["record"]["times"] = ()
    return Scene.model_validate(scene)


def memory_for_plates(device: wp.Device) -> float:
    """Bytes of the device's memory that the plates of one case may take."""
    if device.is_cuda:
        return CUDA_MEMORY_SHARE * float(device.free_memory)
    return min(CPU_MEMORY_SHARE * machine_memory(), CPU_MEMORY_BYTES)

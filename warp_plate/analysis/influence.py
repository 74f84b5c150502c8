"""Each effect of a scene switched off, or on with a typical value: its measured cost and influence on the result."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from warp_plate.effects.edges import Edges, ElasticEdge
from warp_plate.effects.effect import Setting
from warp_plate.effects.table import Effects, effect_type
from warp_plate.modal.solver import ModalSolver
from warp_plate.plate.designs import scene_phasors
from warp_plate.plate.signals import carrier_frequencies
from warp_plate.plate.weights import REGIONS, localization_factor, region_weights
from warp_plate.resolve import Resolved, resolve
from warp_plate.scene.drive import Burst, Chirp, Drive, Electrostatic
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import Area
from warp_plate.scene.model import Scene, SceneSource
from warp_plate.solve.run import sample_times
from warp_plate.solve.solver import PlateSolver

# Tables of the drive, and a second frequency relative to the drive's.
DRIVES, OTHER_FREQUENCY = ("burst", "chirp", "signal", "electrostatic"), 0.9
# Rounds of timing all scenes in turn, so that a disturbance affects all of them.
ROUNDS = 7
# Plates of a timed run on CUDA, on CPU one for each thread; node-steps of a timed run.
CUDA_PLATES, TIMED_NODE_STEPS = 256, {"cpu": 3e7, "cuda": 2e9}


@dataclass(frozen=True)
class EffectToggle:
    """An effect, and the result of switching it off or on; None where the alternative is refused."""

    name: str  # key of the effect
    on: bool  # True if the scene names the effect
    price: float | None  # time that it adds to a step, in % of a step of the bare plate; None too by modes
    deviation: float | None  # median absolute deviation of the price between rounds
    steps: float | None  # factor by which it changes the number of steps
    localization_factor: float | None  # localization factor of the alternative
    peak: float | None  # largest displacement of the alternative during the run [m]
    alternative: str  # description of the alternative, or why it is refused


@dataclass(frozen=True)
class Influence:
    """The results of a scene and of its alternatives."""

    localization_factor: float  # localization factor of the scene
    peak: float  # largest displacement during the run [m]
    # Time of a step of a plate without effects, with clamped or supported edges [s]; None if the scene needs modes
    bare_step: float | None
    toggles: tuple[EffectToggle, ...]  # one for each effect


def measure_effects(
    scene: SceneSource, device: str = "auto", on_progress: Callable[[int, int, str], object] | None = None
) -> Influence:
    """Switch each effect off or on, and measure its cost and the results under the scene's own drive.

    An effect that is off gets a typical value. If the scene's time step is too long for the alternative, the
    alternative takes its own time step. Both are stated in ``EffectToggle.alternative``. A scene that cannot be stepped
    is solved by modes, and then no cost is measured.

    Args:
        scene: A scene with a grid.
        device: Device of all runs.
        on_progress: Called with the number of finished effects, of all effects, and the name of the next.

    Raises:
        SceneError: see :class:`PlateSolver`.
    """
    effects, scene = names(), Scene.load(scene)
    resolved = resolve(scene, device, purpose="replay")
    others: dict[str, tuple[PlateSolver | ModalSolver | None, str]] = {}
    for index, name in enumerate(effects):
        if on_progress is not None:
            on_progress(index, len(effects), name)
        others[name] = _alternative(resolved, name)
    solvers = {"": resolved.solver()} | {name: solver for name, (solver, _) in others.items() if solver is not None}
    results = {}
    for name, solver in solvers.items():
        run = solver.run(scene_phasors(solver.scene)[None], peak_times=sample_times(solver.scene))
        results[name] = float(localization_factor(run.energy)[0]), float(run.peak.max())
    stepped = {name: solver for name, solver in solvers.items() if isinstance(solver, PlateSolver)}
    bare_step, costs = _measure_costs(scene, stepped, device) if not resolved.by_modes else (None, {})
    toggles = []
    for name, (_, text) in others.items():
        price, deviation, steps = costs.get(name, (None, None, None))
        factor, peak = results.get(name, (None, None))
        toggles.append(EffectToggle(name, is_on(scene, name), price, deviation, steps, factor, peak, text))
    if on_progress is not None:
        on_progress(len(effects), len(effects), "")
    return Influence(*results[""], bare_step, tuple(toggles))


def _measure_costs(
    scene: Scene, solvers: Mapping[str, PlateSolver], device: str
) -> tuple[float, dict[str, tuple[float, float, float]]]:
    """Return the time of a step of the bare plate [s], and ``price``, ``deviation`` and ``steps`` of each effect.

    ``solvers`` are those of the alternatives, and of the scene under "".
    """
    seconds = seconds_a_step({**solvers, "bare": PlateSolver(bare_scene(scene), device)}, device, ROUNDS)
    bare_step, costs = float(np.median(seconds["bare"])), {}
    steps = {name: solver.specialized.scheme.steps for name, solver in solvers.items()}
    for name in solvers.keys() - {""}:
        sign = 1 if is_on(scene, name) else -1
        prices = 100 * sign * (seconds[""] - seconds[name]) / bare_step
        price = float(np.median(prices))
        costs[name] = price, float(np.median(np.abs(prices - price))), (steps[""] / steps[name]) ** sign
    return bare_step, costs


def _alternative(resolved: Resolved, name: str) -> tuple[PlateSolver | ModalSolver | None, str]:
    """Return the scene with one effect switched, and its description; or None and why it is refused."""
    try:
        other, text = toggle(resolved.scene, name)
    except SceneError as error:
        return None, str(error)
    refusal = ""
    for grid in (other.grid, other.grid.model_copy(update={"time_step": None})):
        try:
            solver = resolved.with_scene(other.model_copy(update={"grid": grid}).with_tables()).solver()
        except SceneError as error:
            refusal = f"refused ({text}): {error}"
        else:
            step = solver.discretization.time_step
            return solver, text if grid is other.grid else f"{text}; with its own time step of {step:.2g} s"
    return None, refusal


def seconds_a_step(solvers: Mapping[str, PlateSolver], device: str, rounds: int = ROUNDS) -> dict[str, np.ndarray]:
    """Return (rounds,) times of a step of one plate [s] for each solver; all solvers have the same grid.

    Runs are shortened, warmed up and timed in turn, until their energies have come back from the device.
    """
    first = next(iter(solvers.values()))
    kind = "cuda" if first.device.is_cuda else "cpu"
    nodes = math.prod(first.scene.grid.nodes)
    plates = CUDA_PLATES if kind == "cuda" else first.specialized.threads
    plates = max(1, min(plates, int(TIMED_NODE_STEPS[kind] / nodes / 20)))
    steps = max(20, TIMED_NODE_STEPS[kind] / nodes / plates)
    timed = {name: PlateSolver(_shortened(solver, int(steps)), device) for name, solver in solvers.items()}
    phasors = np.ones((plates, len(first.scene.actuators)), dtype=complex)
    seconds: dict[str, list[float]] = {name: [] for name in timed}
    for number in range(rounds + 1):  # the first round warms up
        for name, solver in timed.items():
            started = time.perf_counter()
            solver.run(phasors)
            if number:
                taken = time.perf_counter() - started
                seconds[name].append(taken / plates / solver.specialized.scheme.steps)
    return {name: np.array(times) for name, times in seconds.items()}


def _shortened(solver: PlateSolver, most_steps: int) -> Scene:
    """Return the solver's scene cut to at most this number of steps, with all loads acting from the start."""
    scene, scheme = with_value(solver.scene, "burst", None), solver.specialized.scheme
    if (force := scene.effects.travelling) is not None:
        middle = (scene.plate.size[0] / 2, scene.plate.size[1] / 2)
        resting = type(force)(force=1.0, start=middle)
        scene = scene.model_copy(update={"effects": scene.effects.with_travelling(resting)})
    grid = scene.grid.model_copy(update={"time_step": scheme.time_step})
    end = min(scheme.steps, most_steps) * scheme.time_step
    return scene.model_copy(update={"grid": grid, "window": scene.window.model_copy(update={"start": 0.0, "end": end})})


def names() -> list[str]:
    """Return the names of all effects."""
    return ["edges", *Effects.model_fields, "own_frequencies", *DRIVES]


def is_on(scene: Scene, name: str) -> bool:
    """Return whether a scene names an effect or a table of its drive; "edges" if a side is free or on springs."""
    if name == "edges":
        return any(edge not in ("clamped", "supported") for _, edge in scene.edges)
    if name == "own_frequencies":
        return len(carrier_frequencies(scene)) > 1
    value = getattr(scene.drive if name in DRIVES else scene.effects, name)
    return value is not None and value != ()


def bare_scene(scene: Scene) -> Scene:
    """Return the scene without effects: clamped or supported edges, a tone, and a time step that suits them."""
    tables = {"effects": Effects(), "drive": Drive(frequency=scene.drive.frequency)}
    tables["grid"] = scene.grid.model_copy(update={"time_step": None})
    return with_one_frequency(_clamped(scene)).model_copy(update=tables)


def toggle(scene: Scene, name: str) -> tuple[Scene, str]:
    """Return the scene without an effect that is on, or with a typical value of one that is off, and a description.

    Raises:
        SceneError: there is no typical value for this scene.
    """
    on = is_on(scene, name)
    if name == "edges":
        return (_clamped(scene), "free and elastic edges clamped") if on else _springs(scene)
    if name == "own_frequencies":
        return (with_one_frequency(scene), "all at the drive's frequency") if on else _two_frequencies(scene)
    if on:
        empty = None if name in DRIVES else Effects.model_fields[name].default
        return with_value(scene, name, empty), "left out"
    if name not in DRIVES:
        value, text = effect_type(name).typical(setting_of(scene))
        return with_value(scene, name, value), text
    if name not in (values := _typical_drives(scene)):
        raise SceneError("no typical value is known")
    value, text = values[name]
    return with_value(scene, name, value), text


def setting_of(scene: Scene) -> Setting:
    """Return what the typical values of effects depend on."""
    areas = tuple(actuator.area for actuator in scene.actuators)
    spot = scene.target.area or _middle_of_target(scene)
    return Setting(scene.plate, scene.drive_angular_frequency, scene.window.end, areas, spot)


def with_value(scene: Scene, name: str, value: object) -> Scene:
    """Return the scene with another value, which is not checked, of an effect or of a table of the drive."""
    table = "drive" if name in DRIVES else "effects"
    return scene.model_copy(update={table: getattr(scene, table).model_copy(update={name: value})})


def with_one_frequency(scene: Scene) -> Scene:
    """Return the scene with all actuators at the drive's frequency."""
    actuators = tuple(actuator.model_copy(update={"frequency": None}) for actuator in scene.actuators)
    return scene.model_copy(update={"actuators": actuators})


def _clamped(scene: Scene) -> Scene:
    edges = {side: edge if edge in ("clamped", "supported") else "clamped" for side, edge in scene.edges}
    return scene.model_copy(update={"edges": Edges.model_validate(edges)})


def _springs(scene: Scene) -> tuple[Scene, str]:
    side, bending = min(scene.plate.size), scene.plate.rigidity
    edge = ElasticEdge(translation=1000 * bending / side**3, rotation=10 * bending / side)
    edges = Edges(left=edge, bottom=edge, right=edge, top=edge)
    text = f"all edges on springs of {edge.translation:.2g} N/m² and {edge.rotation:.2g} N"
    return scene.model_copy(update={"edges": edges}), text + " (1000 D/L³ and 10 D/L)"


def _two_frequencies(scene: Scene) -> tuple[Scene, str]:
    if len(scene.actuators) == 1:
        raise SceneError("one actuator has one frequency")
    other, (*rest, last) = OTHER_FREQUENCY * scene.drive.frequency, scene.actuators
    actuators = (*rest, last.model_copy(update={"frequency": other}))
    return scene.model_copy(update={"actuators": actuators}), f"the last actuator at {other:.3g} Hz"


def _middle_of_target(scene: Scene) -> Area:
    """Return a square of at most a quarter of the target's area around its centroid, on the plate."""
    weights = region_weights(scene)[REGIONS.index("target")]
    (width, height), (nx, ny) = scene.plate.size, scene.grid.nodes
    x = float(weights.sum(axis=0) @ np.linspace(0, width, nx) / weights.sum())
    y = float(weights.sum(axis=1) @ np.linspace(0, height, ny) / weights.sum())
    half = min(math.sqrt(weights.sum() * width * height / (nx - 1) / (ny - 1)) / 4, x, width - x, y, height - y)
    return x - half, x + half, y - half, y + half


def _typical_drives(scene: Scene) -> dict[str, tuple[object, str]]:
    """Return typical values of the tables under [drive], with descriptions."""
    frequency, end = scene.drive.frequency, scene.window.end
    other, ramp = OTHER_FREQUENCY * frequency, end / 10
    bias = max(abs(actuator.magnitude) for actuator in scene.actuators) or 1.0
    return {
        "burst": (Burst(duration=end, ramp=ramp), f"over the whole run, with ramps of {ramp:.2g} s"),
        "chirp": (Chirp(end_frequency=other, duration=end), f"from {frequency:g} to {other:.3g} Hz over the run"),
        "electrostatic": (
            Electrostatic(bias=bias, gain=1 / (2 * bias)),
            f"bias of {bias:.3g}, as large as the voltage, with the same tone",
        ),
    }

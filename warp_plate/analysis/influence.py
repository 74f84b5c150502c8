"""Each effect of a scene switched off, or on with a typical value: its measured cost and influence on the result."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from warp_plate.analysis.warnings import Finding, find_warnings, with_one_frequency
from warp_plate.effects.edges import Edges, ElasticEdge
from warp_plate.effects.effect import Setting
from warp_plate.effects.table import Effects, effect_type
from warp_plate.modal.solver import ModalSolver
from warp_plate.plate.designs import scene_phasors
from warp_plate.plate.signals import sample_times
from warp_plate.plate.weights import REGIONS, localization_factor, region_weights
from warp_plate.resolve import Resolved, resolve
from warp_plate.scene.drive import Drive
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import Area
from warp_plate.scene.model import WITHOUT_KEYS, Scene, SceneSource
from warp_plate.solve.solver import PlateSolver

# Rounds of timing all scenes in turn, so that a disturbance affects all of them.
ROUNDS = 7
# Plates of a timed run on CUDA; on CPU one for each thread.
CUDA_PLATES = 256


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
    findings: tuple[Finding, ...]  # numbers of the scene with their thresholds

    @property
    def warnings(self) -> tuple[str, ...]:
        """Lines that the command prints after "!"."""
        return tuple(finding.sentence for finding in self.findings if finding.exceeded)


def measure_effects(
    scene: SceneSource,
    device: str = "auto",
    on_progress: Callable[[int, int, str], object] | None = None,
    effects: Sequence[str] = (),
    rounds: int = ROUNDS,
    node_steps: float | None = None,
) -> Influence:
    """Switch each effect off or on, and measure its cost and the results under the scene's own drive.

    An effect that is off gets a typical value. If the scene's time step is too long for the alternative, the
    alternative takes its own time step. Both are stated in ``EffectToggle.alternative``. A scene that cannot be stepped
    is solved by modes, and then no cost is measured.

    Args:
        scene: A scene with a grid.
        device: Device of all runs.
        on_progress: Called with the number of finished effects, of all effects, and the name of the next.
        effects: Names of the effects (default: all, see :func:`names`).
        rounds: Rounds of timing all scenes in turn.
        node_steps: Node-steps of a timed run (default: 3e7 on CPU, 2e9 on CUDA).

    Raises:
        SceneError: see :class:`PlateSolver`; or there is no such effect.
    """
    effects, scene = effects or names(), Scene.load(scene)
    if unknown := set(effects) - set(names()):
        raise SceneError(f"{min(unknown)}: no such effect; there are {', '.join(names())}")
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
    bare_step, toggles = None, []
    if "" in stepped:
        timed = {**stepped, "bare": PlateSolver(bare_scene(scene), device)}
        seconds = seconds_a_step(timed, device, rounds, node_steps)
        bare_step = float(np.median(seconds["bare"]))
    for name, (_, text) in others.items():
        on, price, deviation, steps = is_on(scene, name), None, None, None
        if bare_step is not None and name in stepped:
            sign = 1 if on else -1
            prices = 100 * sign * (seconds[""] - seconds[name]) / bare_step
            price = float(np.median(prices))
            deviation = float(np.median(np.abs(prices - price)))
            steps = (stepped[""].specialized.scheme.steps / stepped[name].specialized.scheme.steps) ** sign
        factor, peak = results.get(name, (None, None))
        toggles.append(EffectToggle(name, on, price, deviation, steps, factor, peak, text))
    return Influence(*results[""], bare_step, tuple(toggles), tuple(find_warnings(resolved.scene, results[""][1])))


def _alternative(resolved: Resolved, name: str) -> tuple[PlateSolver | ModalSolver | None, str]:
    """Return the scene with one effect switched, and its description; or None and why it is refused."""
    other, text = toggle(resolved.scene, name)
    refusal = ""
    for update in ({}, {"time_step": None}):
        try:
            variant = other.with_keys("grid", **update).with_tables(search={}, **WITHOUT_KEYS)
            solver = resolved.with_scene(variant).solver()
        except SceneError as error:
            refusal = f"refused ({text}): {error}"
        else:
            step = solver.discretization.time_step
            return solver, text if not update else f"{text}; with its own time step of {step:.2g} s"
    return None, refusal


def seconds_a_step(
    solvers: Mapping[str, PlateSolver], device: str, rounds: int = ROUNDS, node_steps: float | None = None
) -> dict[str, np.ndarray]:
    """Return (rounds,) times of a step of one plate [s] for each solver; all solvers have the same grid.

    Runs are shortened, warmed up and timed in turn, until their energies have come back from the device.
    """
    first = next(iter(solvers.values()))
    cuda, nodes = first.device.is_cuda, math.prod(first.scene.grid.nodes)
    plate_steps = (node_steps or (2e9 if cuda else 3e7)) / nodes
    plates = max(1, min(CUDA_PLATES if cuda else first.specialized.threads, int(plate_steps / 20)))
    steps = int(max(20, plate_steps / plates))
    timed = {name: PlateSolver(_shortened(solver, steps), device) for name, solver in solvers.items()}
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
    scene, scheme = solver.scene, solver.specialized.scheme
    scene = scene.with_keys("drive", burst=None).with_keys("grid", time_step=scheme.time_step)
    if (force := scene.effects.travelling) is not None:
        middle = (scene.plate.size[0] / 2, scene.plate.size[1] / 2)
        resting = type(force)(force=1.0, start=middle)
        scene = scene.model_copy(update={"effects": scene.effects.with_travelling(resting)})
    end = min(scheme.steps, most_steps) * scheme.time_step
    return scene.with_keys("window", start=0.0, end=end)


def names() -> list[str]:
    """Return the names of all effects."""
    return ["edges", *Effects.model_fields]


def is_on(scene: Scene, name: str) -> bool:
    """Return whether a scene names an effect; "edges" if a side is free or on springs."""
    if name == "edges":
        return any(edge not in ("clamped", "supported") for _, edge in scene.edge_conditions)
    return getattr(scene.effects, name) not in (None, ())


def bare_scene(scene: Scene) -> Scene:
    """Return the scene without effects: clamped or supported edges, a tone, and a time step that suits them."""
    tables = {"effects": Effects(), "drive": Drive(frequency=scene.drive.frequency)}
    return with_one_frequency(_clamped(scene)).with_keys("grid", time_step=None).model_copy(update=tables)


def toggle(scene: Scene, name: str) -> tuple[Scene, str]:
    """Return the scene without an effect that is on, or with a typical value of one that is off, and a description."""
    on = is_on(scene, name)
    if name == "edges":
        return (_clamped(scene), "free and elastic edges clamped") if on else _springs(scene)
    value, text = Effects.model_fields[name].default, "left out"
    if not on:
        spot = scene.target.area or _middle_of_target(scene)
        setting = Setting(scene.plate, scene.drive.angular_frequency, scene.window.end, scene.actuators, spot)
        value, text = effect_type(name).typical(setting)
    return scene.with_keys("effects", **{name: value}), text


def _clamped(scene: Scene) -> Scene:
    edges = {side: edge if edge in ("clamped", "supported") else "clamped" for side, edge in scene.edges}
    return scene.model_copy(update={"edges": Edges.model_validate(edges)})


def _springs(scene: Scene) -> tuple[Scene, str]:
    side, bending = min(scene.plate.size), scene.plate.rigidity
    edge = ElasticEdge(translation=1000 * bending / side**3, rotation=10 * bending / side)
    edges = Edges(left=edge, bottom=edge, right=edge, top=edge)
    text = f"all edges on springs of {edge.translation:.2g} N/m² and {edge.rotation:.2g} N"
    return scene.model_copy(update={"edges": edges}), text + " (1000 D/L³ and 10 D/L)"


def _middle_of_target(scene: Scene) -> Area:
    """Return a square of at most a quarter of the target's area around its centroid, on the plate."""
    weights = region_weights(scene)[REGIONS.index("target")]
    (width, height), (nx, ny) = scene.plate.size, scene.grid.nodes
    x = float(weights.sum(axis=0) @ np.linspace(0, width, nx) / weights.sum())
    y = float(weights.sum(axis=1) @ np.linspace(0, height, ny) / weights.sum())
    half = min(math.sqrt(weights.sum() * width * height / (nx - 1) / (ny - 1)) / 4, x, width - x, y, height - y)
    return x - half, x + half, y - half, y + half

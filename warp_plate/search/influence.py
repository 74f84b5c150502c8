"""What each effect costs and changes in a scene, and what the scene calls for but does not name."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from warp_plate.plate.weights import localization_factor
from warp_plate.scene.effects import (
    Damping,
    Effects,
    Foundation,
    Layer,
    MaterialDamping,
    Orthotropic,
    Oscillator,
    Stretching,
    Tension,
    Variation,
)
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Edges, ElasticEdge, Scene
from warp_plate.search.simulate import scene_drive
from warp_plate.solve.solver import PlateSolver

# Displacements are looked at so many times in the run's last period: between two, a sine rises by 2 % at most.
PHASES = 16
# Rounds in which all runs are timed in turn, so that a disturbance of the machine meets all alike.
ROUNDS = 7
# Plates and node-steps of a timed run: a plate a thread on CPU, and on CUDA enough to fill it.
CUDA_PLATES = 256
TIMED_NODE_STEPS = {"cpu": 3e7, "cuda": 2e9}
# Of both kinds of damping, at the drive's frequency: that of plastics and of glued joints is of this order.
LOSS_FACTOR = 0.02
# A film that is glued on as an actuator (polyvinylidene fluoride): m, Pa, kg/m³.
FILM_THICKNESS, FILM_MODULUS, FILM_DENSITY = 110e-6, 2.5e9, 1780.0

Change = Callable[[Scene], tuple[Scene, str]]
Told = Callable[[int, int, str], object]


@dataclass(frozen=True)
class Switch:
    """One effect, and what switching it does.

    on: whether the scene names it; price: what it adds to a step of a plate, in % of a step of the bare plate
    (clamped or supported edges and no effects); spread: median distance of the timed rounds from it; steps: how many
    times as many steps the plate takes with it as without; localization_factor, peak (largest displacement in the last
    period of the run [m]): with it switched to the other state. All five are None where the other state is refused.
    switched: what the other state is, or why it is refused.
    """

    name: str
    on: bool
    price: float | None
    spread: float | None
    steps: float | None
    localization_factor: float | None
    peak: float | None
    switched: str


@dataclass(frozen=True)
class Influence:
    """localization_factor, peak [m]: of the scene as it is; bare_step: seconds a step of one bare plate; switches."""

    localization_factor: float
    peak: float
    bare_step: float
    switches: tuple[Switch, ...]


def switches(scene: Scene, device: str = "auto", told: Told | None = None) -> Influence:
    """Every effect on or off, its measured price, and the scene's own drive with it switched to the other state.

    Args:
        scene: with a grid, not an accuracy.
        told: called with (effects done, effects in all, name of the next).

    An effect that is off gets a typical value, which ``Switch.switched`` states. Where a time step that the scene
    gives is too long for the other state, that state takes its own step and says so.

    Raises:
        SceneError: see :class:`PlateSolver`.
    """
    names = _names()
    solvers = {"": PlateSolver(scene, device)}
    others: dict[str, tuple[PlateSolver | None, str]] = {}
    for index, name in enumerate(names):
        if told is not None:
            told(index, len(names), name)
        others[name] = _other(scene, name, device)
    solvers |= {name: solver for name, (solver, _) in others.items() if solver is not None}
    found = {name: _run(solver) for name, solver in solvers.items()}
    bare_step, seconds = _seconds_a_step(scene, solvers, device)
    made = []
    for name in names:
        solver, text = others[name]
        on = is_on(scene, name)
        if solver is None:
            made.append(Switch(name, on, None, None, None, None, None, text))
            continue
        sign = 1 if on else -1
        prices = 100 * sign * (seconds[""] - seconds[name]) / bare_step
        price = float(np.median(prices))
        spread = float(np.median(np.abs(prices - price)))
        ratio = solvers[""].specialized.scheme.steps / solver.specialized.scheme.steps
        made.append(Switch(name, on, price, spread, ratio**sign, *found[name], text))
    if told is not None:
        told(len(names), len(names), "")
    return Influence(*found[""], bare_step, tuple(made))


def is_on(scene: Scene, name: str) -> bool:
    """Whether a scene names an effect; "edges" are one where a side is free or on springs."""
    if name == "edges":
        return any(edge not in ("clamped", "supported") for _, edge in scene.edges)
    value = getattr(scene.effects, name)
    return value is not None and value != ()


def _names() -> list[str]:
    return ["edges", *Effects.model_fields]


def _other(scene: Scene, name: str, device: str) -> tuple[PlateSolver | None, str]:
    """The scene with one effect in the other state and what that is; or None and why it is refused."""
    on = is_on(scene, name)
    change = _without(name) if on else TYPICAL.get(name)
    if change is None:
        return None, "no typical value is known"
    other, text = change(scene)
    try:
        return PlateSolver(other, device), text
    except SceneError as refusal:
        free = other.model_copy(update={"grid": other.grid.model_copy(update={"time_step": None})})
        if other.grid.time_step is None:
            return None, f"refused ({text}): {refusal}"
        try:
            solver = PlateSolver(free, device)
        except SceneError as still:
            return None, f"refused ({text}): {still}"
        return solver, f"{text}; with its own step of {solver.specialized.scheme.time_step:.2g} s"


def _run(solver: PlateSolver) -> tuple[float, float]:
    """Localization factor under the scene's own drive, and the peak displacement [m]."""
    scene = solver.scene
    span = min(1 / scene.drive.frequency, scene.window.end)
    times = scene.window.end - span * np.arange(PHASES) / PHASES
    run = solver.run(scene_drive(scene)[None], times.tolist())
    return float(localization_factor(run.energy)[0]), float(np.abs(run.displacement).max())


def _seconds_a_step(
    scene: Scene, solvers: dict[str, PlateSolver], device: str
) -> tuple[float, dict[str, np.ndarray]]:
    """Seconds of a step of one plate: of the bare plate, and (rounds,) for each solver by name.

    Runs are shortened and warm, and a run ends only when its energies have come back from the device.
    """
    kind = "cuda" if solvers[""].device.is_cuda else "cpu"
    nodes = math.prod(scene.grid.nodes)
    plates = CUDA_PLATES if kind == "cuda" else solvers[""].specialized.threads
    plates = max(1, min(plates, int(TIMED_NODE_STEPS[kind] / nodes / 20)))
    steps = max(20, TIMED_NODE_STEPS[kind] / nodes / plates)
    timed = {name: PlateSolver(_shortened(solver, steps), device) for name, solver in solvers.items()}
    bare = bare_scene(scene)
    timed["bare"] = PlateSolver(_shortened(PlateSolver(bare, device), steps), device)
    drives = np.ones((plates, len(scene.actuators)), dtype=complex)
    seconds: dict[str, list[float]] = {name: [] for name in timed}
    for turn in range(ROUNDS + 1):  # the first one warms up
        for name, solver in timed.items():
            started = time.perf_counter()
            solver.run(drives)
            if turn:
                taken = time.perf_counter() - started
                seconds[name].append(taken / plates / solver.specialized.scheme.steps)
    return statistics.median(seconds.pop("bare")), {name: np.array(taken) for name, taken in seconds.items()}


def _shortened(solver: PlateSolver, steps: float) -> Scene:
    """Its scene with the same step, cut to so many steps where it has more."""
    scene, step = solver.scene, solver.specialized.scheme.time_step
    end = min(solver.specialized.scheme.steps, int(steps)) * step
    grid = scene.grid.model_copy(update={"time_step": step})
    window = scene.window.model_copy(update={"start": 0.0, "end": end})
    return scene.model_copy(update={"grid": grid, "window": window})


def bare_scene(scene: Scene) -> Scene:
    """The scene's plate on its grid with clamped or supported edges and without any effect, at its own step."""
    grid = scene.grid.model_copy(update={"time_step": None})
    return _clamped(scene).model_copy(update={"effects": Effects(), "grid": grid})


def _without(name: str) -> Change:
    if name == "edges":
        return lambda scene: (_clamped(scene), "its free and springy edges clamped")
    empty = Effects.model_fields[name].default
    return lambda scene: (_with(scene, name, empty), "left out")


def _with(scene: Scene, name: str, value: object) -> Scene:
    return scene.model_copy(update={"effects": scene.effects.model_copy(update={name: value})})


def _clamped(scene: Scene) -> Scene:
    held = {side: edge if edge in ("clamped", "supported") else "clamped" for side, edge in scene.edges}
    return scene.model_copy(update={"edges": Edges.model_validate(held)})


def rigidity(scene: Scene) -> float:
    """EH³/12(1 − ν²) [N·m] of the plate as such."""
    plate = scene.plate
    return plate.young_modulus * plate.thickness**3 / (12 * (1 - plate.poisson_ratio**2))


def _springs(scene: Scene) -> tuple[Scene, str]:
    side, stiff = min(scene.plate.size), rigidity(scene)
    edge = ElasticEdge(translation=1000 * stiff / side**3, rotation=10 * stiff / side)
    edges = Edges(left=edge, bottom=edge, right=edge, top=edge)
    text = f"all edges on springs of {edge.translation:.2g} N/m² and {edge.rotation:.2g} N"
    return scene.model_copy(update={"edges": edges}), text + " (1000 D/L³ and 10 D/L)"


def _damping(scene: Scene) -> tuple[Scene, str]:
    viscous = LOSS_FACTOR * scene.drive_angular_frequency * scene.plate.density * scene.plate.thickness
    return _with(scene, "damping", Damping(viscous=viscous)), f"{viscous:.2g} N·s/m³ (loss factor {LOSS_FACTOR:g})"


def _material_damping(scene: Scene) -> tuple[Scene, str]:
    retardation = LOSS_FACTOR / scene.drive_angular_frequency
    text = f"{retardation:.2g} s (loss factor {LOSS_FACTOR:g} at the drive's frequency)"
    return _with(scene, "material_damping", MaterialDamping(time=retardation)), text


def _tension(scene: Scene) -> tuple[Scene, str]:
    pull = 0.1 * math.pi**2 * rigidity(scene) / min(scene.plate.size) ** 2
    text = f"{pull:.2g} N/m along x and y (a tenth of π²D/L², which would buckle a supported strip if it pressed)"
    return _with(scene, "tension", Tension(x=pull, y=pull)), text


def _foundation(scene: Scene) -> tuple[Scene, str]:
    return _with(scene, "foundation", Foundation(stiffness=1e7)), "1e7 N/m³ (10 mm of foam of 0.1 MPa)"


def _orthotropic(scene: Scene) -> tuple[Scene, str]:
    stiff, ratio = rigidity(scene), scene.plate.poisson_ratio
    table = Orthotropic(Dx=1.1 * stiff, Dy=stiff, D1=ratio * stiff, Dxy=(1 - ratio) / 2 * stiff)
    return _with(scene, "orthotropic", table), "Dx a tenth above the isotropic plate's"


def _variation(scene: Scene) -> tuple[Scene, str]:
    return _with(scene, "variation", Variation(thickness=((0.95, 1.05),))), "thickness from 0.95 at x = 0 to 1.05"


def film(scene: Scene) -> tuple[Layer, ...]:
    """A piezoelectric film on one face under each actuator."""
    return tuple(
        Layer(area=one.area, thickness=FILM_THICKNESS, young_modulus=FILM_MODULUS, density=FILM_DENSITY)
        for one in scene.actuators
    )


def _layers(scene: Scene) -> tuple[Scene, str]:
    return _with(scene, "layers", film(scene)), "a piezoelectric film of 110 µm, 2.5 GPa, 1780 kg/m³ on each actuator"


def _oscillators(scene: Scene) -> tuple[Scene, str]:
    x0, x1, y0, y1 = scene.target.area
    half = min(5e-3, (x1 - x0) / 2, (y1 - y0) / 2)
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    finger = Oscillator(area=(x - half, x + half, y - half, y + half), mass=5e-3, stiffness=500.0, damping=2.0)
    text = "a fingertip in the target's middle: 5 g, 500 N/m, 2 N·s/m (orders of magnitude of a light touch)"
    return _with(scene, "oscillators", (finger,)), text


TYPICAL: dict[str, Change] = {
    "edges": _springs,
    "damping": _damping,
    "material_damping": _material_damping,
    "tension": _tension,
    "foundation": _foundation,
    "orthotropic": _orthotropic,
    "variation": _variation,
    "layers": _layers,
    "oscillators": _oscillators,
    "stretching": lambda scene: (_with(scene, "stretching", Stretching()), "named"),
}

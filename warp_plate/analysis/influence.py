"""What each effect costs and changes in a scene."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from warp_plate.analysis.effect_toggles import TYPICAL_CHANGES, bare_scene, is_on, names, with_value, without
from warp_plate.plate.scene_overrides import scene_phasors
from warp_plate.plate.weights import localization_factor
from warp_plate.scene.effects import MovingLoad
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.peak import peak_of, sample_times
from warp_plate.solve.solver import PlateSolver

# The name of the bare plate among the timed ones.
BARE = "bare"
# Rounds in which all runs are timed in turn, so that a disturbance of the machine meets all alike.
ROUNDS = 7
# Plates and node-steps of a timed run: a plate a thread on CPU, and on CUDA enough to fill it.
CUDA_PLATES = 256
TIMED_NODE_STEPS = {"cpu": 3e7, "cuda": 2e9}

Told = Callable[[int, int, str], object]


@dataclass(frozen=True)
class EffectToggle:
    """One effect, and what switching it does.

    on: whether the scene names it; price: what it adds to a step of a plate, in % of a step of the bare plate
    (clamped or supported edges and no effects); spread: median distance of the timed rounds from it; steps: how many
    times as many steps the plate takes with it as without; localization_factor, peak (largest displacement seen over
    the run [m]): with it switched to the other state. All five are None where the other state is refused.
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
    switches: tuple[EffectToggle, ...]


def measure_influence(scene: Scene, device: str = "auto", told: Told | None = None) -> Influence:
    """Every effect on or off, its measured price, and the scene's own drive with it switched to the other state.

    Args:
        scene: with a grid, not an accuracy.
        told: called with (effects done, effects in all, name of the next).

    An effect that is off gets a typical value, which ``EffectToggle.switched`` states. Where a time step that the scene
    gives is too long for the other state, that state takes its own step and says so.

    Raises:
        SceneError: see :class:`PlateSolver`.
    """
    effects = names()
    solvers = {"": PlateSolver(scene, device)}
    others: dict[str, tuple[PlateSolver | None, str]] = {}
    for index, name in enumerate(effects):
        if told is not None:
            told(index, len(effects), name)
        others[name] = _other(scene, name, device)
    solvers |= {name: solver for name, (solver, _) in others.items() if solver is not None}
    found = {name: _run(solver) for name, solver in solvers.items()}
    seconds = seconds_a_step({**solvers, BARE: PlateSolver(bare_scene(scene), device)}, device)
    bare_step = float(np.median(seconds[BARE]))
    made = []
    for name in effects:
        solver, text = others[name]
        on = is_on(scene, name)
        if solver is None:
            made.append(EffectToggle(name, on, None, None, None, None, None, text))
            continue
        sign = 1 if on else -1
        prices = 100 * sign * (seconds[""] - seconds[name]) / bare_step
        price = float(np.median(prices))
        spread = float(np.median(np.abs(prices - price)))
        ratio = solvers[""].specialized.scheme.steps / solver.specialized.scheme.steps
        made.append(EffectToggle(name, on, price, spread, ratio**sign, *found[name], text))
    if told is not None:
        told(len(effects), len(effects), "")
    return Influence(*found[""], bare_step, tuple(made))


def _other(scene: Scene, name: str, device: str) -> tuple[PlateSolver | None, str]:
    """The scene with one effect in the other state and what that is; or None and why it is refused."""
    on = is_on(scene, name)
    change = without(name) if on else TYPICAL_CHANGES.get(name)
    if change is None:
        return None, "no typical value is known"
    try:
        other, text = change(scene)
    except SceneError as refusal:
        return None, f"refused: {refusal}"
    try:
        return PlateSolver(other.with_tables(), device), text
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
    run = solver.run(scene_phasors(scene)[None], sample_times(scene))
    return float(localization_factor(run.energy)[0]), peak_of(run.displacement)


def seconds_a_step(solvers: Mapping[str, PlateSolver], device: str, rounds: int = ROUNDS) -> dict[str, np.ndarray]:
    """(rounds,) seconds of a step of one plate for each solver by name; all have one grid.

    Runs are shortened and warm, in turn, and a run ends only when its energies have come back from the device.
    """
    first = next(iter(solvers.values()))
    kind = "cuda" if first.device.is_cuda else "cpu"
    nodes = math.prod(first.scene.grid.nodes)
    plates = CUDA_PLATES if kind == "cuda" else first.specialized.threads
    plates = max(1, min(plates, int(TIMED_NODE_STEPS[kind] / nodes / 20)))
    steps = max(20, TIMED_NODE_STEPS[kind] / nodes / plates)
    timed = {name: PlateSolver(_shortened(solver, steps), device) for name, solver in solvers.items()}
    drives = np.ones((plates, len(first.scene.actuators)), dtype=complex)
    seconds: dict[str, list[float]] = {name: [] for name in timed}
    for turn in range(rounds + 1):  # the first one warms up
        for name, solver in timed.items():
            started = time.perf_counter()
            solver.run(drives)
            if turn:
                taken = time.perf_counter() - started
                seconds[name].append(taken / plates / solver.specialized.scheme.steps)
    return {name: np.array(taken) for name, taken in seconds.items()}


def _shortened(solver: PlateSolver, steps: float) -> Scene:
    """Its scene with the same step, cut to so many steps where it has more; what comes later acts at once."""
    scene, step = solver.scene, solver.specialized.scheme.time_step
    end = min(solver.specialized.scheme.steps, int(steps)) * step
    grid = scene.grid.model_copy(update={"time_step": step})
    window = scene.window.model_copy(update={"start": 0.0, "end": end})
    if scene.effects.moving_load is not None:
        middle = (scene.plate.size[0] / 2, scene.plate.size[1] / 2)
        scene = with_value(scene, "moving_load", MovingLoad(force=1.0, start=middle))
    return with_value(scene, "burst", None).model_copy(update={"grid": grid, "window": window})

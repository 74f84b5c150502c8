"""Measured cost of each effect, and its influence on the result of a scene."""

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

# Rounds in which all scenes are timed in turn, so that a disturbance affects all alike.
ROUNDS = 7
# Plates of a timed run on CUDA, on CPU one for each thread; node-steps of a timed run.
CUDA_PLATES, TIMED_NODE_STEPS = 256, {"cpu": 3e7, "cuda": 2e9}


@dataclass(frozen=True)
class EffectToggle:
    """An effect, and the result of switching it off or on; None where the alternative is refused."""

    name: str  # key of the effect
    on: bool  # True if the scene names the effect
    price: float | None  # time that it adds to a step, in % of a step of the bare plate
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
    bare_step: float  # time of a step of a plate without effects, with clamped or supported edges [s]
    toggles: tuple[EffectToggle, ...]  # one for each effect


def measure_influence(
    scene: Scene, device: str = "auto", on_progress: Callable[[int, int, str], object] | None = None
) -> Influence:
    """Switch each effect off or on, and measure its cost and the results under the scene's own drive.

    An effect that is off gets a typical value. If the scene's time step is too long for the alternative, the
    alternative takes its own time step. Both are stated in ``EffectToggle.alternative``.

    Args:
        scene: A scene with a grid.
        device: Device of all runs.
        on_progress: Called with the number of finished effects, of all effects, and the name of the next.

    Raises:
        SceneError: see :class:`PlateSolver`.
    """
    effects = names()
    base = PlateSolver(scene, device)
    others: dict[str, tuple[PlateSolver | None, str]] = {}
    for index, name in enumerate(effects):
        if on_progress is not None:
            on_progress(index, len(effects), name)
        others[name] = _alternative(scene, name, device)
    solvers = {"": base} | {name: solver for name, (solver, _) in others.items() if solver is not None}
    results = {name: _run(solver) for name, solver in solvers.items()}
    seconds = seconds_a_step({**solvers, "bare": PlateSolver(bare_scene(scene), device)}, device, ROUNDS)
    bare_step = float(np.median(seconds["bare"]))
    toggles = []
    for name, (solver, text) in others.items():
        on = is_on(scene, name)
        if solver is None:
            toggles.append(EffectToggle(name, on, None, None, None, None, None, text))
            continue
        sign = 1 if on else -1
        prices = 100 * sign * (seconds[""] - seconds[name]) / bare_step
        price = float(np.median(prices))
        deviation = float(np.median(np.abs(prices - price)))
        ratio = base.specialized.scheme.steps / solver.specialized.scheme.steps
        toggles.append(EffectToggle(name, on, price, deviation, ratio**sign, *results[name], text))
    if on_progress is not None:
        on_progress(len(effects), len(effects), "")
    return Influence(*results[""], bare_step, tuple(toggles))


def _alternative(scene: Scene, name: str, device: str) -> tuple[PlateSolver | None, str]:
    """Return the scene with one effect switched, and its description; or None and why it is refused."""
    change = without(name) if is_on(scene, name) else TYPICAL_CHANGES.get(name)
    if change is None:
        return None, "no typical value is known"
    try:
        other, text = change(scene)
    except SceneError as error:
        return None, f"refused: {error}"
    try:
        return PlateSolver(other.with_tables(), device), text
    except SceneError as error:
        if other.grid.time_step is None:
            return None, f"refused ({text}): {error}"
    grid = other.grid.model_copy(update={"time_step": None})
    try:
        solver = PlateSolver(other.model_copy(update={"grid": grid}), device)
    except SceneError as error:
        return None, f"refused ({text}): {error}"
    return solver, f"{text}; with its own time step of {solver.specialized.scheme.time_step:.2g} s"


def _run(solver: PlateSolver) -> tuple[float, float]:
    """Return the localization factor under the scene's own drive, and the peak displacement [m]."""
    scene = solver.scene
    run = solver.run(scene_phasors(scene)[None], sample_times(scene))
    return float(localization_factor(run.energy)[0]), peak_of(run.displacement)


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


def _shortened(solver: PlateSolver, steps: float) -> Scene:
    """Return the solver's scene cut to at most this number of steps, with all loads acting from the start."""
    scene, step = solver.scene, solver.specialized.scheme.time_step
    end = min(solver.specialized.scheme.steps, int(steps)) * step
    if scene.effects.moving_load is not None:
        middle = (scene.plate.size[0] / 2, scene.plate.size[1] / 2)
        scene = with_value(scene, "moving_load", MovingLoad(force=1.0, start=middle))
    update = {
        "grid": scene.grid.model_copy(update={"time_step": step}),
        "window": scene.window.model_copy(update={"start": 0.0, "end": end}),
    }
    return with_value(scene, "burst", None).model_copy(update=update)

"""The cheapest grid, order and time step that keep an error, for one scene on one device."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from warp_plate.accuracy.configurations import Configuration, Order, highest_order, scene_with
from warp_plate.accuracy.formatting import percent, seconds_text, two_digits
from warp_plate.accuracy.grid_search import CLOSE_ENOUGH, MOST_NODE_STEPS, TRIALS, Aim, confirmed, finer
from warp_plate.accuracy.reference_solution import ReferenceSolution, find_reference_solution
from warp_plate.accuracy.trial_runs import PATH, TrialRun, cost_of_run
from warp_plate.reference.forced import bound, localization_factors
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import find_device
from warp_plate.solve.response import measure_response
from warp_plate.solve.solver import PlateSolver

# The error that is looked for, as part of the one asked for: the rest is for rounding, which differs between paths.
AIM = 0.9
# The reference's own error, as part of the one asked for, and the time that it may take [s].
REFERENCE_SHARE, REFERENCE_SECONDS = 0.15, 30.0
# Below this error the rounding of float32 may matter, and float64 is tried as well.
FLOAT64_BELOW = 2e-3
# Plates that are timed on a CUDA device, and the seconds after which timing ends.
CUDA_PLATES, TIMING_SECONDS = 256, 0.2


@dataclass(frozen=True)
class GridChoice:
    """scene: with a grid of its own and no ``accuracy``; asked: relative error; error: estimated, the largest of
    the drives asked for, equal drive, best single actuator, best drive and bound; seconds: of a plate, where several
    run at once; reason: a sentence; truth: what the error was measured against.
    """

    scene: Scene
    asked: float
    error: float
    seconds: float
    reason: str
    reference: ReferenceSolution


def choose(scene: Scene, accuracy: float, device: str = "auto", drives: np.ndarray | None = None) -> GridChoice:
    """The cheapest configuration whose localization factors are right to ``accuracy`` (relative).

    The scene's own grid plays no part; its damping is taken centred in time. Grids of each order are tried against the
    reference solution with equal drive, the best single actuator, the best drive and ``drives`` (drives, actuators),
    and the one that is left is checked with the Gram matrices of all drives.

    Raises:
        SceneError: no configuration within reach keeps this accuracy; no such device.
    """
    find_device(device)
    truth = find_reference_solution(scene, "auto", device, REFERENCE_SHARE * accuracy, REFERENCE_SECONDS, drives)
    if not truth.uncertainty <= accuracy / 2:
        possible = truth.uncertainty < 0.2
        advice = f"ask for {_rounded_up(2 * truth.uncertainty):g} or more" if possible else "write a grid instead"
        raise SceneError(
            f"accuracy = {accuracy:g}: the reference solution of this scene is known to {truth.uncertainty:.2g} only; "
            f"{advice}"
        )
    aim = Aim(scene, truth, AIM * accuracy - truth.uncertainty, device, drives)
    found = _candidates(aim)
    kept = [trial for trial in found.values() if trial.error <= aim.error]
    chosen = min(kept, key=lambda trial: trial.cost) if kept else None
    configuration, error = _checked(aim, chosen) if chosen else (None, math.inf)
    if chosen is None or configuration is None or error > AIM * accuracy:
        nearest = min(found.values(), key=lambda trial: trial.error)
        raise SceneError(
            f"accuracy = {accuracy:g}: out of reach for this scene: with {nearest.configuration} the error is "
            f"{nearest.error:.2g}, and grids above {MOST_NODE_STEPS:.0e} node-steps a plate are not tried; ask for more"
        )
    resolved = scene_with(scene, configuration)
    seconds = _seconds_a_plate(resolved, device)
    others = _others(aim, found, configuration)
    text = (
        f"{percent(accuracy)}: {configuration.nodes[0]} × {configuration.nodes[1]} nodes, order {configuration.order}, "
        f"{configuration.load}, Δt = {configuration.time_step:.2g} s, {configuration.precision}: estimated error "
        f"{percent(error)}, {seconds_text(seconds)} a plate{others}"
    )
    return GridChoice(resolved, accuracy, error, seconds, text, truth)


def _candidates(aim: Aim) -> dict[Order, TrialRun]:
    """The cheapest of each order; of second order, only as far as it may be the cheaper one."""
    side, ceiling = aim.first_side(), math.inf
    orders: tuple[Order, ...] = (4, 2) if highest_order(aim.scene) == 4 else (2,)
    found: dict[Order, TrialRun] = {}
    for order in orders:
        trial = confirmed(aim, order, "float32", side, ceiling)
        if trial.error > aim.error and aim.error < FLOAT64_BELOW and order == orders[0]:
            exact = confirmed(aim, order, "float64", side, ceiling)
            trial = exact if exact.error < trial.error else trial
        found[order] = trial
        if trial.error <= aim.error:
            side, ceiling = math.sqrt(math.prod(trial.configuration.nodes)), trial.cost
    return found


def _checked(aim: Aim, trial: TrialRun) -> tuple[Configuration, float]:
    """The configuration, made finer where the bound asks for it, and the largest error of all four numbers."""
    truth, configuration = aim.truth, trial.configuration
    drives = aim.drives()
    right = np.append(localization_factors(truth.matrices, drives), truth.bound)
    allowed = aim.error + truth.uncertainty
    error = math.inf
    for _ in range(TRIALS):
        # The matrices are differences of energies, which float32 would round away.
        solver = PlateSolver(scene_with(aim.scene, replace(configuration, precision="float64")), aim.device, PATH)
        matrices = measure_response(solver).matrices
        found = np.append(localization_factors(matrices, drives), bound(matrices)[0])
        error = max(float(np.abs(found / right - 1).max()), trial.error) + truth.uncertainty
        if error <= allowed:
            break
        configuration = finer(aim.scene, configuration, CLOSE_ENOUGH)
        trial = aim.attempt(configuration)
    return configuration, error


def _seconds_a_plate(scene: Scene, device: str) -> float:
    """Of several plates at once, after one run to warm up."""
    solver = PlateSolver(scene, device, PATH)
    plates = CUDA_PLATES if solver.device.is_cuda else 4 * solver.specialized.threads
    drives = np.ones((plates, len(scene.actuators)), dtype=complex)
    solver.run(drives[:1])
    taken: list[float] = []
    while len(taken) < 3 and sum(taken) < TIMING_SECONDS:
        started = time.perf_counter()
        solver.run(drives)
        taken.append(time.perf_counter() - started)
    return min(taken) / plates


def _others(aim: Aim, found: dict[Order, TrialRun], chosen: Configuration) -> str:
    """What the orders that were not chosen would take."""
    text = ""
    for order, trial in found.items():
        if order != chosen.order and math.isfinite(trial.error):
            needed = aim.needed(trial)
            times = cost_of_run(aim.scene, needed) / cost_of_run(aim.scene, chosen)
            text += f"; order {order} would need about {needed.nodes[0]} × {needed.nodes[1]} and {two_digits(times)} "
            text += "times as long"
    return text


def _rounded_up(value: float) -> float:
    """To two digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / unit) * unit

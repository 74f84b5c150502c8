"""Choose the places of sensors and the actuator that best determine the free keys of a fit.

With J_c the derivatives of H at candidate c with respect to the free numbers, divided by the noise of H, the sensors S
of a D-optimal plan maximise

    log det(P + Σ_{c ∈ S} Re J_cᴴ J_c)

where P is the prior information from the ranges of the free keys. Sensors are added one by one, each the best of all
candidates, and then exchanged while that helps (Fedorov, Theory of Optimal Experiments, 1972).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warp_plate.fitting.fitted_panel import FreeNumbers, free_numbers
from warp_plate.fitting.panel_responses import MOST_MODES, undamped_error
from warp_plate.modal.continuous_modes import linear_part
from warp_plate.modal.modes import solve_modes
from warp_plate.result.frequency_response import DERIVATIVES
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene, SceneSource

# Candidates along the longer side, in the middles of equal cells; frequencies; modes that the default range holds.
ALONG, FREQUENCIES, MODES = 14, 400, 8
# Difference of fractions of the ranges, and noise of responses that vanish, relative to the mean over the candidates.
STEP, FLOOR = 1e-3, 0.1
# A number that is evenly distributed over its range has this variance, of a range of 1.
EVEN = 1 / 12
# Rounds of exchanges; a few are enough.
ROUNDS = 50
# Half-width of 95 % intervals in standard deviations; sets of random places that a plan is compared with.
NORMAL, RANDOM = 1.96, 100


@dataclass(frozen=True, eq=False)
class MeasurementPlan:
    """Places of sensors, and the expected intervals of a fit to their measurements."""

    scene: Scene  # the scene with a table ``[[measurement]]`` for each sensor
    actuator: str  # name of the actuator to drive
    points: np.ndarray  # (sensors, 2) x, y of the sensors [m], the most informative first
    frequencies: np.ndarray  # (n,) frequencies [Hz] of the plan
    keys: tuple[str, ...]  # (p,) keys of the free numbers
    values: np.ndarray  # (p,) their values in the scene
    low: np.ndarray  # (p,) lower ends of the 95 % intervals that are expected; those of the range if nothing is learnt
    high: np.ndarray  # (p,) upper ends
    # how many times as wide the intervals would be with sensors at random places and the same actuator: the geometric
    # mean over the free numbers, the median over sets of places
    random: float
    actuators: dict[str, float]  # factor on the widths with each other actuator and its best places, by name


def plan_measurement(scene: SceneSource, sensors: int = 4, noise: float = 0.02) -> MeasurementPlan:
    """Return the places of sensors and the actuator that best determine the keys of ``[fit.free]``.

    Args:
        scene: Linear scene with ``[fit.free]``; the plan is for its values, at frequencies of ``fit.range`` or from
            half the lowest natural frequency to the eighth.
        sensors: Number of accelerometers.
        noise: Standard deviation of responses, relative to each.

    Raises:
        SceneError: The scene has no ``[fit.free]``, a free key is a sensor's, the panel has no damping, or there are
            too many sensors.
    """
    scene = Scene.load(scene)
    free = free_numbers(scene)
    if taken := [key for key in free.keys if key.startswith("measurement")]:
        raise SceneError(f"fit.free: {taken[0]}: is of a sensor, whose place is sought; leave it out of a plan")
    candidates = _candidates(scene)
    if not 1 <= sensors <= len(candidates):
        raise SceneError(f"sensors = {sensors}: must be from 1 to {len(candidates)}")
    low, high = (scene.fit and scene.fit.range) or _default_range(scene)
    frequencies = np.linspace(low, high, FREQUENCIES)
    information = _information(free, frequencies, candidates, noise)
    chosen = [choose_places(candidate, sensors) for candidate in information]
    sizes = [_log_size(gain[rows].sum(axis=0)) for gain, rows in zip(information, chosen, strict=True)]
    best = int(np.argmax(sizes))
    relative = 1 / (2 * len(free.keys))  # of a log determinant, in logarithms of the mean width of an interval
    drawn = np.random.default_rng(0).random((RANDOM, len(candidates))).argsort(axis=1)[:, :sensors]
    random = np.median([_log_size(information[best][rows].sum(axis=0)) for rows in drawn])
    names = [actuator.name for actuator in scene.actuators]
    points, start = candidates[chosen[best]], free.starts(2, 0)[0]
    width = NORMAL * np.sqrt(np.diag(np.linalg.inv(_with_ranges(information[best][chosen[best]].sum(axis=0)))))
    rows = [{"actuator": names[best], "point": (float(x), float(y))} for x, y in points]
    return MeasurementPlan(
        scene=scene.with_tables(measurement=rows),
        actuator=names[best],
        points=points,
        frequencies=frequencies,
        keys=free.keys,
        values=free.values(start),
        low=free.values(np.maximum(start - width, 0)),
        high=free.values(np.minimum(start + width, 1)),
        random=float(np.exp(relative * (sizes[best] - random))),
        actuators={
            names[i]: float(np.exp(relative * (sizes[best] - sizes[i]))) for i in range(len(names)) if i != best
        },
    )


def choose_places(information: np.ndarray, count: int) -> list[int]:
    """Return the indices of places that maximise the determinant of the information (places, p, p), by exchanges."""
    chosen: list[int] = []
    for _ in range(count):
        chosen.append(_best_addition(information, chosen))
    for _ in range(ROUNDS):
        before = sorted(chosen)
        for _ in range(count):  # the first leaves, and the best of all comes last
            chosen = [*chosen[1:], _best_addition(information, chosen[1:])]
        if sorted(chosen) == before:
            break
    return chosen


def _best_addition(information: np.ndarray, chosen: list[int]) -> int:
    """Return the place that adds most to those that are chosen."""
    sizes = np.linalg.slogdet(_with_ranges(information + information[chosen].sum(axis=0)))[1]
    sizes[chosen] = -np.inf
    return int(np.argmax(sizes))


def _with_ranges(information: np.ndarray) -> np.ndarray:
    """Add the prior information from the ranges of the free keys."""
    return np.asarray(information + np.eye(information.shape[-1]) / EVEN)


def _log_size(information: np.ndarray) -> float:
    return float(np.linalg.slogdet(_with_ranges(information))[1])


def _candidates(scene: Scene) -> np.ndarray:
    """Return (candidates, 2) points [m]."""
    size = np.array(scene.plate.size)
    counts = np.maximum(2, np.rint(ALONG * size / size.max())).astype(int)
    x, y = ((np.arange(count) + 0.5) * side / count for count, side in zip(counts, size, strict=True))
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def _default_range(scene: Scene) -> tuple[float, float]:
    natural = solve_modes(linear_part(scene), highest=0.0, count=MODES + 3).frequencies
    natural = natural[natural > 0][:MODES]
    return float(natural[0] / 2), float(natural[-1])


def _information(free: FreeNumbers, frequencies: np.ndarray, candidates: np.ndarray, noise: float) -> np.ndarray:
    """Return (actuators, candidates, p, p) information about fractions of the ranges."""
    start = free.starts(2, 0)[0]
    responses = _responses(free.scene_at(start), frequencies, candidates)
    slopes = []
    for step in STEP * np.eye(len(start)):
        above, below = np.minimum(start + step, 1), np.maximum(start - step, 0)
        change = _responses(free.scene_at(above), frequencies, candidates)
        change -= _responses(free.scene_at(below), frequencies, candidates)
        slopes.append(change / np.sum(above - below))
    mean = np.mean(np.abs(responses) ** 2, axis=1, keepdims=True)
    deviation = noise * np.sqrt(np.abs(responses) ** 2 + FLOOR**2 * mean)
    scaled = np.stack(slopes, axis=-1) / deviation[..., None]
    # Noise of a complex number has half its variance in each part.
    return 2 * np.einsum("acfi,acfj->acij", scaled.conj(), scaled, optimize=True).real


def _responses(scene: Scene, frequencies: np.ndarray, candidates: np.ndarray) -> np.ndarray:
    """Return (actuators, candidates, n) accelerances."""
    plate = solve_modes(linear_part(scene), frequencies[-1], most=MOST_MODES, key=f"fit.range: {frequencies[-1]:g} Hz")
    if not plate.loss_factors.any():
        raise undamped_error()
    forces = plate.actuator_forces() / [(x1 - x0) * (y1 - y0) for x0, x1, y0, y1 in (a.area for a in scene.actuators)]
    amplitudes = plate.respond(frequencies, forces)
    factor = (2j * np.pi * frequencies) ** DERIVATIVES["accelerance"]
    return np.asarray(factor * np.einsum("fma,mc->acf", amplitudes, plate.at_points(candidates), optimize=True))

"""Impulse responses between actuators or points and points, exact in time.

An impulse of 1 N·s at t = 0 moves the plate by Σ_p ψ_p (χ_p f) exp(s_p t), f the modal forces of 1 N; see
:mod:`warp_plate.modal.poles`. Only modes up to a highest frequency take part, for a plate has modes without end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warp_plate.modal.modes import modes_below
from warp_plate.result.frequency_response import DERIVATIVES, Quantity
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene, SceneSource
from warp_plate.studies.frequency_response import (
    Point,
    check_linear,
    check_on_plate,
    default_range,
    input_forces,
    target_middles,
)

UNITS = {"receptance": "m/(N·s)", "mobility": "(m/s)/(N·s)"}
MOST_NUMBERS = 2**24
# Numbers of an array of poles and times, to limit memory.
BLOCK = 2**20


@dataclass(frozen=True, eq=False)
class ImpulseResponse:
    """Responses of points to impulses of 1 N·s at t = 0.

    Attributes:
        unit: Unit of the responses.
        labels: Names of the pairs, such as "left → 0.1,0.05", the points of the first input first.
        times: (times,) times from 0 on [s].
        responses: (inputs, points, times) responses.
        highest: Natural frequency up to which modes take part [Hz].
        modes: Number of these modes.
    """

    unit: str
    labels: list[str]
    times: np.ndarray
    responses: np.ndarray
    highest: float
    modes: int


def compute_impulse_response(
    scene: SceneSource,
    inputs: Sequence[str | Point] = (),
    points: Sequence[Point] = (),
    duration: float = 0.05,
    rate: int = 48000,
    highest: float | None = None,
    quantity: Quantity = "mobility",
) -> ImpulseResponse:
    """Return the responses of points to impulses of 1 N·s.

    Args:
        scene: Linear scene without a loss factor; its grid, window and drive are not used.
        inputs: Names of actuators, over which an impulse is spread evenly, and points (x, y) [m] (default: all
            actuators).
        points: Points (x, y) [m] that respond (default: ``record.points``, or the middles of the targets).
        duration: Duration [s].
        rate: Samples a second.
        highest: Natural frequency up to which modes take part [Hz] (default: that of frequency responses).
        quantity: "receptance" for displacements, "mobility" for velocities.

    Raises:
        SceneError: The scene has no impulse responses, an input or point is not on it, or a number is out of range.
    """
    scene = Scene.load(scene)
    inputs = inputs or [actuator.name for actuator in scene.actuators]
    points = points or scene.record.points or target_middles(scene)
    highest = default_range(scene)[1] if highest is None else highest
    check_linear(scene, (highest / 2, highest))
    check_on_plate(scene, [*points, *inputs])
    _check(scene, quantity, duration, rate, MOST_NUMBERS // (len(inputs) * len(points)))
    plate = modes_below(scene, highest)
    poles, times = plate.poles(duration), np.arange(math.ceil(duration * rate)) / rate
    shapes = poles.observe(plate.at_points(points).T) * poles.values ** DERIVATIVES[quantity]
    pairs = (poles.gains(input_forces(plate, inputs)[1]).T[:, None] * shapes).reshape(-1, poles.values.size)
    blocks = np.array_split(times, math.ceil(times.size * poles.values.size / BLOCK))
    responses = np.hstack([(pairs @ np.exp(poles.values[:, None] * block)).real for block in blocks])
    names = [name if isinstance(name, str) else f"{name[0]:g},{name[1]:g}" for name in inputs]
    return ImpulseResponse(
        unit=UNITS[quantity],
        labels=[f"{name} → {x:g},{y:g}" for name in names for x, y in points],
        times=times,
        responses=responses.reshape(len(inputs), len(points), -1),
        highest=highest,
        modes=plate.frequencies.size,
    )


def _check(scene: Scene, quantity: Quantity, duration: float, rate: int, most: int) -> None:
    if quantity not in UNITS:
        raise SceneError(f"quantity {quantity}: an impulse has no sampled acceleration; take receptance or mobility")
    if scene.steady:
        raise SceneError(f"{scene.steady_key}: has no motion in time, so no impulse response; take viscous damping")
    if not 1 <= duration * rate <= most:
        raise SceneError(
            f"impulse {duration:g} s at {rate:g} samples a second: must be 1 to {most} samples for as many responses"
        )

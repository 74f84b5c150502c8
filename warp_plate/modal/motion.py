"""Displacement of a plate under its scene's drive, at points and over the plate: from rest, or steady.

Steady motion is that of scenes with a loss factor, see ``Scene.steady``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from warp_plate.modal.loads import envelopes
from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.poles import make_poles, poles_apart
from warp_plate.modal.transient import motion_from_rest
from warp_plate.plate.signals import actuator_delays, actuator_frequencies


def trace(
    plate: ModalPlate, drives: np.ndarray, points: Sequence[tuple[float, float]] | np.ndarray, times: np.ndarray
) -> np.ndarray:
    """Return (drives, points, times) displacement [m] at points (x, y) [m] and times from 0 on [s].

    Args:
        plate: Modes.
        drives: (drives, actuators) phasors Z [N/m²].
        points: Points (x, y) [m].
        times: Times [s].
    """
    motion = unit_motion(plate, plate.at_points(points).T, np.asarray(times, dtype=float))
    return np.asarray(np.einsum("da,oat->dot", drives, motion, optimize=True).real)


def fields(plate: ModalPlate, drives: np.ndarray, times: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return (drives, times, ny, nx) displacement [m] on the grid of x and y [m]; see :func:`trace`."""
    motion = unit_motion(plate, np.eye(len(plate.frequencies)), np.asarray(times, dtype=float))
    amplitudes = np.einsum("da,rat->dtr", drives, motion, optimize=True).real
    return np.asarray(np.tensordot(amplitudes, plate.shapes(x, y), axes=1))


def unit_motion(plate: ModalPlate, outputs: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return (outputs, actuators, times) complex displacements of ``outputs`` (outputs, modes) under unit phasors."""
    scene, forces = plate.scene, plate.actuator_forces()
    frequency = actuator_frequencies(scene)
    if scene.steady:
        columns = [plate.respond(frequency[[k]], forces[:, [k]])[0, :, 0] for k in range(frequency.size)]
        turns = np.exp(2j * math.pi * frequency[:, None] * times)
        return np.asarray((outputs @ np.stack(columns, axis=1))[:, :, None] * turns)
    order = np.argsort(times, kind="stable")
    end = max(float(times.max(initial=0.0)), scene.window.end)
    starts = envelopes(scene.drive.burst, actuator_delays(scene), end)
    loads = [envelope.times_tones(frequency) for envelope in starts]
    poles = poles_apart(make_poles(plate, end), np.concatenate([load.rates.ravel() for load in loads]), end)
    motion = motion_from_rest(poles, poles.inputs @ forces, loads, outputs @ poles.vectors, times[order])
    return motion[:, :, np.argsort(order, kind="stable")]

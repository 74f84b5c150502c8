"""Displacement of a plate under its scene's drive, at points and over the plate: from rest, or steady.

Steady motion is that of scenes with a loss factor, see ``Scene.steady``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warp_plate.modal.loads import ExponentialLoads, exponential_loads, has_exponential_loads
from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.poles import Poles
from warp_plate.modal.sampled import SampledLoads, moving_loads, sampled_loads
from warp_plate.modal.transient import motion_from_rest, motion_of_samples
from warp_plate.plate.signals import actuator_delays, actuator_frequencies
from warp_plate.scene.model import Scene


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
    return np.asarray(np.einsum("da,oat->dot", with_moving_load(plate, drives), motion, optimize=True).real)


def fields(plate: ModalPlate, drives: np.ndarray, times: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return (drives, times, ny, nx) displacement [m] on the grid of x and y [m]; see :func:`trace`."""
    return plate.displacement(modal_amplitudes(plate, drives, times), x, y)


def modal_amplitudes(plate: ModalPlate, drives: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return (drives, times, modes) amplitudes of the modes at times [s]; see :func:`trace`."""
    motion = unit_motion(plate, np.eye(len(plate.frequencies)), np.asarray(times, dtype=float))
    return np.asarray(np.einsum("da,rat->dtr", with_moving_load(plate, drives), motion, optimize=True).real)


def unit_motion(plate: ModalPlate, outputs: np.ndarray, times: np.ndarray, velocity: bool = False) -> np.ndarray:
    """Return complex displacements under unit phasors.

    Args:
        plate: Modes.
        outputs: (outputs, modes) numbers that make outputs of modal amplitudes.
        times: (times,) times from 0 on [s].
        velocity: Return velocities instead.

    Returns:
        (outputs, actuators, times); a moving load, if there is one, follows the actuators.
    """
    if plate.scene.steady:
        return _steady_motion(plate, outputs, times, velocity)
    end = max(float(times.max(initial=0.0)), plate.scene.window.end)
    return make_excitation(plate, end).motion(outputs, times, velocity)


@dataclass(frozen=True)
class Excitation:
    """Loads of a plate that begins at rest, and how they excite its poles.

    Attributes:
        poles: Poles, apart from the exponents of the loads.
        gains: (poles, actuators) inputs of the actuators' unit pressures.
        loads: Unit loads of the actuators in time.
        moving: Inputs of a moving load in time; empty if there is none.
    """

    poles: Poles
    gains: np.ndarray
    loads: Sequence[ExponentialLoads] | Sequence[SampledLoads]
    moving: Sequence[SampledLoads]

    def motion(self, outputs: np.ndarray, times: np.ndarray, velocity: bool = False) -> np.ndarray:
        """Return (outputs, actuators, times), see :func:`unit_motion`."""
        order = np.argsort(times, kind="stable")
        poles, rising = self.poles, times[order]
        shapes = poles.observe(outputs) * (poles.values if velocity else 1)
        exponential = [load for load in self.loads if isinstance(load, ExponentialLoads)]
        sampled = [load for load in self.loads if isinstance(load, SampledLoads)]
        if exponential:
            motion = motion_from_rest(poles, self.gains, exponential, shapes, rising)
        else:
            motion = motion_of_samples(poles, self.gains, sampled, shapes, rising)
        if self.moving:
            one = np.ones((poles.values.size, 1))
            motion = np.concatenate([motion, motion_of_samples(poles, one, self.moving, shapes, rising)], axis=1)
        return motion[:, :, np.argsort(order, kind="stable")]

    def restrict(self, modes: np.ndarray) -> Excitation:
        """Return the excitation without the poles that move none of some modes; the same where damping couples them."""
        if self.poles.modes is None:
            return self
        kept = np.flatnonzero(np.isin(self.poles.modes, modes))
        moving = [load.part(kept) for load in self.moving]
        return Excitation(self.poles.part(kept), self.gains[kept], self.loads, moving)


def make_excitation(
    plate: ModalPlate,
    end: float,
    forces: np.ndarray | None = None,
    frequency: np.ndarray | None = None,
    delay: np.ndarray | None = None,
) -> Excitation:
    """Return the excitation of a plate from t = 0 to ``end`` [s].

    Args:
        plate: Modes.
        end: End of the run [s].
        forces: (modes, actuators) modal forces of unit pressures (default: the scene's).
        frequency: (actuators,) frequencies at t = 0 [Hz] (default: the scene's).
        delay: (actuators,) starts of the bursts [s] (default: the scene's).

    Raises:
        SceneError: The file of the drive is missing or malformed.
    """
    scene, poles = plate.scene, plate.poles(end)
    forces = plate.actuator_forces() if forces is None else forces
    frequency = actuator_frequencies(scene) if frequency is None else frequency
    delay = actuator_delays(scene) if delay is None else delay
    poles, loads = unit_loads(scene, poles, frequency, delay, end)
    moving = moving_loads(plate, end) if scene.effects.travelling is not None else []
    return Excitation(poles, poles.gains(forces), loads, [load.times_inputs(poles.inputs) for load in moving])


def unit_loads(
    scene: Scene, poles: Poles, frequency: np.ndarray, delay: np.ndarray, end: float
) -> tuple[Poles, list[ExponentialLoads] | list[SampledLoads]]:
    """Return unit loads of actuators, and the poles apart from their exponents; see :func:`make_excitation`."""
    if not has_exponential_loads(scene):
        return poles, sampled_loads(scene, frequency, delay, end)
    loads = exponential_loads(scene, frequency, delay, end)
    return poles.apart_from(np.concatenate([load.rates.ravel() for load in loads]), end), loads


def _steady_motion(plate: ModalPlate, outputs: np.ndarray, times: np.ndarray, velocity: bool) -> np.ndarray:
    forces, omega = plate.actuator_forces(), 2 * math.pi * actuator_frequencies(plate.scene)
    columns = [plate.respond(turn / (2 * math.pi), forces[:, [k]])[0, :, 0] for k, turn in enumerate(omega[:, None])]
    turns = np.exp(1j * omega[:, None] * times) * (1j * omega[:, None] if velocity else 1)
    return np.asarray((outputs @ np.stack(columns, axis=1))[:, :, None] * turns)


def with_moving_load(plate: ModalPlate, drives: np.ndarray) -> np.ndarray:
    """Return drives (drives, actuators) with the phasor 1 of a moving load, if there is one."""
    moving = plate.scene.effects.travelling is not None
    return np.concatenate([drives, np.ones((len(drives), int(moving)))], axis=1)

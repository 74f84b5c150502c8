"""Frequency responses of a panel and their derivatives with respect to numbers of its scene.

With the dynamic stiffness Z in splines, which is symmetric, loads f and sensors s,

    Z = (1 + iη + iωτ) B + S − ω²M + iωC,     Z q = f,     Z p = s,     H = sᵀ q
    dH = dsᵀ q + pᵀ (df − dZ q)

in which B, S, M and C are the matrices of :mod:`warp_plate.modal.assemble`. Their derivatives are differences,
which are exact for numbers that they are linear in, as moduli, densities and springs. Damping that is given mode by
mode is no matrix in splines: responses of such panels are themselves differenced.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from warp_plate.fitting.measured_responses import MeasuredResponses
from warp_plate.modal.assemble import Galerkin, make_galerkin
from warp_plate.modal.continuous_modes import linear_part
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.poles import CoupledModes, multiply_modes
from warp_plate.modal.spaces.space import Matrix
from warp_plate.result.frequency_response import DERIVATIVES
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# Functions of coarse plates along each side, relative to those of other commands.
DENSITY = 0.5
# Modes that damping couples: those up to REACH times the highest frequency and so many further ones, of coarse plates
# and of full ones, to which iterations add all others.
REACH, FURTHER, FURTHER_OF_FULL = 1.5, 12, 80
# Knots that move by more than this part of the smallest interval are those of other functions.
MOVED = 0.1
# Frequencies that are computed at a time, and modes up to the highest frequency.
FREQUENCIES_AT_ONCE, MOST_MODES = 256, 200


class PanelResponses:
    """Responses of a panel in the order of its tables ``[[measurement]]``: ``values`` (measurements, n)."""

    def __init__(self, scene: Scene, measured: MeasuredResponses, coarse: bool = False) -> None:
        """Compute the responses at the frequencies of measured ones; ``coarse`` plates have few functions and modes."""
        frequencies, density = measured.frequencies, DENSITY if coarse else 1.0
        key = f"{measured.source}: highest frequency {frequencies[-1]:g} Hz, which fit.range can lower"
        plate = solve_modes(
            linear_part(scene), frequencies[-1], density=density, improve=not coarse, most=MOST_MODES, key=key
        )
        if not plate.loss_factors.any():
            raise SceneError(
                "effects: responses of a panel without damping are not finite; write [effects.modal_damping]"
            )
        omega = 2 * np.pi * frequencies - 1j * measured.decay if measured.decay else 2 * np.pi * frequencies
        self._plate, self._omega, self._measured, self._coarse = plate, omega, measured, coarse
        coupled = int((plate.frequencies <= REACH * frequencies[-1]).sum()) + (FURTHER if coarse else FURTHER_OF_FULL)
        squares = plate.angular_frequencies**2
        self._modes = CoupledModes(squares, plate.damping, plate.hysteretic, frequencies[-1], coupled)
        self._loads = _Loads(plate.galerkin, self._omega)
        self.values = np.concatenate([self._respond(part) for part in self._parts], axis=1)
        for row in np.flatnonzero(~self.values.any(axis=1))[:1].tolist():
            raise SceneError(
                f"measurement[{row}]: an edge holds the panel where it is driven or sensed; move the point"
            )

    def slopes(self, changes: Sequence[tuple[Scene, Scene | None, float]]) -> np.ndarray:
        """Return (changes, measurements, n) derivatives of the responses, see ``FreeNumbers.neighbours``."""
        derivatives = [self._difference(*change) for change in changes]
        blocks = []
        for part in self._parts:
            pairs = self._fields(part)
            blocks.append([derivative(part, *pairs) for derivative in derivatives])
        return np.concatenate(blocks, axis=2)

    @property
    def _parts(self) -> list[slice]:
        return [slice(start, start + FREQUENCIES_AT_ONCE) for start in range(0, len(self._omega), FREQUENCIES_AT_ONCE)]

    def _amplitudes(self, part: slice, loads: np.ndarray) -> np.ndarray:
        """Return (n, modes, loads) modal amplitudes of loads (unknowns, loads)."""
        forces, omega = self._plate.vectors.T @ loads, self._omega[part]
        if self._plate.proportional:
            return np.asarray(forces / self._plate.dynamic_stiffness(omega)[:, :, None])
        respond = self._modes.approximate if self._coarse else self._modes.respond
        return respond(omega, np.broadcast_to(forces, (len(omega), *forces.shape)))

    def _respond(self, part: slice) -> np.ndarray:
        sensors = self._loads.sensors.T @ self._plate.vectors
        return self._loads.gains[:, part] * self._loads.pick(
            multiply_modes(sensors, self._amplitudes(part, self._loads.forces))
        )

    def _fields(self, part: slice) -> tuple[np.ndarray, np.ndarray]:
        """Return q (n, unknowns, forces) and p (n, unknowns, measurements)."""
        q, p = (
            multiply_modes(self._plate.vectors, self._amplitudes(part, loads))
            for loads in (self._loads.forces, self._loads.sensors)
        )
        return q, p

    def _difference(self, above: Scene, below: Scene | None, factor: float) -> Callable[..., np.ndarray]:
        """Return the function of frequencies, q and p that returns (measurements, n) derivatives."""
        here, loads = self._plate.galerkin, self._loads
        high, low = (_galerkin_like(here, scene) if scene is not None else here for scene in (above, below))
        # Where the functions change between the two, the difference is that to the side on which they do not.
        if below is not None and _alike(high, here) != _alike(low, here):
            high, low, factor = (high, here, 2 * factor) if _alike(high, here) else (here, low, 2 * factor)
        if not (_alike(high, here) and _alike(low, here)) or high.losses.by_modes:
            above_values, below_values = (
                self.values if scene is None else PanelResponses(scene, self._measured, self._coarse).values
                for scene in (above, below)
            )
            slopes = factor * (above_values - below_values)
            return lambda part, q, p: slopes[:, part]
        names = ("bending", "support", "mass", "damping")
        bending, support, mass, damping = (_change(getattr(high, name), getattr(low, name), factor) for name in names)
        (loss, time), (loss_high, time_high), (loss_low, time_low) = (
            (one.losses.hysteretic, one.losses.retardation) for one in (here, high, low)
        )
        changed_loss, changed_time = factor * (loss_high - loss_low), factor * (time_high - time_low)
        at_high, at_low = _Loads(high, self._omega), _Loads(low, self._omega)
        of_forces, of_sensors = factor * (at_high.forces - at_low.forces), factor * (at_high.sensors - at_low.sensors)
        of_gains = factor * (at_high.gains - at_low.gains) / loads.gains

        def derivative(part: slice, q: np.ndarray, p: np.ndarray) -> np.ndarray:
            omega = self._omega[part, None, None]
            total = np.broadcast_to(of_forces, q.shape).astype(complex)
            for matrix, weight in (
                (bending, 1 + 1j * (loss + omega * time)),
                (support, 1.0),
                (mass, -(omega**2)),
                (damping, 1j * omega),
            ):
                if matrix is not None:
                    total -= weight * multiply_modes(matrix, q)
            if changed_loss or changed_time:
                total -= 1j * (changed_loss + omega * changed_time) * multiply_modes(here.bending.toarray(), q)
            displacement = p.mT @ total if total.any() else 0.0
            displacement = displacement + multiply_modes(of_sensors.T, q)
            return loads.gains[:, part] * loads.pick(displacement) + of_gains[:, part] * self.values[:, part]

        return derivative


class _Loads:
    """Forces (unknowns, forces) of 1 N each, without repetitions, and sensors (unknowns, measurements) of the tables
    ``[[measurement]]`` in splines, and gains (measurements, n) of displacements."""

    def __init__(self, galerkin: Galerkin, omega: np.ndarray) -> None:
        rows, scene = galerkin.scene.measurement, galerkin.scene
        patches = {actuator.name: actuator for actuator in scene.actuators}
        driven = [(row.actuator, row.force_at) for row in rows]
        kinds = list(dict.fromkeys(driven))
        forces = []
        for name, point in kinds:
            if point is not None:
                forces.append(galerkin.space.at_points([point])[0])
            else:
                patch = patches[str(name)]
                forces.append(galerkin.space.region_integrals([patch])[0] / patch.patch_area)
        masses = len(galerkin.masses)
        self.forces = np.pad(np.array(forces).T, ((0, masses), (0, 0)))
        self.sensors = np.pad(galerkin.space.at_points([row.point for row in rows]).T, ((0, masses), (0, 0)))
        self._driven = [kinds.index(force) for force in driven]
        powers = np.array([DERIVATIVES[row.quantity] for row in rows])[:, None]
        self.gains = np.array([row.gain for row in rows])[:, None] * (1j * omega) ** powers

    def pick(self, displacements: np.ndarray) -> np.ndarray:
        """Return (measurements, n) of (n, measurements, forces), for the force of each measurement."""
        return displacements[:, range(len(self._driven)), self._driven].T


def _galerkin_like(galerkin: Galerkin, scene: Scene) -> Galerkin:
    """Return the matrices of another scene's linear part, over as many functions."""
    linear = linear_part(scene)
    return make_galerkin(linear, galerkin.space.of_scene(linear))


def _alike(one: Galerkin, other: Galerkin) -> bool:
    """Return whether the functions of two plates are nearly the same, so that their matrices can be compared."""
    return one.space.is_near(other.space, MOVED) and len(one.masses) == len(other.masses)


def _change(high: Matrix, low: Matrix, factor: float) -> np.ndarray | None:
    """Return the difference of matrices times a factor; None if they are equal."""
    change = high - low
    return factor * change.toarray() if change.nnz else None

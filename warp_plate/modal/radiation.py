"""Sound radiated by a plate in a rigid baffle: power and pressure in front of it, of modes and their sums.

The pressure of a velocity v exp(iωt) is Rayleigh's integral p = (iωρ/2π) ∫ v exp(−ikr)/r dA. Far away it depends on the
direction alone, through the integral V of v exp(i(kx x + ky y)) with (kx, ky) = k sin θ (cos φ, sin φ), and the power
is that of the intensity |p|²/2ρc over the half-space,

    P = ρck²/(8π²) ∫∫ |V|² sin θ dθ dφ = ½ vᴴ R v

(F. Fahy and P. Gardonio, Sound and Structural Vibration, 2nd ed., 2007, chapter 3). Modes have shapes φ(x, y), so that
V of every mode at a number of directions gives the matrix R of their radiation resistances. R/k² is a smooth, even
function of k, which Chebyshev polynomials in k² interpolate to rounding.

The sound does not act on the plate, the plate does not radiate to the back, and a plate without a baffle radiates less
below its critical frequency, where the sound of both sides cancels out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from scipy.special import spherical_jn

from warp_plate.modal.modes import ModalPlate
from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.scene.errors import SceneError

# Terms beyond one for each radian of phase over half the plate: all errors are below 1e-12.
FURTHER = 12
# A point nearer to the plate than so many of its spacings of integration is refused.
NEAREST = 3.0


@dataclass(frozen=True)
class Air:
    """The medium in front of the plate."""

    density: float = 1.204
    """Density [kg/m³]; that of dry air at 20 °C and 101.325 kPa."""
    sound_speed: float = 343.2
    """Speed of sound [m/s]."""

    def wavenumber(self, frequencies: np.ndarray) -> np.ndarray:
        """Return wavenumbers k [1/m] of frequencies [Hz]."""
        return 2 * math.pi * np.asarray(frequencies, dtype=float) / self.sound_speed


class FarField:
    """V of every mode, relative to the middle of the plate's sides, for wavenumbers up to a highest one.

    Over a side of length L, exp(ikx) = Σ (2n + 1) iⁿ j_n(kL/2) P_n(2x/L), by spherical Bessel functions and Legendre
    polynomials, whose moments with the modes are computed once.
    """

    def __init__(self, plate: ModalPlate, highest: float) -> None:
        """``highest`` wavenumber [1/m]."""
        self.sides = plate.scene.plate.size
        self._moments = plate.space.moments(self._counts(highest)) @ plate.vectors[: plate.space.unknowns]

    def _counts(self, wavenumber: float) -> tuple[int, int]:
        x, y = (math.ceil(1.1 * wavenumber * side / 2 + 1.5 * FURTHER) for side in self.sides)
        return x, y

    def at(self, wavenumber: float, sine: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
        """Return (directions, modes) V [m²/√kg] of a wavenumber [1/m] in directions with sin θ and φ [rad]."""
        arguments = wavenumber * sine * np.cos(azimuth), wavenumber * sine * np.sin(azimuth)
        orders = [np.arange(count) for count in self._counts(wavenumber)]
        x, y = (
            (2 * some + 1) * spherical_jn(some, (argument * side / 2)[:, None])
            for some, argument, side in zip(orders, arguments, self.sides, strict=True)
        )
        terms = (y[:, :, None] * x[:, None, :]).reshape(len(x), -1)
        moments = self._moments[: orders[1].size, : orders[0].size].reshape(terms.shape[1], -1)
        power = np.add.outer(orders[1], orders[0]).ravel()
        even, sign = power % 2 == 0, np.where(power // 2 % 2 == 0, 1.0, -1.0)
        real, imaginary = ((terms[:, some] * sign[some]) @ moments[some] for some in (even, ~even))
        return np.asarray(real + 1j * imaginary)


def radiation_resistances(plate: ModalPlate, frequencies: np.ndarray, air: Air = Air()) -> np.ndarray:
    """Return (n, modes, modes) R [1/s]: modal velocities q̇ exp(iωt) [m√kg/s] of frequencies (n,) [Hz] radiate
    ½ q̇ᴴ R q̇ [W]."""
    k, modes = air.wavenumber(frequencies), len(plate.frequencies)
    highest = float(k.max())
    count = math.ceil(_phase(plate, highest)) + FURTHER
    refuse_beyond_memory(8.0 * modes**2 * (len(k) + 2 * min(count, len(k))), f"frequencies: {len(k)} of {modes} modes")
    field = FarField(plate, highest)
    if len(k) <= count:
        shares = np.stack([_resistance_by_square(plate, field, one) for one in k])
    else:
        nodes = chebyshev.chebpts1(count)
        at_nodes = [_resistance_by_square(plate, field, highest * math.sqrt((node + 1) / 2)) for node in nodes]
        values = np.reshape(at_nodes, (count, -1))
        polynomials = np.linalg.solve(chebyshev.chebvander(nodes, count - 1), values)
        shares = (chebyshev.chebvander(2 * (k / highest) ** 2 - 1, count - 1) @ polynomials).reshape(-1, modes, modes)
    return np.asarray(air.density * air.sound_speed * k[:, None, None] ** 2 * shares)


def _phase(plate: ModalPlate, wavenumber: float) -> float:
    """Return the phase [rad] of a wave from the middle of the plate to a corner."""
    return wavenumber * math.hypot(*plate.scene.plate.size) / 2


def _resistance_by_square(plate: ModalPlate, field: FarField, wavenumber: float) -> np.ndarray:
    """Return R/ρck² [m⁴/kg] of one wavenumber [1/m]: opposite directions have conjugate V."""
    phase = math.ceil(_phase(plate, wavenumber))
    heights, shares = np.polynomial.legendre.leggauss(phase // 2 + FURTHER)
    around = phase + FURTHER
    azimuth = math.pi * (np.arange(around) + 0.5) / around
    sine = np.sqrt(1 - ((heights + 1) / 2) ** 2)
    waves = field.at(wavenumber, np.repeat(sine, around), np.tile(azimuth, sine.size))
    waves *= np.sqrt(np.repeat(shares / 2, around) * (2 * math.pi / around))[:, None]
    return np.asarray(waves.real.T @ waves.real + waves.imag.T @ waves.imag) / (4 * math.pi**2)


def pressures(
    plate: ModalPlate, frequencies: np.ndarray, amplitudes: np.ndarray, points: np.ndarray, air: Air = Air()
) -> np.ndarray:
    """Return (n, points, loads) pressures [Pa] at points (points, 3) x, y, z [m] in front of the plate, z above it, of
    modal amplitudes (n, modes, loads) at frequencies (n,) [Hz]. SceneError: a point is too near to the plate."""
    places, weights = plate.space.quadrature()
    spacing = math.sqrt(plate.scene.plate.area / len(weights))
    for index, (x, y, z) in enumerate(points.tolist()):
        if not z >= NEAREST * spacing:
            what = f"must lie in front of the plate, z at least {NEAREST * spacing:.2g} m"
            raise SceneError(f"points[{index}] = {x:g},{y:g},{z:g}: {what}")
    distances = np.sqrt(((points[:, None, :2] - places) ** 2).sum(axis=-1) + points[:, 2:] ** 2)
    shapes = plate.at_points(places)
    pressures = np.empty((len(frequencies), len(points), amplitudes.shape[2]), dtype=complex)
    for index, (k, motion) in enumerate(zip(air.wavenumber(frequencies), amplitudes, strict=True)):
        omega = k * air.sound_speed
        kernel = np.exp(-1j * k * distances) * (weights / distances)
        displacements = shapes.T @ motion.real + 1j * (shapes.T @ motion.imag)
        pressures[index] = -(omega**2) * air.density / (2 * math.pi) * (kernel @ displacements)
    return pressures

"""Sound radiated by a plate in a rigid baffle: power and pressure in front of it, of modes and their sums.

The pressure of a velocity v exp(iωt) is Rayleigh's integral p = (iωρ/2π) ∫ v exp(−ikr)/r dA. Far away it depends on the
direction alone, through the integral V of v exp(i(kx x + ky y)) with (kx, ky) = k sin θ (cos φ, sin φ), and the power
is that of the intensity |p|²/2ρc over the half-space,

    P = ρck²/(8π²) ∫∫ |V|² sin θ dθ dφ = ½ vᴴ R v

(F. Fahy and P. Gardonio, Sound and Structural Vibration, 2nd ed., 2007, chapter 3). Modes have shapes φ(x, y), so that
V of every mode at a number of directions gives the matrix R of their radiation resistances. R/k² is a smooth, even
function of k, which Chebyshev polynomials in k² interpolate to rounding.

The plate does not radiate to the back. The sound acts on it in scenes with ``[effects.air]``, see
:mod:`warp_plate.modal.air`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy
from numpy.polynomial import chebyshev

from warp_plate.effects.air import AIR_DENSITY, SOUND_SPEED
from warp_plate.modal.poles import CoupledModes
from warp_plate.modal.spaces.space import FunctionSpace
from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.quantities.sound_levels import a_weight
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# Terms beyond one for each radian of phase over half the plate: all errors are below 1e-12.
FURTHER = 12
# Frequencies whose pressures and powers are computed at a time.
BLOCK_FREQUENCIES = 64
# A point nearer to the plate than so many of its spacings of integration is refused.
NEAREST = 3.0


@dataclass(frozen=True)
class Air:
    """The medium in front of the plate."""

    density: float = AIR_DENSITY
    """Density [kg/m³]; that of dry air at 20 °C and 101.325 kPa."""
    sound_speed: float = SOUND_SPEED
    """Speed of sound [m/s]."""

    def wavenumber(self, frequencies: np.ndarray | float) -> np.ndarray:
        """Return wavenumbers k [1/m] of frequencies [Hz]."""
        return 2 * math.pi * np.asarray(frequencies, dtype=float) / self.sound_speed


AIR = Air()


def air_of(scene: Scene) -> Air:
    """Return the medium of a scene: that of ``[effects.air]``, or air at 20 °C."""
    table = scene.effects.air
    return AIR if table is None else Air(table.density, table.sound_speed)


class PlateInBaffle(Protocol):
    """Parts of a plate that sound depends on; see :class:`warp_plate.modal.modes.ModalPlate`."""

    @property
    def scene(self) -> Scene: ...
    @property
    def space(self) -> FunctionSpace: ...
    @property
    def frequencies(self) -> np.ndarray: ...
    @property
    def vectors(self) -> np.ndarray: ...


class BarePlate(PlateInBaffle, Protocol):
    """A plate without its air and coils; see :class:`warp_plate.modal.modes.ModalPlate`."""

    @property
    def highest(self) -> float: ...
    @property
    def angular_frequencies(self) -> np.ndarray: ...
    @property
    def damping(self) -> np.ndarray: ...
    @property
    def hysteretic(self) -> np.ndarray: ...
    @property
    def coupled(self) -> CoupledModes | None: ...

    def shapes(self, x: np.ndarray, y: np.ndarray) -> np.ndarray: ...
    def dynamic_stiffness(self, omega: np.ndarray) -> np.ndarray: ...
    def respond_alone(self, omega: np.ndarray, forces: np.ndarray) -> np.ndarray: ...


class FarField:
    """V of every mode, relative to the middle of the plate's sides, for wavenumbers up to a highest one.

    Over a side of length L, exp(ikx) = Σ (2n + 1) iⁿ j_n(kL/2) P_n(2x/L), by spherical Bessel functions and Legendre
    polynomials, whose moments with the modes are computed once.
    """

    def __init__(self, plate: PlateInBaffle, highest: float) -> None:
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
            (2 * some + 1) * scipy.special.spherical_jn(some, (argument * side / 2)[:, None])
            for some, argument, side in zip(orders, arguments, self.sides, strict=True)
        )
        terms = (y[:, :, None] * x[:, None, :]).reshape(len(x), -1)
        moments = self._moments[: orders[1].size, : orders[0].size].reshape(terms.shape[1], -1)
        power = np.add.outer(orders[1], orders[0]).ravel()
        even, sign = power % 2 == 0, np.where(power // 2 % 2 == 0, 1.0, -1.0)
        real, imaginary = ((terms[:, some] * sign[some]) @ moments[some] for some in (even, ~even))
        return np.asarray(real + 1j * imaginary)

    def resistance_factor(self, wavenumber: float) -> np.ndarray:
        """Return F (rows, modes) [m²/√kg], real, of a wavenumber k [1/m]: radiation resistances are ρck² FᵀF.

        The rows are directions in half of the half-space; those opposite have conjugate V.
        """
        phase = math.ceil(wavenumber * math.hypot(*self.sides) / 2)
        heights, shares = np.polynomial.legendre.leggauss(phase // 2 + FURTHER)
        around = phase + FURTHER
        azimuth = math.pi * (np.arange(around) + 0.5) / around
        sine = np.sqrt(1 - ((heights + 1) / 2) ** 2)
        waves = self.at(wavenumber, np.repeat(sine, around), np.tile(azimuth, sine.size))
        waves *= np.sqrt(np.repeat(shares / 2, around) * (2 * math.pi / around))[:, None] / (2 * math.pi)
        return np.concatenate([waves.real, waves.imag])


class WeightedSound:
    """The A-weighted sound of steady modal velocities as a quadratic form: power [W], or at a point (x, y, z) [m] the
    mean square of the pressure [Pa²]."""

    def __init__(self, plate: PlateInBaffle, highest: float, point: tuple[float, float, float] | None = None) -> None:
        """``highest`` frequency [Hz]."""
        self._plate, self._point, self._air = plate, point, air_of(plate.scene)
        self._far_field = FarField(plate, float(self._air.wavenumber(highest))) if point is None else None

    def factor(self, frequency: float) -> np.ndarray:
        """Return F (rows, modes) at a frequency [Hz]: the sound of velocities q̇ exp(iωt) is ½ ‖F q̇‖²."""
        weight = a_weight(frequency)
        if self._far_field is None:
            assert self._point is not None
            return weight * pressure_rows(self._plate, frequency, np.array([self._point]))
        k = float(self._air.wavenumber(frequency))
        return weight * math.sqrt(self._air.density * self._air.sound_speed) * k * self._far_field.resistance_factor(k)

    def multiply(self, frequency: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return 2FᴴF q̇ (designs, modes, M) of velocities of the same shape at frequencies (designs, M) [Hz]."""
        products = np.empty(rates.shape, dtype=complex)
        columns, rates = np.moveaxis(products, 1, 2), np.moveaxis(rates, 1, 2)
        frequency = np.broadcast_to(frequency, columns.shape[:2])
        for value in np.unique(frequency):
            factor, chosen = self.factor(float(value)), frequency == value
            columns[chosen] = 2 * (rates[chosen] @ factor.T) @ factor.conj()
        return products


class Radiation:
    """Radiation resistances of modes, for frequencies up to a highest one.

    Modal velocities q̇ exp(iωt) [m√kg/s] radiate ½ q̇ᴴ R q̇ [W].
    """

    def __init__(self, plate: PlateInBaffle, highest: float, air: Air | None = None) -> None:
        """``highest`` frequency [Hz], and air (default: the scene's). SceneError: the plate has too many modes for this
        machine's memory."""
        air = air or air_of(plate.scene)
        self.plate, self.air, self._highest = plate, air, float(air.wavenumber(highest))
        count, modes = math.ceil(self._phase(self._highest)) + FURTHER, len(plate.frequencies)
        refuse_beyond_memory(24.0 * count * modes**2, f"frequency = {highest:g}: sound of {modes} modes")
        self.far_field = FarField(plate, self._highest)
        nodes = chebyshev.chebpts1(count)
        at_nodes = [self._resistance_by_square(self._highest * math.sqrt((node + 1) / 2)) for node in nodes]
        # (polynomials, modes²) of R/ρck²
        self._polynomials = np.linalg.solve(chebyshev.chebvander(nodes, count - 1), np.reshape(at_nodes, (count, -1)))

    def resistances(self, frequencies: np.ndarray) -> np.ndarray:
        """Return (n, modes, modes) R [1/s] at frequencies (n,) [Hz]."""
        k, modes = self.air.wavenumber(frequencies), len(self.plate.frequencies)
        values = chebyshev.chebvander(2 * (k / self._highest) ** 2 - 1, len(self._polynomials) - 1)
        shares = (values @ self._polynomials).reshape(-1, modes, modes)
        return np.asarray(self.air.density * self.air.sound_speed * k[:, None, None] ** 2 * shares)

    def powers(self, frequencies: np.ndarray, amplitudes: np.ndarray) -> np.ndarray:
        """Return (n, loads) mean radiated powers [W] of modal amplitudes (n, modes, loads) at frequencies (n,) [Hz]."""
        powers = np.zeros((len(frequencies), amplitudes.shape[2]))
        modes, k = amplitudes.shape[1], self.air.wavenumber(frequencies)
        values = chebyshev.chebvander(2 * (k / self._highest) ** 2 - 1, len(self._polynomials) - 1)
        for start in range(0, len(frequencies), BLOCK_FREQUENCIES):
            some = slice(start, start + BLOCK_FREQUENCIES)
            rates = np.moveaxis(2j * math.pi * frequencies[some, None, None] * amplitudes[some], 1, 0)
            for part in (rates.real.reshape(modes, -1), rates.imag.reshape(modes, -1)):
                for value, shares in zip(values[some].T, self._polynomials, strict=True):
                    products = (part * (shares.reshape(modes, modes) @ part)).sum(axis=0)
                    powers[some] += value[:, None] * products.reshape(powers[some].shape)
        return np.asarray(self.air.density * self.air.sound_speed / 2 * k[:, None] ** 2 * powers)

    def pressures(self, frequencies: np.ndarray, amplitudes: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return (n, points, loads) pressures [Pa], see :func:`pressures`."""
        return pressures(self.plate, frequencies, amplitudes, points, self.air)

    def far_sound(self, frequency: float, amplitudes: np.ndarray, sine: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
        """Return (directions,) relative pressures far away of modal amplitudes (modes,), in directions with sin θ and φ
        [rad]."""
        return np.asarray(self.far_field.at(float(self.air.wavenumber(frequency)), sine, azimuth) @ amplitudes)

    def _phase(self, wavenumber: float) -> float:
        """Return the phase [rad] of a wave from the middle of the plate to a corner."""
        return wavenumber * math.hypot(*self.plate.scene.plate.size) / 2

    def _resistance_by_square(self, wavenumber: float) -> np.ndarray:
        """Return (modes, modes) R/ρck² [m⁴/kg] of a wavenumber [1/m]."""
        factor = self.far_field.resistance_factor(wavenumber)
        return np.asarray(factor.T @ factor)


def efficiencies(
    plate: PlateInBaffle, air: Air, frequencies: np.ndarray, amplitudes: np.ndarray, powers: np.ndarray
) -> np.ndarray:
    """Return (n, loads) radiation efficiencies of modal amplitudes (n, modes, loads) at frequencies (n,) [Hz]: powers
    (n, loads) [W] over ½ρc ∫ |v|² dA, that of a piston to one side; NaN where nothing moves."""
    space, vectors = plate.space, plate.vectors[: plate.space.unknowns]
    areas = vectors.T @ (space.scatter(space.form(1.0)) @ vectors)
    squares = sum((part * (areas @ part)).sum(axis=1) for part in (amplitudes.real, amplitudes.imag))
    with np.errstate(invalid="ignore", divide="ignore"):
        pistons = air.density * air.sound_speed / 2 * (2 * math.pi * frequencies[:, None]) ** 2 * squares
        return np.asarray(powers / pistons)


def pressure_rows(plate: PlateInBaffle, frequency: float, points: np.ndarray) -> np.ndarray:
    """Return (points, modes) pressures [Pa] of unit modal velocities in the scene's air; see :func:`pressures`."""
    air = air_of(plate.scene)
    places, weights = plate.space.quadrature()
    distances = distances_to(plate, points, places)
    k = float(air.wavenumber(frequency))
    kernel = np.exp(-1j * k * distances) * (weights / distances)
    return np.asarray(1j * frequency * air.density * (kernel @ _shapes(plate, places).T))


def pressures(
    plate: PlateInBaffle, frequencies: np.ndarray, amplitudes: np.ndarray, points: np.ndarray, air: Air = AIR
) -> np.ndarray:
    """Return (n, points, loads) pressures [Pa] at points (points, 3) x, y, z [m] in front of the plate, z above it, of
    modal amplitudes (n, modes, loads) at frequencies (n,) [Hz]. SceneError: a point is too near to the plate."""
    places, weights = plate.space.quadrature()
    distances, shapes = distances_to(plate, points, places), _shapes(plate, places)
    middle = (distances.min(axis=1) + distances.max(axis=1)) / 2
    k = air.wavenumber(frequencies)

    def rows(wavenumbers: np.ndarray) -> np.ndarray:
        """Return (n, points, modes) ∫ φ exp(−ik(r − middle))/r dA, which vary slowly with k."""
        kernels = (np.exp(-1j * one * (distances - middle[:, None])) * (weights / distances) for one in wavenumbers)
        return np.array([kernel.real @ shapes.T + 1j * (kernel.imag @ shapes.T) for kernel in kernels])

    centre, half = (k.max() + k.min()) / 2, (k.max() - k.min()) / 2
    count = math.ceil(1.2 * half * np.ptp(distances, axis=1).max(initial=0) / 2) + 2 * FURTHER
    interpolated = half > 0 and count < len(k)
    if interpolated:
        nodes = chebyshev.chebpts1(count)
        at_nodes = rows(centre + half * nodes).reshape(count, -1)
        polynomials = np.linalg.solve(chebyshev.chebvander(nodes, count - 1), at_nodes)
    pressures = np.empty((len(frequencies), len(points), amplitudes.shape[2]), dtype=complex)
    for start in range(0, len(frequencies), BLOCK_FREQUENCIES):
        some = slice(start, start + BLOCK_FREQUENCIES)
        if interpolated:
            values = chebyshev.chebvander((k[some] - centre) / half, count - 1)
            sums = (values @ polynomials).reshape(len(values), len(points), -1)
        else:
            sums = rows(k[some])
        accelerations = -((k[some, None, None] * air.sound_speed) ** 2) * amplitudes[some]
        pressures[some] = np.exp(-1j * np.outer(k[some], middle))[:, :, None] * (sums @ accelerations)
    return np.asarray(air.density / (2 * math.pi) * pressures)


def distances_to(plate: PlateInBaffle, points: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return (points, places) distances [m] of points (points, 3) from places (places, 2) of integration; SceneError: a
    point is too near to the plate."""
    spacing = math.sqrt(plate.scene.plate.area / len(places))
    for index, (x, y, z) in enumerate(points.tolist()):
        if not z >= NEAREST * spacing:
            what = f"must lie in front of the plate, z at least {NEAREST * spacing:.2g} m"
            raise SceneError(f"points[{index}] = {x:g},{y:g},{z:g}: {what}")
    return np.asarray(np.sqrt(((points[:, None, :2] - places) ** 2).sum(axis=-1) + points[:, 2:] ** 2))


def _shapes(plate: PlateInBaffle, places: np.ndarray) -> np.ndarray:
    """Return (modes, places) shapes φ [1/√kg] at places (places, 2) [m]."""
    return np.asarray(plate.vectors[: plate.space.unknowns].T @ plate.space.at_points(places).T)

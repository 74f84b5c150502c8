"""Sound radiated by a thin rectangular plate without a baffle, open at the back, by the jump of pressure across it.

The pressure is odd in z, so that with the jump Δp over the plate, zero beyond its edges, the velocity has the transform

    v = kz Δp/2ωρ,     kz = √(k² − κ²) or −i√(κ² − k²)

at a wavenumber κ in the plane. Δp is a sum of √(1 − x²) U_m(x) √(1 − y²) U_n(y), which fall to the edges as it does, by
Chebyshev polynomials of the second kind, whose transforms are Bessel functions. Galerkin's method gives the sum for the
velocity of the plate: that of B. Laulagnet (J. Acoust. Soc. Am. 103, 1998, p. 2451), with other functions. The power of
both sides is ½ Re ∫ Δp* v dA. The plate is taken as infinitely thin.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
import scipy
from numpy.polynomial import chebyshev

from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.radiation import AIR, FURTHER, Air, distances_to
from warp_plate.modal.spaces.integrals import mean_wave_frequency
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# Functions of the jump along a side beyond one for each half-wave, and most of them.
MORE_FUNCTIONS, MOST_FUNCTIONS = 4, 24
# Largest wavenumber of integrals over waves that do not radiate, over π times functions per side: what lies beyond
# falls as its inverse, and is extrapolated from half of it.
REACH = 4.0
# Gauss's points of a panel of wavenumbers, and panels for each turn of a wave across the plate.
PANEL_POINTS, PANELS = 10, 0.3


class Unbaffled:
    """Power, pressure and far field of a plate without a baffle, for frequencies up to a highest one.

    SceneError: the plate is no rectangle, or has too many half-waves at the highest frequency [Hz].
    """

    def __init__(self, plate: ModalPlate, highest: float, air: Air = AIR) -> None:
        refuse_outline(plate.scene)
        self.plate, self.air, self._highest = plate, air, float(air.wavenumber(highest))
        self.sides = plate.scene.plate.size
        waves = [side * math.sqrt(highest / mean_wave_frequency(plate.space.laminate)) for side in self.sides]
        self._counts = [2 * math.ceil((wave + MORE_FUNCTIONS) / 2) for wave in waves]
        if max(self._counts) > MOST_FUNCTIONS:
            most = f"without a baffle at most {MOST_FUNCTIONS - MORE_FUNCTIONS} are possible; end the range lower"
            raise SceneError(f"frequency_range: {highest:g} Hz has {max(waves):.0f} half-waves along a side; {most}")

    def jumps(self, frequency: float, amplitudes: np.ndarray) -> np.ndarray:
        """Return (functions along y, along x, loads) coefficients of Δp [Pa] of modal amplitudes (modes, loads)."""
        rates = 2j * math.pi * frequency * amplitudes
        moved = np.tensordot(self.projection, rates, (2, 0))
        jumps = np.zeros(moved.shape, dtype=complex)
        for (y, x), matrix in zip(_PARITIES, self._matrices(frequency), strict=True):
            part = moved[y::2, x::2]
            jumps[y::2, x::2] = np.linalg.solve(matrix, part.reshape(len(matrix), -1)).reshape(part.shape)
        return jumps * (4 * math.pi * frequency * self.air.density)

    def powers(self, frequencies: np.ndarray, amplitudes: np.ndarray) -> np.ndarray:
        """Return (n, loads) mean powers [W] radiated by both sides, of modal amplitudes (n, modes, loads)."""
        powers = np.empty((len(frequencies), amplitudes.shape[2]))
        for index, frequency in enumerate(frequencies.tolist()):
            jumps = self.jumps(frequency, amplitudes[index])
            moved = np.tensordot(self.projection, 2j * math.pi * frequency * amplitudes[index], (2, 0))
            powers[index] = (jumps.conj() * moved).real.sum(axis=(0, 1)) / 2
        return powers

    def pressures(self, frequencies: np.ndarray, amplitudes: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return (n, points, loads) pressures [Pa] at points (points, 3) x, y, z [m] in front of the plate."""
        (x, across), (y, up) = self._nodes
        places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        distances = distances_to(self.plate, points, places)
        values = np.einsum("my,nx->mnyx", up, across).reshape(*self._counts[::-1], -1)
        pressures = np.empty((len(frequencies), len(points), amplitudes.shape[2]), dtype=complex)
        for index, frequency in enumerate(frequencies.tolist()):
            k = float(self.air.wavenumber(frequency))
            waves = (1 + 1j * k * distances) * np.exp(-1j * k * distances)
            kernel = points[:, 2:] * waves / (4 * math.pi * distances**3)
            jump = np.tensordot(values, self.jumps(frequency, amplitudes[index]), ((0, 1), (0, 1)))
            pressures[index] = kernel @ jump
        return pressures

    def far_sound(self, frequency: float, amplitudes: np.ndarray, sine: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
        """Return (directions,) relative pressures far away of modal amplitudes (modes,), in directions with sin θ and φ
        [rad]."""
        k = float(self.air.wavenumber(frequency))
        x = _transforms(self._counts[0], k * sine * np.cos(azimuth) * self.sides[0] / 2)
        y = _transforms(self._counts[1], k * sine * np.sin(azimuth) * self.sides[1] / 2)
        phases = [1j ** np.arange(count) for count in self._counts]
        jumps = self.jumps(frequency, amplitudes[:, None])[:, :, 0] * np.outer(phases[1], phases[0])
        return np.asarray(np.sqrt(1 - sine**2) * np.einsum("yd,xd,yx->d", y, x, jumps, optimize=True))

    @cached_property
    def _nodes(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Points [m] along x and along y, and values (functions, points) times weights [m] there."""
        sides = []
        for side, count in zip(self.sides, self._counts, strict=True):
            number = 4 * count + 40
            angles = math.pi * np.arange(1, number + 1) / (number + 1)
            weights = math.pi / (number + 1) * np.sin(angles) * side / 2
            sides.append((side / 2 * (1 + np.cos(angles)), np.sin(np.outer(np.arange(1, count + 1), angles)) * weights))
        return sides

    @cached_property
    def projection(self) -> np.ndarray:
        """(functions along y, along x, modes) integrals of the functions times the shapes [m²/√kg]."""
        (x, across), (y, up) = self._nodes
        shapes = self.plate.shapes(x, y)
        return np.asarray(np.einsum("my,nx,ryx->mnr", up, across, shapes, optimize=True))

    def _matrices(self, frequency: float) -> list[np.ndarray]:
        """Return ∫ kz ψ*ψ d²κ/4π² [m] between functions of one parity along x and y, see ``_PARITIES``."""
        k = float(self.air.wavenumber(frequency))
        values = chebyshev.chebvander(np.array([2 * (k / self._highest) ** 2 - 1]), len(self._polynomials[0][0]) - 1)[0]
        return [
            k**3 * np.tensordot(values, real, 1) - 1j * np.tensordot(values, imaginary, 1)
            for real, imaginary in self._polynomials
        ]

    @cached_property
    def _polynomials(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Coefficients (polynomials in k², functions, functions) of real parts over k³ and of imaginary ones."""
        diagonal = math.hypot(*self.sides)
        nodes = chebyshev.chebpts1(math.ceil(self._highest * diagonal / 2) + FURTHER)
        wavenumbers = self._highest * np.sqrt((nodes + 1) / 2)
        apart, largest = (
            1.5 * self._highest,
            REACH * math.pi * max(count / side for count, side in zip(self._counts, self.sides, strict=True)),
        )
        far, far_weights, far_waves = self._far(apart, apart + largest, diagonal)
        near_turns, inverse = self._quarter(apart), np.linalg.inv(chebyshev.chebvander(nodes, len(nodes) - 1))
        angles, shares = np.polynomial.legendre.leggauss(math.ceil(self._highest * diagonal / 2) + 2 * FURTHER)
        angles, shares = math.pi / 4 * (angles + 1), math.pi / 4 * shares
        real, imaginary = [], []
        for k in wavenumbers.tolist():
            waves = self._waves(k * np.sin(angles), near_turns[0])
            weights = np.outer(np.sin(angles) * np.cos(angles) ** 2 * shares, near_turns[1]).ravel()
            real.append([_product(wave, weights) for wave in waves])
            slow, widths = _panels(0.0, math.sqrt(apart**2 - k**2), diagonal)
            waves = self._waves(np.sqrt(k**2 + slow**2), near_turns[0])
            parts = [_product(wave, np.outer(slow**2 * widths, near_turns[1]).ravel()) for wave in waves]
            weights = far * np.sqrt(far**2 - k**2) * far_weights
            imaginary.append([part + _product(wave, weights) for part, wave in zip(parts, far_waves, strict=True)])
        return [
            (
                np.tensordot(inverse, np.array([row[part] for row in real]), 1),
                np.tensordot(inverse, np.array([row[part] for row in imaginary]), 1),
            )
            for part in range(len(_PARITIES))
        ]

    def _far(self, low: float, high: float, diagonal: float) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
        """Return wavenumbers (n,) between two ends [1/m], their weights and transforms, and twice those of the upper
        half, for the rest beyond."""
        radii, shares = _panels(low, high, diagonal)
        shares = np.where(radii > low + (high - low) / 2, 2, 1) * shares
        parts = []
        for some in np.split(np.arange(radii.size), range(PANEL_POINTS, radii.size, PANEL_POINTS)):
            angles, weights = self._quarter(float(radii[some[-1]]))
            waves = self._waves(radii[some], angles)
            parts.append((np.repeat(radii[some], angles.size), np.outer(shares[some], weights).ravel(), waves))
        waves = [np.concatenate([part[2][index] for part in parts], axis=1) for index in range(len(_PARITIES))]
        return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts]), waves

    def _quarter(self, wavenumber: float) -> tuple[np.ndarray, np.ndarray]:
        """Return directions in a quarter of the plane [rad] and weights of the mean over all, over π²."""
        angles, shares = np.polynomial.legendre.leggauss(math.ceil(0.35 * wavenumber * max(self.sides)) + FURTHER)
        return math.pi / 4 * (angles + 1), shares / (4 * math.pi)

    def _waves(self, wavenumbers: np.ndarray, angles: np.ndarray) -> list[np.ndarray]:
        """Return transforms (functions, wavenumbers · angles) of the functions of each parity, with the signs of iⁿ."""
        along = [
            _transforms(count, (np.outer(wavenumbers, turn) * side / 2).ravel()) * side / 2
            for count, side, turn in zip(self._counts, self.sides, (np.cos(angles), np.sin(angles)), strict=True)
        ]
        x, y = (values * (1 - np.arange(len(values)) // 2 % 2 * 2)[:, None] for values in along)
        return [(y[b::2, None] * x[None, a::2]).reshape(-1, x.shape[1]) for b, a in _PARITIES]


def refuse_outline(scene: Scene) -> None:
    """Raise a SceneError if the plate is no rectangle."""
    if scene.plate.outline is not None:
        raise SceneError("plate.outline: sound without a baffle is that of rectangles; take it in a baffle")


# Parities of functions along y and x.
_PARITIES = ((0, 0), (0, 1), (1, 0), (1, 1))


def _transforms(count: int, arguments: np.ndarray) -> np.ndarray:
    """Return (count, n) ∫ √(1 − x²) U_m(x) exp(iax) dx / iᵐ at arguments a (n,): π (m + 1) J_{m+1}(a)/a."""
    orders = np.arange(1, count + 1)[:, None]
    small = np.abs(arguments) < 1e-6
    moving = np.where(small, 1.0, arguments)
    values = math.pi * orders * scipy.special.jv(orders, moving) / moving
    return np.asarray(np.where(small, np.where(orders == 1, math.pi / 2, 0.0), values))


def _product(waves: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return np.asarray((waves * weights) @ waves.T)


def _panels(low: float, high: float, diagonal: float) -> tuple[np.ndarray, np.ndarray]:
    """Return points and weights of Gauss's rule in panels from ``low`` to ``high`` [1/m] over a plate of a diagonal."""
    nodes, shares = np.polynomial.legendre.leggauss(PANEL_POINTS)
    ends = np.linspace(low, high, max(2, math.ceil(PANELS * (high - low) * diagonal / math.pi)) + 1)
    halves = np.diff(ends)[:, None] / 2
    return (ends[:-1, None] + halves * (1 + nodes)).ravel(), (halves * shares).ravel()

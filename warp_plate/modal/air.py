"""The load of the air on a plate in a rigid baffle, in terms of its modes in vacuo, in steady motion.

With the radiation resistances R of one side, the air presses on the modes by −Z q̇, Z = R + iωM for each side with air,

    M = (ρ/2π) ∫∫ φ(x) φ(x') cos(kr)/r dA dA',     r = |x − x'|

(F. Fahy and P. Gardonio, Sound and Structural Vibration, 2nd ed., 2007, chapter 3). Between points of the plate nothing
changes if cos(kr)/r is continued periodically beyond ± its sides Lx, Ly, so that by Parseval's theorem

    M = ρ/(8π Lx Ly) Σ_pq G_pq V*V,     G_pq = ∫∫ cos(kr)/r cos(πpx/Lx) cos(πqy/Ly) dx dy over |x| < Lx, |y| < Ly

with V the integrals of the shapes times the waves of wavenumbers (πp/Lx, πq/Ly), which do not depend on frequency. With
free edges the rest of the sum falls as the inverse second and third powers of the largest p, with others faster: both
are extrapolated from parts of the sum. The masses at k = 0 give modes in air. At each frequency the rest of Z is solved
for among the lowest of them, and the resistances of all modes are restored by iterative refinement, so that what is
radiated is what is lost. Modes far above the highest frequency, which move as springs, have no mass of air.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.polynomial import chebyshev

from warp_plate.effects.air import AirLoad
from warp_plate.modal.poles import multiply_modes
from warp_plate.modal.radiation import FURTHER, Air, BarePlate, PlateInBaffle, Radiation
from warp_plate.modal.spaces.integrals import mean_wave_frequency
from warp_plate.modal.spaces.space import FunctionSpace
from warp_plate.scene.model import Scene

# Modes with a mass of air, and of the modes with that mass those that the rest of the load couples before refinement:
# up to so many times the highest frequency, at least, and at most.
MOVING, FEWEST, MOST = 2.0, 40, 400
COUPLED, FEWEST_COUPLED = 1.2, 12
# Waves of the sum along a side for each half-wave of the highest of these modes, and at least.
PER_HALF_WAVE, FEWEST_WAVES = 2.0, 48
# Parts of the largest wavenumbers at which the sum is taken, and the weights of these sums, without what falls as the
# inverse second and third powers of the largest.
PARTS = np.array([1, 5 / 6, 1 / 2])
WEIGHTS = np.linalg.solve(PARTS ** -np.array([[0.0], [2.0], [3.0]]), [1.0, 0.0, 0.0])
# Terms of the interpolation of masses in k² beyond one for each radian of phase over half the plate.
MORE_TERMS = 6
# Frequencies whose impedances are in memory at a time; relative residual of the forces, and most refinements.
BLOCK_FREQUENCIES, RESIDUAL, REFINEMENTS = 16, 1e-11, 30
Rows = np.ndarray | slice  # some of the frequencies


@dataclass(frozen=True)
class Shapes:
    """Shapes of motions of a plate."""

    scene: Scene
    space: FunctionSpace
    frequencies: np.ndarray  # (motions,) [Hz]
    vectors: np.ndarray  # (unknowns, motions) [1/√kg]


class AirOnPlate:
    """The load of the air of a scene on the modes of its plate.

    Attributes:
        resonances: Frequencies, rising, and half-widths (modes,) [Hz] of the resonances in air.
    """

    def __init__(self, plate: BarePlate, table: AirLoad) -> None:
        """SceneError: the plate has too many modes for this machine's memory."""
        self._plate, self._air = plate, Air(table.density, table.sound_speed)
        self._sides, dry = {"both": 2, "front": 1}[table.sides], plate.frequencies
        highest = highest_asked(plate)
        count = min(int(np.clip((dry <= MOVING * highest).sum(), FEWEST, MOST)), dry.size)
        low = np.ix_(range(count), range(count))
        waves = Waves(Shapes(plate.scene, plate.space, dry[:count], plate.vectors[:, :count]))
        self._heavy = np.eye(count) + self._sides * self._air.density * waves.masses_per_density(0.0)
        squares, self._mixing = scipy.linalg.eigh(np.diag(plate.angular_frequencies[:count] ** 2), self._heavy)
        self._squares = np.maximum(squares, 0)
        self._damping, self._hysteretic = (
            self._mixing.T @ matrix[low] @ self._mixing for matrix in (plate.damping, plate.hysteretic)
        )
        wet = np.sqrt(self._squares) / (2 * math.pi)
        self._coupled = min(max(int((wet <= COUPLED * highest).sum()), FEWEST_COUPLED), count)
        mixing = self._mixing[:, : self._coupled]
        self._highest = max(highest, float(wet[self._coupled - 1]), 1.0)
        shapes = Shapes(plate.scene, plate.space, wet[: self._coupled], plate.vectors[:, :count] @ mixing)
        self._radiation, self._resistances = (Radiation(one, self._highest, self._air) for one in (shapes, plate))
        self._fit_masses(waves.mixed(mixing))
        self.resonances = self._find_resonances(wet)

    def _fit_masses(self, waves: Waves) -> None:
        """Interpolate the masses of one side less those at k = 0 by polynomials in k²."""
        wavenumber = float(self._air.wavenumber(self._highest))
        phase = wavenumber * math.hypot(*self._plate.scene.plate.size) / 2
        nodes = chebyshev.chebpts1(math.ceil(phase) + MORE_TERMS)
        at_rest = waves.masses_per_density(0.0)
        changes = [waves.masses_per_density(wavenumber * math.sqrt((node + 1) / 2)) - at_rest for node in nodes]
        vandermonde = chebyshev.chebvander(nodes, len(nodes) - 1)
        self._polynomials = np.linalg.solve(vandermonde, self._air.density * np.reshape(changes, (len(nodes), -1)))

    def _impedances(self, frequencies: np.ndarray) -> np.ndarray:
        """Return (n, coupled, coupled) Z [1/s] of modes in air, less the masses at k = 0, at frequencies (n,) [Hz]."""
        return self._sides * self._radiation.resistances(self._limited(frequencies)) + self._inertia(frequencies)

    def _inertia(self, frequencies: np.ndarray) -> np.ndarray:
        square = 2 * (self._limited(frequencies) / self._highest) ** 2 - 1
        changes = chebyshev.chebvander(square, len(self._polynomials) - 1) @ self._polynomials
        rate = 2j * math.pi * frequencies[:, None, None]
        return np.asarray(self._sides * rate * changes.reshape(-1, self._coupled, self._coupled))

    def _limited(self, frequencies: np.ndarray) -> np.ndarray:
        return np.minimum(frequencies, self._highest)

    def respond(self, omega: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return (n, modes, loads) amplitudes under forces (n, modes, loads) that vary as exp(iωt), ω (n,) [rad/s]."""
        blocks = [slice(start, start + BLOCK_FREQUENCIES) for start in range(0, len(omega), BLOCK_FREQUENCIES)]
        return np.concatenate([np.empty((0, *forces.shape[1:]), dtype=complex),
                               *(self._respond(omega[some], forces[some]) for some in blocks)])  # fmt: skip

    def _respond(self, omega: np.ndarray, forces: np.ndarray) -> np.ndarray:
        inverse = self._low_compliances(omega)
        losses = self._plate.damping + self._sides * self._resistances.resistances(self._limited(omega / (2 * math.pi)))
        return refined(
            self._approximate(omega, forces, inverse),
            forces,
            lambda rows, amplitudes: self._forces(omega[rows], amplitudes, losses[rows]),
            lambda rows, residual: self._approximate(omega[rows], residual, inverse[rows]),
        )

    def _low_compliances(self, omega: np.ndarray) -> np.ndarray:
        """Return (n, coupled, coupled) inverses of the dynamic stiffness of the lowest modes in air."""
        low, rate = slice(self._coupled), omega[:, None, None]
        losses = rate * (self._damping[low, low] + self._impedances(omega / (2 * math.pi)))
        stiffness = (self._squares[low] - rate**2) * np.eye(self._coupled)
        return np.linalg.inv(stiffness + 1j * (self._hysteretic[low, low] + losses))

    def _approximate(self, omega: np.ndarray, forces: np.ndarray, inverse: np.ndarray) -> np.ndarray:
        """Return the amplitudes of :meth:`respond` without the coupling of higher modes by the loss."""
        count, low = len(self._squares), slice(self._coupled)
        losses = omega[:, None] * np.diag(self._damping) + np.diag(self._hysteretic)
        amplitudes = np.asarray(forces / self._plate.dynamic_stiffness(omega)[:, :, None], dtype=complex)
        pushed = self._mixing.T @ forces[:, :count]
        wet = pushed / (self._squares - omega[:, None] ** 2 + 1j * losses)[:, :, None]
        wet[:, low] = inverse @ pushed[:, low]
        amplitudes[:, :count] = self._mixing @ wet
        return amplitudes

    def _forces(self, omega: np.ndarray, amplitudes: np.ndarray, losses: np.ndarray) -> np.ndarray:
        """Return the forces that amplitudes (n, modes, loads) balance, with losses (n, modes, modes) [1/s]."""
        plate, count, rate = self._plate, len(self._squares), omega[:, None, None]
        balanced = (plate.angular_frequencies[:, None] ** 2 - rate**2) * amplitudes
        real, imaginary = np.split(losses @ np.concatenate([amplitudes.real, amplitudes.imag], axis=2), 2, axis=2)
        balanced = balanced + rate * (1j * real - imaginary) + 1j * multiply_modes(plate.hysteretic, amplitudes)
        moved = multiply_modes(self._heavy, amplitudes[:, :count])
        rows = moved.mT @ self._mixing[:, : self._coupled]  # of modes in air
        change = self._mixing[:, : self._coupled] @ (self._inertia(omega / (2 * math.pi)) @ rows.mT)
        balanced[:, :count] += 1j * rate * (self._heavy @ change) - rate**2 * (moved - amplitudes[:, :count])
        return np.asarray(balanced)

    def _find_resonances(self, wet: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        count, frequencies = len(wet), np.concatenate([wet, self._plate.frequencies[len(wet) :]])
        viscous = np.append(np.diag(self._damping), np.diag(self._plate.damping)[count:])
        hysteretic = np.append(np.diag(self._hysteretic), np.diag(self._plate.hysteretic)[count:])
        for index in np.flatnonzero(wet[: self._coupled] > 0):
            for _ in range(2):
                load = self._impedances(frequencies[[index]])[0, index, index]
                mass = 1 + load.imag / (2 * math.pi * frequencies[index])
                frequencies[index] = wet[index] / math.sqrt(mass)
            viscous[index] = (viscous[index] + load.real) / mass
            hysteretic[index] /= mass
        omega = 2 * math.pi * np.where(frequencies > 0, frequencies, math.inf)
        return frequencies, (viscous + hysteretic / omega) / (4 * math.pi)


def refined(
    amplitudes: np.ndarray,
    forces: np.ndarray,
    balanced: Callable[[Rows, np.ndarray], np.ndarray],
    approximate: Callable[[Rows, np.ndarray], np.ndarray],
) -> np.ndarray:
    """Return amplitudes (n, modes, loads) that balance forces (n, modes, loads), from ones that nearly do, in place.

    ``balanced`` returns the forces of amplitudes at some of the n frequencies, ``approximate`` nearly its inverse.
    Where refinement does not end, as losses couple many modes, one system of all modes is solved.
    """
    left, limit = np.arange(len(forces)), RESIDUAL * np.linalg.norm(forces, axis=1)
    for _ in range(REFINEMENTS):
        rows: Rows = slice(None) if left.size == len(forces) else left
        residual = forces[rows] - balanced(rows, amplitudes[rows])
        more = (np.linalg.norm(residual, axis=1) > limit[rows]).any(axis=1)
        left = left[more]
        if not left.size:
            return amplitudes
        amplitudes[left] += approximate(left, residual[more])
    for row in left:
        system = balanced(np.array([row]), np.eye(forces.shape[1])[None])[0]
        amplitudes[row] = np.linalg.solve(system, forces[row])
    return amplitudes


def highest_asked(plate: BarePlate) -> float:
    """Return the frequency [Hz] up to which responses are asked for, of fewer functions, too."""
    return plate.highest / min(1.0, plate.scene.grid.modal_density)


class Waves:
    """Integrals of shapes times waves of the wavenumbers of the sum."""

    def __init__(self, shapes: PlateInBaffle) -> None:
        sides = shapes.scene.plate.size
        wave = math.sqrt(float(shapes.frequencies.max(initial=0.0)) / mean_wave_frequency(shapes.space.laminate))
        self.sides = sides
        self.counts = [6 * math.ceil(max(FEWEST_WAVES, PER_HALF_WAVE * wave * side) / 6) for side in sides]
        parts = _wave_integrals(shapes, self.counts)
        # (parts, counts along y + 1, counts along x + 1, shapes)
        self.values = np.array(parts)

    def mixed(self, mixing: np.ndarray) -> Waves:
        """Return the waves of sums of the shapes, the columns of a matrix (shapes, sums)."""
        waves = object.__new__(Waves)
        waves.sides, waves.counts, waves.values = self.sides, self.counts, self.values @ mixing
        return waves

    def masses_per_density(self, wavenumber: float) -> np.ndarray:
        """Return (shapes, shapes) M/ρ [m³/kg] at k [1/m]."""
        kernel = _kernel(self.sides, self.counts, wavenumber)
        reach = np.maximum.outer(*(np.arange(count + 1) / count for count in self.counts[::-1]))
        kernel *= (reach[:, :, None] <= PARTS) @ WEIGHTS
        values = self.values.reshape(-1, self.values.shape[-1])
        weights = np.tile(kernel.ravel(), len(self.values))
        return np.asarray(values.T @ (weights[:, None] * values)) / (8 * math.pi * math.prod(self.sides))


def _wave_integrals(plate: PlateInBaffle, counts: list[int]) -> list[np.ndarray]:
    """Return four arrays (counts along y + 1, counts along x + 1, modes) [m²/√kg]: integrals of the shapes times the
    cosines and sines of πpx/Lx and πqy/Ly from the middle of the plate's sides."""
    tables = []
    for count in counts:
        halves = math.pi * np.arange(count + 1) / 2
        orders = np.arange(math.ceil(1.1 * halves[-1] + 1.5 * FURTHER))
        table = (2 * orders + 1) * scipy.special.spherical_jn(orders, halves[:, None]) * (1 - orders // 2 % 2 * 2)
        tables.append(table)
    moments = plate.space.moments((tables[0].shape[1], tables[1].shape[1]))
    moments = moments @ plate.vectors[: plate.space.unknowns]
    parts = []
    for y in range(2):
        for x in range(2):
            along_x = np.tensordot(moments[y::2, x::2], tables[0][:, x::2], (1, 1))
            parts.append(np.moveaxis(np.tensordot(tables[1][:, y::2], along_x, (1, 0)), 1, 2))
    return parts


def _kernel(sides: tuple[float, float], counts: list[int], wavenumber: float) -> np.ndarray:
    """Return (counts along y + 1, counts along x + 1) G [m], times 2 for each of p and q above 0, for wavenumber k.

    Halves of a quarter of the rectangle, cut along its diagonal, are mapped to squares 0 < u, t < 1, in which r is a
    product u s(t) and u cancels (M. G. Duffy, SIAM J. Numer. Anal. 19, 1982, p. 1260).
    """
    total = 0.0
    for turned in (False, True):
        (a, b), (p, q) = (sides, counts) if not turned else (sides[::-1], counts[::-1])
        nodes, weights = np.polynomial.legendre.leggauss(2 * max(p, q) + FURTHER + math.ceil(wavenumber * (a + b)))
        nodes, weights = (nodes + 1) / 2, weights / 2
        reach = np.hypot(a, b * nodes)
        values = a * b / reach * np.cos(wavenumber * np.outer(nodes, reach)) * weights  # by u and t
        inner = np.array([row @ np.cos(math.pi * u * np.outer(nodes, np.arange(q + 1)))
                          for u, row in zip(nodes, values, strict=True)])  # fmt: skip
        part = (np.cos(math.pi * np.outer(np.arange(p + 1), nodes)) * weights) @ inner
        total = total + (part if turned else part.T)
    twice = (np.where(np.arange(count + 1) > 0, 2.0, 1.0) for count in counts[::-1])
    return np.asarray(4 * total * np.outer(*twice))

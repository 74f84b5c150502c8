"""Sound and air of a thin rectangular plate without a baffle, open at the back, by the jump of pressure across it.

The pressure is odd in z, so that with the jump Δp over the plate, zero beyond its edges, the velocity has the transform

    v = kz Δp/2ωρ,     kz = √(k² − κ²) or −i√(κ² − k²)

at a wavenumber κ in the plane. Δp is a sum of √(1 − x²) U_m(x) √(1 − y²) U_n(y), which fall to the edges as it does, by
Chebyshev polynomials of the second kind, whose transforms are Bessel functions. Galerkin's method gives the sum for the
velocity of the plate: that of B. Laulagnet (J. Acoust. Soc. Am. 103, 1998, p. 2451), with other functions. The power of
both sides is ½ Re ∫ Δp* v dA. The plate is taken as infinitely thin.

With P the integrals of functions times shapes and A those of kz ψ*ψ, the jump that a motion q makes presses on the
modes by −2iρω² PᵀA⁻¹P q, the load of ``[effects.air]``. Responses take that on the lowest modes alone, and without the
coupling of higher ones by damping; both are restored by iterative refinement.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import TypeAlias

import numpy as np
import scipy
from numpy.polynomial import chebyshev

from warp_plate.effects.air import AirLoad
from warp_plate.modal.air import BLOCK_FREQUENCIES, AirOnPlate, highest_asked, refined
from warp_plate.modal.poles import multiply_modes
from warp_plate.modal.radiation import AIR, FURTHER, Air, BarePlate, Radiation, distances_to
from warp_plate.modal.spaces.integrals import mean_wave_frequency
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# Functions of the jump along a side beyond one for each half-wave, and most of them.
MORE_FUNCTIONS, MOST_FUNCTIONS = 4, 28
# Largest wavenumber of integrals over waves that do not radiate, over π times functions per side: what lies beyond
# falls as its inverse, and is extrapolated from half of it.
REACH = 4.0
# Gauss's points of a panel of wavenumbers, and panels for each turn of a wave across the plate.
PANEL_POINTS, PANELS = 10, 0.3
# Modes whose resonances in air are computed: up to so many times the highest frequency, with the coupling by masses at
# rest of those up to twice as much, and at least.
RESONANT, COUPLED, FEWEST = 1.2, 2.0, 40
# Relative distance of the frequency that is taken for a natural one of an undamped plate.
BESIDE = 1e-8


class Unbaffled:
    """Power, pressure and far field of a plate without a baffle, for frequencies up to a highest one.

    SceneError: the plate is no rectangle, or has too many half-waves at the highest frequency [Hz].
    """

    def __init__(self, plate: BarePlate, highest: float, air: Air = AIR, key: str = "frequency_range") -> None:
        refuse_outline(plate.scene)
        self.plate, self.air, self._highest = plate, air, float(air.wavenumber(highest))
        self.sides = plate.scene.plate.size
        waves = [side * math.sqrt(highest / mean_wave_frequency(plate.space.laminate)) for side in self.sides]
        self._counts = [2 * math.ceil((wave + MORE_FUNCTIONS) / 2) for wave in waves]
        if max(self._counts) > MOST_FUNCTIONS:
            most = f"without a baffle at most {MOST_FUNCTIONS - MORE_FUNCTIONS} are possible; end the range lower"
            raise SceneError(f"{key}: {highest:g} Hz has {max(waves):.0f} half-waves along a side; {most}")

    def jumps(self, frequency: float, amplitudes: np.ndarray) -> np.ndarray:
        """Return (functions along y, along x, loads) coefficients of Δp [Pa] of modal amplitudes (modes, loads)."""
        rates = 2j * math.pi * frequency * amplitudes
        moved = np.tensordot(self.projection, rates, (2, 0))
        jumps = np.zeros(moved.shape, dtype=complex)
        for (y, x), matrix in zip(_PARITIES, self.matrices(frequency), strict=True):
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

    def matrices(self, frequency: float) -> list[np.ndarray]:
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


class AirWithoutBaffle:
    """The load of the air on the modes of a plate without a baffle.

    Attributes:
        resonances: Frequencies, rising, and half-widths (modes,) [Hz] of the resonances in air.
    """

    def __init__(self, plate: BarePlate, table: AirLoad) -> None:
        """SceneError: as of :class:`Unbaffled`."""
        dry = plate.frequencies
        self._plate, self._highest = plate, max(highest_asked(plate), float(dry[dry > 0].min(initial=1.0)))
        self._radiation = Unbaffled(plate, self._highest, Air(table.density, table.sound_speed), "effects.air.baffle")
        parts = self._radiation.projection
        # (functions, modes) of one parity after the other
        self._projection = np.concatenate([parts[y::2, x::2].reshape(-1, dry.size) for y, x in _PARITIES])
        self._low = min(max(int((dry <= RESONANT * self._highest).sum()), FEWEST), dry.size)
        self.resonances = self._find_resonances()

    def _system(self, frequency: float) -> np.ndarray:
        """Return (functions, functions) A [m] at a frequency [Hz]."""
        return scipy.linalg.block_diag(*self._radiation.matrices(min(frequency, self._highest)))

    def respond(self, omega: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return (n, modes, loads) amplitudes under forces (n, modes, loads) that vary as exp(iωt), ω (n,) [rad/s]."""
        amplitudes = np.empty(forces.shape, dtype=complex)
        for start in range(0, len(omega), BLOCK_FREQUENCIES):
            some = slice(start, start + BLOCK_FREQUENCIES)
            found = self._respond(omega[some], forces[some])
            beside = ~np.isfinite(found).all(axis=(1, 2))
            if beside.any():
                found[beside] = self._respond(omega[some][beside] * (1 + BESIDE), forces[some][beside])
            amplitudes[some] = found
        return amplitudes

    def _respond(self, omega: np.ndarray, forces: np.ndarray) -> np.ndarray:
        pressed = self._pressed(omega)
        held = self._held(omega, pressed)
        return refined(
            self._nearly(omega, forces, held),
            forces,
            lambda rows, amplitudes: self._balanced(omega[rows], amplitudes, pressed[rows]),
            lambda rows, residual: self._nearly(omega[rows], residual, held[rows]),
        )

    def _pressed(self, omega: np.ndarray) -> np.ndarray:
        """Return (n, functions, functions) 2iρω² A⁻¹ [N/m]: the forces of the jumps that motions make."""
        rows = []
        for one in omega.tolist():
            inverses = map(np.linalg.inv, self._radiation.matrices(min(one / (2 * math.pi), self._highest)))
            rows.append(2j * self._radiation.air.density * one**2 * scipy.linalg.block_diag(*inverses))
        return np.array(rows)

    def _held(self, omega: np.ndarray, pressed: np.ndarray) -> np.ndarray:
        """Return (n, low, low) (1 + Z Y)⁻¹ Z of the load Z of the air on the lowest modes and their compliance Y: what
        the air takes of forces that move them alone."""
        low = self._low
        projection = self._projection[:, :low]
        load = projection.T @ (pressed @ projection)
        if self._plate.coupled is None:
            with np.errstate(divide="ignore", invalid="ignore"):
                compliance = 1 / self._plate.dynamic_stiffness(omega)[:, None, :low]
            yielded = load * np.where(np.isfinite(compliance), compliance, 0)
        else:
            units = np.broadcast_to(
                np.eye(self._projection.shape[1], low), (len(omega), self._projection.shape[1], low)
            )
            yielded = load @ self._alone(omega, units)[:, :low]
        return np.linalg.solve(np.eye(low) + yielded, load)

    def _nearly(self, omega: np.ndarray, forces: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Return the amplitudes of :meth:`respond` without the air on higher modes and without their coupling."""
        forces = np.array(forces, dtype=complex)
        forces[:, : self._low] -= held @ self._alone(omega, forces)[:, : self._low]
        return self._alone(omega, forces)

    def _alone(self, omega: np.ndarray, forces: np.ndarray) -> np.ndarray:
        if self._plate.coupled is not None:
            return self._plate.coupled.approximate(omega, forces)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(forces / self._plate.dynamic_stiffness(omega)[:, :, None])

    def _balanced(self, omega: np.ndarray, amplitudes: np.ndarray, pressed: np.ndarray) -> np.ndarray:
        """Return the forces that amplitudes (n, modes, loads) balance."""
        if self._plate.coupled is not None:
            balanced = self._plate.coupled.balanced(omega, amplitudes)
        else:
            balanced = self._plate.dynamic_stiffness(omega)[:, :, None] * amplitudes
        return balanced + multiply_modes(self._projection.T, pressed @ multiply_modes(self._projection, amplitudes))

    def _find_resonances(self) -> tuple[np.ndarray, np.ndarray]:
        """Return resonances: of the modes with the masses at rest, each with its own load at its frequency."""
        plate, dry, density = self._plate, self._plate.frequencies, self._radiation.air.density
        count = min(max(int((dry <= COUPLED * self._highest).sum()), FEWEST), dry.size)
        projection, low = self._projection[:, :count], np.ix_(range(count), range(count))
        at_rest = 2 * density * projection.T @ np.linalg.solve(-self._system(0.0).imag, projection)
        squares, mixing = scipy.linalg.eigh(np.diag(plate.angular_frequencies[:count] ** 2), np.eye(count) + at_rest)
        frequencies = plate.frequencies.copy()
        frequencies[:count] = np.sqrt(np.maximum(squares, 0)) / (2 * math.pi)
        viscous, hysteretic = np.diag(plate.damping).copy(), np.diag(plate.hysteretic).copy()
        for values, matrix in ((viscous, plate.damping), (hysteretic, plate.hysteretic)):
            values[:count] = np.einsum("rm,rs,sm->m", mixing, matrix[low], mixing, optimize=True)
        for index in np.flatnonzero((frequencies[:count] > 0) & (frequencies[:count] <= RESONANT * self._highest)):
            moved, own = projection @ mixing[:, index], float((mixing[:, index] ** 2).sum())
            mass, rate = 1.0, 2 * math.pi * frequencies[index]
            for _ in range(2):
                load = 2j * density * moved @ np.linalg.solve(self._system(rate / (2 * math.pi)), moved)
                mass = own - load.real
                rate = math.sqrt(squares[index] / mass)
            frequencies[index] = rate / (2 * math.pi)
            viscous[index] = (viscous[index] + rate * load.imag) / mass
            hysteretic[index] /= mass
        omega = 2 * math.pi * np.where(frequencies > 0, frequencies, math.inf)
        order = np.argsort(frequencies)
        return frequencies[order], ((viscous + hysteretic / omega) / (4 * math.pi))[order]


AirLoads: TypeAlias = AirOnPlate | AirWithoutBaffle


def radiation_of(plate: BarePlate, highest: float, air: Air, baffle: bool) -> Radiation | Unbaffled:
    """Return the radiation of a plate in a baffle or without one, for frequencies up to a highest one [Hz]."""
    return Radiation(plate, highest, air) if baffle else Unbaffled(plate, highest, air)


def air_on(plate: BarePlate, table: AirLoad) -> AirLoads:
    """Return the load of the air on a plate."""
    return AirOnPlate(plate, table) if table.baffle else AirWithoutBaffle(plate, table)


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

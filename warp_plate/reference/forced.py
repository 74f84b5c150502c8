"""Plates driven from rest by harmonic patches, exactly in time: displacement, kinetic energies, localization factor.

Every mode of :mod:`warp_plate.reference.ritz` is an oscillator under its share f of a unit pressure Re(exp(iωt)),

    ρH (q̈ + 2γ q̇ + Ω² q) = f Re(exp(iωt)),   γ = c/2ρH,   q = q̇ = 0 at t = 0,

and its motion is the real part of a sum of three exponentials,

    q = f Σ_j α_j exp(s_j t),   s = iω, −γ + μ, −γ − μ,   μ² = γ² − Ω²,
    α_0 = 1/(ρH (Ω² − ω² + 2iγω)),   α_1 = α_0 (s_2 − iω)/2μ,   α_2 = α_0 (iω − s_1)/2μ.

Time averages of products of two of them are closed forms: nothing is stepped or sampled. A scene is linear in its
drives; with z = (Re Z_1 ... Re Z_M, −Im Z_1 ... −Im Z_M) the energies are zᵀA z in the target and zᵀB z in the
plate, the localization factor is their ratio, and the largest eigenvalue of A z = λ B z bounds it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from warp_plate.reference.ritz import Modes
from warp_plate.scene.model import Scene

# Smallest |μ|, in units of one over the longest time: a critically damped mode, or a rigid one without damping, is then
# off by some 1e-11, and as much is lost where its two exponentials cancel.
SMALLEST_SPLIT = 1e-5
# Drives with less than this part of the largest plate energy cancel out; their ratio is one of rounding errors.
RANK_TOLERANCE = 1e-10


@dataclass(frozen=True)
class ModalMotion:
    """Motion of modes from rest under a unit force exp(iωt): Σ_j amplitudes_j exp(exponents_j t)."""

    exponents: tuple[np.ndarray, np.ndarray, np.ndarray]  # (1,) of the drive, and twice (modes,) [1/s]
    amplitudes: tuple[np.ndarray, np.ndarray, np.ndarray]  # Thrice (modes,) [m³/N for modal forces in m]

    def at(self, times: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Return (times, modes) complex values of a derivative at times [s]."""
        parts = zip(self.exponents, self.amplitudes, strict=True)
        when = np.asarray(times, dtype=float)[:, None]
        return np.sum([a * s**derivative * np.exp(s * when) for s, a in parts], axis=0)


def motion_from_rest(modes: Modes, frequency: float, longest: float) -> ModalMotion:
    """Return the motion of all modes under exp(iωt), ω/2π = ``frequency`` [Hz], up to the time ``longest`` [s].

    Raises:
        ValueError: An undamped mode is driven at its natural frequency.
    """
    plate, natural, omega = modes.plate, modes.angular_frequencies, 2 * math.pi * frequency
    dynamic = plate.surface_density * (natural - omega) * (natural + omega) + 1j * plate.viscous * omega
    if np.any(dynamic == 0):
        raise ValueError(f"frequency = {frequency:g} Hz: the undamped plate is driven at a natural frequency")
    steady, drive, gamma = 1 / dynamic, 1j * omega, plate.viscous / (2 * plate.surface_density)
    split = np.sqrt(gamma**2 - natural**2 + 0j)
    floor = SMALLEST_SPLIT / longest
    kept = np.abs(split) > floor
    split = np.where(kept, split, floor)
    # The slow one as a quotient: −γ + μ would cancel for strong damping.
    slow, fast = np.where(kept, -(natural**2) / (gamma + split), split - gamma), -gamma - split
    return ModalMotion(
        exponents=(np.array([drive]), slow, fast),
        amplitudes=(steady, steady * (fast - drive) / (2 * split), steady * (drive - slow) / (2 * split)),
    )


def displacement(
    modes: Modes, scene: Scene, drive: np.ndarray, times: Sequence[float], x: np.ndarray, y: np.ndarray
) -> np.ndarray:
    """Return (times, points of y, points of x) displacement [m] at times [s], from rest at t = 0.

    Args:
        drive: (actuators,) phasors Z [N/m²], the load being Re(Z exp(iωt)) on each patch.
        times: Times [s].
        x: (points of x,) [m].
        y: (points of y,) [m].
    """
    force = np.asarray(drive) @ modes.patch_forces([actuator.area for actuator in scene.actuators])
    motion = motion_from_rest(modes, scene.drive.frequency, max(scene.window.end, *times))
    amplitudes = (force * motion.at(np.asarray(times))).real
    return np.einsum("tm,mji->tji", amplitudes, modes.shapes(x, y), optimize=True)


def transient_matrices(modes: Modes, scene: Scene) -> np.ndarray:
    """Return (2, 2M, 2M) matrices of plate and target: zᵀ matrix z is the energy averaged over the scene's window [J].

    Raises:
        SceneError: The target is not a rectangle.
    """
    start, end = scene.window.start, scene.window.end
    motion = motion_from_rest(modes, scene.drive.frequency, end)
    forces = modes.patch_forces([actuator.area for actuator in scene.actuators])
    parts = [(s, s * a * forces) for s, a in zip(motion.exponents, motion.amplitudes, strict=True)]
    matrices = []
    for overlaps in (None, modes.overlaps(scene.target.rectangle())):
        both = np.zeros((2, len(forces), len(forces)), dtype=complex)
        for i, (first, first_rate) in enumerate(parts):
            for j, (second, second_rate) in enumerate(parts[i:], start=i):
                plain = _average(first, first_rate, second, second_rate, overlaps, start, end)
                conjugate = _average(first.conj(), first_rate.conj(), second, second_rate, overlaps, start, end)
                both += [plain, conjugate]
                if j > i:
                    both += [plain.T, conjugate.T.conj()]
        matrices.append(_real_matrix(*both))
    return 0.5 * modes.plate.surface_density * np.array(matrices)


def localization_factors(matrices: np.ndarray, drives: np.ndarray) -> np.ndarray:
    """Return (drives,) share of the energy in the target under phasors (drives, actuators) [N/m²]."""
    drives = np.asarray(drives, dtype=complex)
    z = np.concatenate([drives.real, -drives.imag], axis=1)
    plate, target = np.einsum("da,rab,db->rd", z, matrices, z, optimize=True)
    return target / plate


def bound(matrices: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the largest localization factor of any drive, and (actuators,) phasors that reach it, at most one."""
    plate, target = matrices
    size = np.sqrt(np.diag(plate))
    values, vectors = scipy.linalg.eigh(plate / np.outer(size, size))
    kept = values > RANK_TOLERANCE * values[-1]
    basis = vectors[:, kept] / np.sqrt(values[kept]) / size[:, None]
    ratios, directions = scipy.linalg.eigh(basis.T @ target @ basis)
    cosine, sine = np.split(basis @ directions[:, -1], 2)
    best = cosine - 1j * sine
    return float(ratios[-1]), best / np.abs(best).max()


def _average(
    first: np.ndarray,
    first_rate: np.ndarray,
    second: np.ndarray,
    second_rate: np.ndarray,
    overlaps: np.ndarray | None,
    start: float,
    end: float,
) -> np.ndarray:
    """Return (M, M) sums over modes m, n of rate_m rate_n overlap_mn times the average of exp((s_m + s_n) t).

    ``overlaps`` = None stands for those of the whole plate, one for m = n, else zero.
    """
    if overlaps is None:
        return (first_rate * _mean_exponential(first, second, start, end)) @ second_rate.T
    return first_rate @ (overlaps * _mean_exponential(first[:, None], second, start, end)) @ second_rate.T


def _mean_exponential(first: np.ndarray, second: np.ndarray, start: float, end: float) -> np.ndarray:
    """Return the average of exp((first + second) t) from start to end, broadcast; real parts are not positive."""
    turn = (first + second) * (end - start)
    late, early = np.exp(first * end) * np.exp(second * end), np.exp(first * start) * np.exp(second * start)
    small = np.abs(turn) < 1e-3
    near, turn[small] = turn[small], 1
    mean: np.ndarray = (late - early) / turn
    # (exp(z) − 1)/z by its series, where the quotient would cancel; the next term is below 1e-14.
    mean[small] = early[small] * (1 + near / 2 * (1 + near / 3 * (1 + near / 4)))
    return mean


def _real_matrix(plain: np.ndarray, conjugate: np.ndarray) -> np.ndarray:
    """Return (2M, 2M) averages of products of Re and Im parts, from averages of X_k X_l and of conj(X_k) X_l."""
    real = (conjugate + plain).real / 2
    imaginary = (conjugate - plain).real / 2
    mixed = (conjugate + plain).imag / 2
    return np.block([[real, mixed], [mixed.T, imaginary]])

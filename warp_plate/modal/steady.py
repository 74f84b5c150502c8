"""Steady responses at many frequencies, also where damping couples the modes.

Without coupling each mode responds alone. With it, the lowest modes are those of their own reduced system, whose
transfer matrix is a sum over its poles,

    (−ω² + iωC + Λ + iH)⁻¹ = Σ_p ψ_p χ_p / (iω − s_p),   (s² + sC + Λ + iH) ψ = 0

(:mod:`warp_plate.modal.poles`), and all others are taken as uncoupled. What that leaves out is restored by iterative
refinement with the full matrices (G. H. Golub and C. F. Van Loan, Matrix Computations, 4th edition, section 3.5.3);
frequencies at which it does not converge are solved directly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from warp_plate.modal.modes import ModalPlate, times
from warp_plate.modal.poles import coupled_poles

# Modes that are coupled beforehand: those up to REACH times the highest frequency, within these limits.
REACH, FEWEST, MOST = 1.5, 250, 500
# Residual of the forces, relative, after at most so many refinements.
RESIDUAL, REFINEMENTS = 1e-6, 12
# Rigid motions count as slower than the fastest mode by this factor.
SLOWEST = 1e-9


@dataclass(frozen=True)
class SteadyPlate:
    """A plate with the poles of its lowest modes.

    Attributes:
        plate: Modes of the plate.
        poles: (poles,) s [1/s] of the modes that are coupled beforehand; none if no modes are coupled.
        vectors: (coupled modes, poles) free motions ψ.
        inputs: (poles, coupled modes) χ, by which forces excite them.
    """

    plate: ModalPlate
    poles: np.ndarray
    vectors: np.ndarray
    inputs: np.ndarray

    @property
    def resonances(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies and half-widths [Hz] of all resonances, or of the coupled modes alone if there are any."""
        if not self.poles.size:
            return self.plate.frequencies, self.plate.damping_ratios * self.plate.frequencies
        turning = self.poles[self.poles.imag > 0] / (2 * math.pi)
        return turning.imag, np.maximum(-turning.real, 0)

    def respond(self, frequencies: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return (frequencies, modes, loads) amplitudes as :meth:`ModalPlate.respond` does, in less time."""
        if not self.poles.size:
            return self.plate.respond(frequencies, forces)
        wanted = np.broadcast_to(forces, (len(frequencies), *forces.shape)).astype(complex)
        amplitudes, left = self._approximate(frequencies, wanted), np.arange(len(frequencies))
        limit = RESIDUAL * np.linalg.norm(forces, axis=0)
        for _ in range(REFINEMENTS):
            residual = wanted[left] - self._dynamic(frequencies[left], amplitudes[left])
            open_ = (np.linalg.norm(residual, axis=1) > limit).any(axis=1)
            left, residual = left[open_], residual[open_]
            if not left.size:
                return amplitudes
            amplitudes[left] += self._approximate(frequencies[left], residual)
        amplitudes[left] = self.plate.respond(frequencies[left], forces)
        return amplitudes

    def _approximate(self, frequencies: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return the amplitudes under forces (frequencies, modes, loads) without the coupling of the highest modes."""
        omega, count = 2 * math.pi * frequencies, len(self.vectors)
        amplitudes = forces / self.plate.dynamic_stiffness(omega)[:, :, None]
        shares = self.inputs @ forces[:, :count] / (1j * omega[:, None] - self.poles)[:, :, None]
        amplitudes[:, :count] = self.vectors @ shares
        return amplitudes

    def _dynamic(self, frequencies: np.ndarray, amplitudes: np.ndarray) -> np.ndarray:
        """Return the forces that amplitudes (frequencies, modes, loads) balance."""
        turn, plate = 2j * math.pi * frequencies[:, None, None], self.plate
        inertia = (plate.angular_frequencies[:, None] ** 2 + turn**2) * amplitudes
        damped = turn * times(plate.damping, amplitudes)
        return inertia + damped + 1j * (times(plate.hysteretic, amplitudes) if plate.hysteretic.any() else 0)


def make_steady(plate: ModalPlate, highest: float) -> SteadyPlate:
    """Return a plate for steady responses up to a frequency [Hz]."""
    if plate.proportional:
        return SteadyPlate(plate, np.zeros(0, complex), np.zeros((0, 0), complex), np.zeros((0, 0), complex))
    count = int(np.clip((plate.frequencies <= REACH * highest).sum(), FEWEST, MOST))
    kept, square = np.s_[:count, :count], plate.angular_frequencies[:count] ** 2
    damping, hysteretic = plate.damping[kept], plate.hysteretic[kept]
    unit = np.sqrt(np.maximum(square, SLOWEST**2 * square[-1]))
    stiffness: np.ndarray = np.diag(square)
    if hysteretic.any():
        stiffness = stiffness + 1j * hysteretic
    return SteadyPlate(plate, *coupled_poles(stiffness, damping, unit))

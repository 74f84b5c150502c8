"""Slopes of quadratic forms of a plate's motion by its matrices, by the adjoint method, for one tone of all actuators.

With M, C, K the matrices of :mod:`warp_plate.modal.assemble`, H = ηB of a loss factor and D(s) = s²M + sC + K + iH,
a change of the matrices changes the steady amplitudes q, D(iω) q = f, and a form ¼ v̄ᵀGv of v = (iω)ⁿ q by

    δE = ¼ v̄ᵀ δG v + Re λᵀ (δf − δD q),     D λ = ½ (iω)ⁿ G v̄,

so that one more solution serves all changes and all forms: n = 1 is a kinetic energy, n = 0 and 2 the same of
displacements and accelerations, and G = 2R, R the radiation resistances of the functions, the sound power. The power
½ Re f̄ᵀ iωq that drives feed has D λ = ½ iω f̄. The load of air in a steady state adds to D what does not change.

From rest, with the poles s_p, free motions ψ_p and inputs χ_p of :mod:`warp_plate.modal.poles`, the motion under the
load Re f exp(σt) is the real part of

    v = Σ_p ψ_p (χ_p f) φ(s_p),     φ = the divided difference of ξⁿ exp(ξt) at s_p and σ,

and by δ(D⁻¹) = −D⁻¹ δD D⁻¹ and the theorem of residues a change δX of the matrix X of s^k in D changes it by

    δv = −Σ_pp' ψ_p (χ_p δX ψ_p') (χ_p' f) φ_k(s_p, s_p'),     φ_k = that of ξ^(k+n) exp(ξt) at s_p, s_p' and σ.

The means ⟨Re vᵀG δv⟩ over the window are then products of matrices with closed formulas for exponentials. Where poles
nearly coincide, the divided difference is the mean of the derivatives at both.

From rest the lowest modes alone are taken. A change turns them towards the others, φ_s:

    δφ_r = Σ_s φ_s (φ_sᵀ (δK − ω_r² δM) φ_r) / (ω_r² − ω_s²)

(R. B. Nelson, AIAA J. 14, 1976, pp. 1201-1205), so that slopes are those of the truncated energies. A mode within the
others needs no slope of its own: energies do not depend on the basis of a space.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from warp_plate.effects.effect import per_mode
from warp_plate.modal.assemble import Galerkin
from warp_plate.modal.coils import feeding
from warp_plate.modal.eigenproblem import FLEXIBLE, solve_eigenproblem
from warp_plate.modal.gram import mean_exponential, mean_exponential_with_time
from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.poles import Poles
from warp_plate.modal.sensitivity.forms import REGIONAL, PlateForms, PlateMatrices, plate_matrices
from warp_plate.modal.spaces.integrals import mean_wave_frequency
from warp_plate.scene.errors import SceneError
from warp_plate.scene.grid import Window
from warp_plate.scene.model import Scene

# Modes that count from rest: those up to REACH times the drive's frequency, at least FEWEST, and up to so many more
# that the gap to the next one is wide.
REACH, FEWEST, MORE = 3.0, 40, 8
# Poles closer than this part of one over the end of the window count as coincident.
COINCIDENT = 1e-3


def check_differentiable(scene: Scene, steady: bool = False) -> None:
    """Raise a SceneError, naming the key, unless slopes of a scene, in a ``steady`` state or not, are known."""
    steady = steady or scene.steady
    if (key := scene.nonlinear_table or scene.nonperiodic_key) is not None:
        raise SceneError(f"{key}: slopes are known for one tone of all actuators on a linear plate; delete it")
    if scene.coil_indices and not steady:
        key = f"actuators[{scene.coil_indices[0]}].kind"
        raise SceneError(f'{key} = "coil": slopes are known in a steady state; write design.steady = true')
    if scene.effects.air is not None and not scene.effects.air.baffle:
        raise SceneError("effects.air.baffle: false: slopes are known in a baffle; delete it")
    damped = [(key, getattr(row, name)) for key, row in scene.effects.rows for name in row.damping_keys]
    for key in (key for key, value in damped if isinstance(value, tuple)):
        raise SceneError(f"{key}: slopes are not known for a number for each mode; write one for all")


@dataclass(frozen=True)
class AirBeside:
    """Air beside the functions of a space at a frequency, which changes of the plate do not change."""

    radiating: np.ndarray  # (rows, unknowns) F of the A-weighted sound ½ ‖F v‖² [W]
    impedance: np.ndarray | None = None  # (unknowns, unknowns) Z of the load −Z v [N·s/m]; None in vacuo


class EnergyAdjoint(PlateForms):
    """The forms of a plate over the functions of a space, and their slopes by its matrices.

    Args:
        galerkin: Matrices of the plate.
        of_plate: Dense arrays in their place, of any plate over the space, without bending energies from curvatures.
        steady: Take the steady state, whatever the scene's window.
        air: Air beside the plate, of scenes with ``[effects.air]`` and for the sound.

    Raises:
        SceneError: The plate buckles, or slopes are not known, see :func:`check_differentiable`.
    """

    def __init__(
        self,
        galerkin: Galerkin,
        of_plate: PlateMatrices | None = None,
        steady: bool = False,
        air: AirBeside | None = None,
    ) -> None:
        scene = galerkin.scene
        check_differentiable(scene, steady)
        self._all = plate_matrices(galerkin) if of_plate is None else of_plate
        self._lost, self._air = galerkin.losses, air
        omega, steady = scene.drive.angular_frequency, steady or scene.steady
        lowest = mean_wave_frequency(galerkin.space.laminate) / max(scene.plate.size) ** 2
        unknowns = galerkin.mass.shape[0]
        scale = (2 * math.pi * lowest) ** 2
        squares, vectors = solve_eigenproblem(galerkin, unknowns, scale, improve=of_plate is None, flexible=0.0)
        few = squares[: np.searchsorted(squares, (squares[0] + scale) / FLEXIBLE)]
        count = squares.size if steady else _count_modes(few, REACH * omega)
        self._squares, self._vectors = squares, vectors
        phi, natural = vectors[:, :count], np.sqrt(np.maximum(squares[:count], 0))
        bending = phi.T @ self._all.bending @ phi
        damping = phi.T @ self._all.damping @ phi + self._lost.retardation * bending
        if self._lost.ratios is not None:
            damping[np.diag_indices_from(damping)] += 2 * per_mode(self._lost.ratios, count) * natural
        loss = self._lost.hysteretic * bending
        highest = scene.drive.frequency
        plate = ModalPlate(galerkin, natural / (2 * math.pi), phi, damping, loss, highest, negligible=0.0)
        super().__init__(plate, steady)

    @cached_property
    def _regions(self) -> np.ndarray:
        return np.stack([self.plate.vectors.T @ region @ self.plate.vectors for region in self._all.regions])

    @cached_property
    def _forces(self) -> np.ndarray:
        return np.asarray(self.plate.vectors.T @ self._all.forces)

    @cached_property
    def _radiating(self) -> np.ndarray:
        assert self._air is not None
        return self._air.radiating @ self.plate.vectors[: self._air.radiating.shape[1]]

    @cached_property
    def _amplitudes(self) -> np.ndarray:
        return np.asarray(scipy.linalg.lu_solve(self._factors, self._forces * self._gains))

    @cached_property
    def _factors(self) -> tuple[np.ndarray, np.ndarray]:
        """Factors of the dynamic stiffness, which all adjoint solutions share."""
        return scipy.linalg.lu_factor(self._dynamic)

    @cached_property
    def _gains(self) -> np.ndarray:
        """(M,) forces of unit drives in units of the loads."""
        gains = np.ones(self._forces.shape[1], dtype=complex)
        gains[self.scene.coil_indices] = self._all.coils[1]
        return gains

    @cached_property
    def _dynamic(self) -> np.ndarray:
        """(modes, modes) dynamic stiffness at the drive's frequency, with coils and air."""
        plate, omega = self.plate, self._omega
        dynamic = np.diag(plate.angular_frequencies**2 - omega**2) + 1j * (omega * plate.damping + plate.hysteretic)
        if self.scene.coil_indices:
            patches = self._forces[:, self.scene.coil_indices]
            dynamic = dynamic + (patches * self._all.coils[0]) @ patches.T
        if self._air is not None and self._air.impedance is not None:
            phi = plate.vectors[: len(self._air.impedance)]
            dynamic = dynamic + 1j * omega * (phi.T @ self._air.impedance @ phi)
        return dynamic

    @property
    def natural(self) -> np.ndarray:
        """Natural frequencies [Hz] of the undamped plate, rising."""
        return np.asarray(np.sqrt(np.maximum(self._squares, 0)) / (2 * math.pi))

    @property
    def shapes(self) -> np.ndarray:
        """(unknowns, modes) shapes of the undamped plate at its ``natural`` frequencies."""
        return self._vectors

    @property
    def without_slopes(self) -> PlateMatrices:
        """Slopes of 0 by all entries."""
        all_of = self._all
        square, *others = (np.zeros_like(each) for each in (all_of.mass, all_of.regions, all_of.forces, all_of.coils))
        return PlateMatrices(square, square, square, square, *others)

    def frequency_slopes(self, indices: np.ndarray, weights: np.ndarray) -> PlateMatrices:
        """Return the slopes of Σ ``weights`` times the logarithms of natural frequencies, by δλ = φᵀ(δK − λ δM)φ.

        Equal frequencies have slopes only together, with equal weights.
        """
        squares, shapes = self._squares[indices], self._vectors[:, indices]
        stiffness = (shapes * (weights / (2 * squares))) @ shapes.T
        mass = -(shapes * (weights / 2)) @ shapes.T
        return replace(self.without_slopes, mass=mass, bending=stiffness, support=stiffness)

    def slopes(self, phasors: np.ndarray, weights: Mapping[str, float]) -> PlateMatrices:
        """Return the slopes of Σ weight times form of phasors (M,), by the names of forms."""
        phi, omega = self.plate.vectors, self.plate.angular_frequencies
        # In a steady state two motions say all: they are taken over the unknowns before matrices are formed.
        formed = self.window is None and self._lost.ratios is None
        if self.window is None:
            by = self._steady(phasors, weights, phi if formed else np.eye(omega.size))
        else:
            by = self._from_rest(phasors, weights, self.window)

        def over(matrices: np.ndarray) -> np.ndarray:
            return matrices if formed else phi @ matrices @ phi.T

        of_stiffness, of_mass, of_damping, of_loss = ((part + part.T) / 2 for part in by.dynamic)
        bending = self._lost.retardation * of_damping + self._lost.hysteretic * of_loss
        turned = self._turned(of_damping, bending, by)
        if self._lost.ratios is not None:  # C = 2ζ M (M⁻¹K)^½
            both = 2 * self._lost.ratios * of_damping / np.maximum(omega[:, None] + omega, np.finfo(float).tiny)
            of_stiffness, of_mass = of_stiffness + both, of_mass + np.outer(omega, omega) * both
        stiffness, mass = over(of_stiffness), over(of_mass)
        if turned is not None:
            rest, shares = turned
            stiffness += _symmetric(rest @ shares @ phi.T)
            mass -= _symmetric(rest @ (shares * omega**2) @ phi.T)
        return PlateMatrices(
            mass=mass,
            bending=stiffness + over(bending),
            support=stiffness,
            damping=over(of_damping),
            regions=over(by.regions),
            forces=by.forces if formed else phi @ by.forces,
            coils=by.coils,
        )

    def _turned(
        self, damping: np.ndarray, bending: np.ndarray, by: ModalSlopes
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the modes φ_s that are left out, and the slopes (modes left out, modes) by the φ_sᵀ δK φ_r that turn
        the others towards them; None if all modes count."""
        count, phi, all_of = len(self.plate.frequencies), self.plate.vectors, self._all
        if count == self._squares.size:
            return None
        rest = self._vectors[:, count:]
        energy = (all_of.regions @ phi @ by.regions).sum(axis=0)
        towards = all_of.damping @ phi @ damping + all_of.bending @ phi @ bending + energy
        shares = rest.T @ (2 * towards + all_of.forces @ by.forces.T)
        return rest, shares / (self._squares[:count] - self._squares[count:, None])

    def _steady(self, phasors: np.ndarray, weights: Mapping[str, float], basis: np.ndarray) -> ModalSlopes:
        """Return the slopes by matrices over the functions of a basis (functions, modes)."""
        motion = self._amplitudes @ phasors
        load, sizes = np.zeros(motion.shape, dtype=complex), np.zeros(len(self._regions))
        for name, weight in weights.items():
            if name in REGIONAL:
                order, region = REGIONAL[name]
                size = weight * self._omega ** (2 * order)
                load += size / 2 * (self._regions[region] @ motion.conj())
                sizes[region] += size / 4
            elif name == "sound":
                load += weight * self._omega**2 * (self._radiating.T @ (self._radiating @ motion.conj()))
        power, coils = weights.get("power", 0.0), self.scene.coil_indices
        fed = power / 2 * feeding(self.scene, self._omega)[1] * phasors.conj()
        adjoint = scipy.linalg.lu_solve(self._factors, load + self._forces @ fed)
        patches = self._forces[:, coils]
        moved, pulled = patches.T @ motion, patches.T @ adjoint
        motion, adjoint = basis @ motion, basis @ adjoint
        by = -np.outer(adjoint, motion)
        forces = np.outer(adjoint, self._gains * phasors) + np.outer(motion, fed)
        numbers = np.zeros((3, len(coils)), dtype=complex)
        if coils:
            stiffness = self._all.coils[0]
            forces[:, coils] -= stiffness * (np.outer(adjoint, moved) + np.outer(motion, pulled))
            of_gain = pulled * phasors[coils] + fed[coils] / self._all.coils[1] * moved
            numbers = np.stack([-pulled * moved, of_gain, power / 2 * np.abs(phasors[coils]) ** 2]).conj()
        dynamic = (by.real, -(self._omega**2) * by.real, -self._omega * by.imag, -by.imag)
        regions = sizes[:, None, None] * np.outer(motion.conj(), motion).real
        return ModalSlopes(dynamic, forces.real, regions, numbers)

    def _from_rest(self, phasors: np.ndarray, weights: Mapping[str, float], window: Window) -> ModalSlopes:
        """Return the slopes over a window; those by H are zero."""
        poles, force = self.plate.poles(window.end), self._forces @ phasors
        exponents, plain, with_time = self._means
        gains = poles.gains(force[:, None])[:, 0]
        rate, vectors, values = exponents[0], poles.vectors, poles.values
        gap = 1 / (rate - values)
        dynamic, regions = np.zeros((4, *self._regions.shape[1:])), np.zeros_like(self._regions)
        by_force = np.zeros(force.shape, dtype=complex)
        for order in {REGIONAL[name][0] for name in weights}:
            some = {name: weight for name, weight in weights.items() if REGIONAL[name][0] == order}
            region = sum(weight * self._regions[REGIONAL[name][1]] for name, weight in some.items())
            free = -vectors * (gains * gap * values**order)
            motion = np.column_stack([vectors @ (gains * gap) * rate**order, free])
            momenta = vectors.T @ region @ np.hstack([motion, motion.conj()]) / 2
            forced, loaded = np.split(momenta @ plain, [1], axis=1)
            forced, resting = forced[:, 0], momenta @ with_time
            mean = (np.hstack([motion, motion.conj()]) @ plain @ motion.T).real / 4
            for name, weight in some.items():
                regions[REGIONAL[name][1]] += weight * mean
            for part, power in zip(dynamic, (order, order + 2, order + 1), strict=False):
                kernel = self._kernel(poles, rate, power, (forced, loaded, resting), window)
                part -= (poles.inputs.T @ (kernel * gains) @ vectors.T).real
            by_force += poles.inputs.T @ ((forced * rate**order - np.diag(loaded) * values**order) * gap)
        forces = np.outer(by_force, phasors).real
        return ModalSlopes(dynamic, forces, regions, np.zeros_like(self._all.coils))

    @cached_property
    def _means(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Exponents σ and s_p, and the means over the window of exp(ξt) for sums ξ of one of them or its conjugate with
        one of them, and of t exp(ξt) with one of the s_p."""
        assert self.window is not None
        poles = self.plate.poles(self.window.end)
        rate = poles.shift_rates(np.array([1j * self._omega]), self.window.end)
        exponents = np.concatenate([rate, poles.values])
        both = np.concatenate([exponents, exponents.conj()])[:, None]
        forced = mean_exponential(both, rate, self.window)
        plain, with_time = mean_exponential_with_time(both, poles.values, self.window)
        return exponents, np.hstack([forced, plain]), with_time

    @staticmethod
    def _kernel(
        poles: Poles, rate: complex, power: int, means: tuple[np.ndarray, np.ndarray, np.ndarray], window: Window
    ) -> np.ndarray:
        """Return (poles, poles) ⟨ψ_pᵀ G Re v · divided difference of ξ^power exp(ξt) at s_p, s_p' and σ⟩."""
        forced, loaded, resting = means
        values = poles.values
        gap = 1 / (rate - values)
        first = (forced[:, None] * rate**power - loaded * values**power) * gap
        slope = (first - power * values ** max(power - 1, 0) * loaded - values**power * resting) * gap
        apart = values[:, None] - values
        close = np.abs(apart) < COINCIDENT / window.end
        differences = (np.diag(first)[:, None] - first) / np.where(close, 1, apart)
        return np.where(close, (np.diag(slope)[:, None] + slope) / 2, differences)


@dataclass(frozen=True)
class ModalSlopes:
    """Slopes of a number by the matrices of modes."""

    dynamic: np.ndarray | tuple[np.ndarray, ...]  # (4, modes, modes) by K, M, C and H
    forces: np.ndarray  # (modes, M) by the loads
    regions: np.ndarray  # (2, modes, modes) by those of plate and target: weight times ½⟨v vᵀ⟩
    coils: np.ndarray  # (3, coils) as of :class:`PlateMatrices`


def _symmetric(matrix: np.ndarray) -> np.ndarray:
    return (matrix + matrix.T) / 2


def _count_modes(squares: np.ndarray, highest: float) -> int:
    """Return how many of the modes with ω² (modes,) [1/s²], rising, count up to ``highest`` [rad/s]."""
    least = max(FEWEST, int(np.searchsorted(squares, highest**2)))
    if least + MORE >= squares.size:
        return int(squares.size)
    gaps = np.diff(np.sqrt(squares[least - 1 : least + MORE]))
    return least + int(gaps.argmax())

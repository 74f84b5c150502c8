"""Natural modes of a scene's plate, and what they say of its motion.

    K φ = ω² M φ,     Φᵀ M Φ = 1,     u = Σ_r φ_r(x, y) q_r(t),     q̈ + C q̇ + (Λ + iH) q = Φᵀ f

With the matrices of :mod:`warp_plate.modal.galerkin`, Λ = diag(ω_r²) and C = Φᵀ C Φ, which is not diagonal where
dampers sit on patches or the plate's mass varies. H is the imaginary part of the stiffness of a plate with a constant
loss factor, which has steady responses alone. All modes of a small plate are kept, so that nothing is truncated; of a
large one those that matter below a frequency, by Lanczos' method.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from warp_plate.modal.galerkin import Galerkin, make_galerkin, patch_integrals
from warp_plate.modal.regions import region_matrix
from warp_plate.plate.signals import highest_frequency
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import Area
from warp_plate.scene.model import Scene
from warp_plate.scene.target import Target

# Intervals between knots along the longer side: at least so many, and so many for each half-wave at the highest
# frequency; along the shorter side fewer, but of less size.
FEWEST, PER_HALF_WAVE = 18, 2.6
MOST_INTERVALS = 400
# Up to so many unknowns, all modes are computed at once; beyond, those up to REACH times the highest frequency.
DENSE, REACH = 1500, 4.0
# Frequencies below this part of √(D/ρH)(π/longer side)² are those of rigid motions.
STILL = 1e-4
# Damping that couples two modes by less than this part of their own has no effect; by less than the other of the
# largest of all modes, it is rounding.
PROPORTIONAL, ROUNDING = 1e-6, 1e-13


@dataclass(frozen=True)
class ModalPlate:
    """Modes of a scene's plate by rising frequency, mass-normalised.

    Attributes:
        galerkin: Matrices that they come from.
        frequencies: (modes,) natural frequencies of the undamped plate [Hz], 0 for rigid motions.
        vectors: (unknowns, modes) Φ [1/√kg].
        damping: (modes, modes) viscous damping C [1/s], 2ζω on the diagonal.
        hysteretic: (modes, modes) imaginary part H of the stiffness [1/s²].
    """

    galerkin: Galerkin
    frequencies: np.ndarray
    vectors: np.ndarray
    damping: np.ndarray
    hysteretic: np.ndarray

    @property
    def scene(self) -> Scene:
        """The scene."""
        return self.galerkin.scene

    @property
    def angular_frequencies(self) -> np.ndarray:
        """(modes,) ω [rad/s]."""
        return 2 * math.pi * self.frequencies

    @property
    def loss_factors(self) -> np.ndarray:
        """(modes,) loss factors 2ζ, viscous and hysteretic; 0 for rigid motions."""
        omega = self.angular_frequencies
        moving = np.where(omega > 0, omega, math.inf)
        return np.asarray(np.diag(self.damping) / moving + np.diag(self.hysteretic) / moving**2)

    @property
    def damping_ratios(self) -> np.ndarray:
        """(modes,) damping ratios ζ, half the loss factors."""
        return self.loss_factors / 2

    @cached_property
    def proportional(self) -> bool:
        """True if damping does not couple the modes."""
        return all(_diagonal(matrix) for matrix in (self.damping, self.hysteretic))

    def shapes(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return (modes, ny, nx) shapes φ [1/√kg] on the grid of x and y [m]."""
        along_x, along_y = self.galerkin.along_x, self.galerkin.along_y
        coefficients = self._plate_vectors.T.reshape(-1, along_y.functions, along_x.functions)
        return np.asarray(along_y.values(y).T @ coefficients @ along_x.values(x))

    def at_points(self, points: Sequence[tuple[float, float]] | np.ndarray) -> np.ndarray:
        """Return (modes, points) shapes φ [1/√kg] at points (x, y) [m]."""
        x, y = np.asarray(points, dtype=float).reshape(-1, 2).T
        along_x, along_y = self.galerkin.along_x.values(x), self.galerkin.along_y.values(y)
        products = along_y[:, None] * along_x
        return np.asarray(self._plate_vectors.T @ products.reshape(-1, len(x)))

    def patch_forces(self, areas: Sequence[Area] | np.ndarray) -> np.ndarray:
        """Return (modes, areas) ∫ φ dA [m²/√kg] over rectangles x0, x1, y0, y1 [m], the modal forces of 1 N/m²."""
        integrals = patch_integrals(self.galerkin.along_x, self.galerkin.along_y, np.asarray(areas, dtype=float))
        return np.asarray(self._plate_vectors.T @ integrals.T)

    def actuator_forces(self) -> np.ndarray:
        """Return (modes, actuators) modal forces of a pressure of 1 N/m² on each actuator of the scene."""
        return self.patch_forces([actuator.area for actuator in self.scene.actuators])

    def displacement(self, amplitudes: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return displacements (..., ny, nx) [m] of modal amplitudes (..., modes) on the grid of x and y [m]."""
        along_x, along_y = self.galerkin.along_x, self.galerkin.along_y
        coefficients = amplitudes @ self._plate_vectors.T
        coefficients = coefficients.reshape(*amplitudes.shape[:-1], along_y.functions, along_x.functions)
        return np.asarray(along_y.values(y).T @ coefficients @ along_x.values(x))

    @property
    def oscillator_motions(self) -> np.ndarray:
        """(modes, oscillators with a mass) motions of the masses [1/√kg]."""
        return self.vectors[self._plate_unknowns :].T

    def kinetic_matrix(self, region: str | Area | Target = "plate", within: Area | None = None) -> np.ndarray:
        """Return (modes, modes) ∫ ρH φ φ dA over a region: ½ q̇ᵀ matrix q̇ is its kinetic energy [J].

        Args:
            region: "plate", a rectangle x0, x1, y0, y1 [m], or a target.
            within: Rectangle outside which a region does not count (default: none).

        Raises:
            SceneError: The file of a mask cannot be read.
        """
        if isinstance(region, str) and within is None:
            attached = self.oscillator_motions * np.sqrt([oscillator.mass for oscillator in self.galerkin.masses])
            return np.eye(len(self.frequencies)) - attached @ attached.T
        area = (0.0, self.scene.plate.size[0], 0.0, self.scene.plate.size[1])
        matrix = region_matrix(self.galerkin, area if isinstance(region, str) else region, within)
        return np.asarray(self.vectors.T @ (matrix @ self.vectors))

    def respond(self, frequencies: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return the steady response to forces that turn as exp(iωt).

        Args:
            frequencies: (frequencies,) [Hz].
            forces: (modes, loads) complex modal forces.

        Returns:
            (frequencies, modes, loads) complex modal amplitudes q: u = Re Σ φ q exp(iωt). Infinite where an undamped
            mode is driven at its natural frequency.
        """
        omega = 2 * math.pi * np.asarray(frequencies, dtype=float)
        if self.proportional:
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.asarray(forces / self.dynamic_stiffness(omega)[:, :, None])
        responses = np.empty((len(omega), *forces.shape), dtype=complex)
        for response, turn in zip(responses, omega, strict=True):
            matrix = 1j * (turn * self.damping + self.hysteretic)
            matrix[np.diag_indices_from(matrix)] += self.angular_frequencies**2 - turn**2
            response[:] = scipy.linalg.solve(matrix, forces, assume_a="sym")
        return responses

    def respond_each(self, frequency: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return the steady response of plates to forces that each turn at a frequency of their own.

        Args:
            frequency: (plates, loads) [Hz].
            forces: (plates or 1, modes, loads) complex modal forces.

        Returns:
            (plates, modes, loads) complex modal amplitudes, see :meth:`respond`.
        """
        if self.proportional:
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.asarray(forces / self.dynamic_stiffness(2 * math.pi * frequency).mT)
        loads = np.moveaxis(np.broadcast_to(forces, (len(frequency), *forces.shape[1:])), 1, 0)
        amplitudes = np.empty(loads.shape, dtype=complex)
        for each in np.unique(frequency):
            amplitudes[:, frequency == each] = self.respond(np.array([each]), loads[:, frequency == each])[0]
        return np.moveaxis(amplitudes, 0, 1)

    def dynamic_stiffness(self, omega: np.ndarray) -> np.ndarray:
        """Return (..., modes) Λ + iH + iωC − ω² of the modes without their coupling, at ω (...) [rad/s]."""
        turn = np.asarray(omega)[..., None]
        damped = turn * np.diag(self.damping) + np.diag(self.hysteretic)
        return np.asarray(self.angular_frequencies**2 - turn**2 + 1j * damped)

    @property
    def _plate_unknowns(self) -> int:
        return self.galerkin.along_x.functions * self.galerkin.along_y.functions

    @property
    def _plate_vectors(self) -> np.ndarray:
        return self.vectors[: self._plate_unknowns]


def solve_modes(scene: Scene, highest: float | None = None, count: int = 0, density: float = 1.0) -> ModalPlate:
    """Return the modes of a linear scene.

    Args:
        scene: Scene; its grid, time steps and drive play no part.
        highest: Frequency up to which responses are accurate [Hz] (default: the highest of the scene's drive).
        count: Number of modes, from the lowest, that must be accurate.
        density: Factor of the number of functions along each side, 1 for errors of some 1e-6.

    Raises:
        SceneError: The scene is not linear, its plate buckles, or a file that it names cannot be read.
    """
    if scene.nonlinear_table not in (None, "effects.moving_load"):
        raise SceneError(f"{scene.nonlinear_table}: has no modes, for it is not linear; simulate it in time steps")
    if highest is None:
        highest = highest_frequency(scene)
    lowest_modes = _frequency_of(scene, count)
    galerkin = make_galerkin(scene, _intervals(scene, max(highest, lowest_modes), density))
    squares, vectors = _eigenpairs(galerkin, max(REACH * highest, lowest_modes))
    frequencies = np.sqrt(np.maximum(squares, 0.0)) / (2 * math.pi)
    lowest = _wave_frequency(scene, 1 / max(scene.plate.size))
    frequencies[frequencies < STILL * lowest] = 0.0
    damping = np.asarray(vectors.T @ (galerkin.damping @ vectors))
    hysteretic = np.zeros_like(damping)
    if scene.effects.modal_damping is not None:
        ratios = scene.effects.modal_damping.of_modes(frequencies.size)
        damping[np.diag_indices_from(damping)] += 2 * ratios * 2 * math.pi * frequencies
    if (loss := scene.effects.loss_factor) is not None:
        if isinstance(loss.eta, tuple):
            hysteretic = np.diag(loss.of_modes(frequencies.size) * np.maximum(squares, 0))
        else:
            hysteretic = np.asarray(loss.eta * (vectors.T @ (galerkin.bending @ vectors)))
    return ModalPlate(galerkin, frequencies, vectors, damping, hysteretic)


def times(matrix: np.ndarray | scipy.sparse.csr_array, columns: np.ndarray) -> np.ndarray:
    """Return a real matrix (rows, modes) times complex columns (..., modes, columns), in real arithmetic."""
    first = np.moveaxis(columns, -2, 0)
    flat = first.reshape(len(first), -1)
    product = matrix @ flat.real + 1j * (matrix @ flat.imag)
    return np.moveaxis(product.reshape(matrix.shape[0], *first.shape[1:]), 0, -2)


def _eigenpairs(galerkin: Galerkin, highest: float) -> tuple[np.ndarray, np.ndarray]:
    """Return ω² [1/s²] and mass-normalised vectors (unknowns, modes), up to a frequency [Hz] at least."""
    scale = (2 * math.pi * _wave_frequency(galerkin.scene, 1 / max(galerkin.scene.plate.size))) ** 2
    if galerkin.mass.shape[0] > DENSE:
        return _lowest(galerkin, highest, scale)
    mass = galerkin.mass.toarray()
    shifted = galerkin.stiffness.toarray() + scale * mass
    # Eigenvalues of the inverse problem: the largest have small relative errors, and they belong to the lowest modes.
    units = 1 / np.sqrt(np.diag(shifted))
    try:
        inverse, vectors = scipy.linalg.eigh(
            mass * np.outer(units, units), shifted * np.outer(units, units), driver="gvd"
        )
    except np.linalg.LinAlgError:
        raise _buckled(galerkin.scene) from None
    inverse, vectors = inverse[::-1], (units[:, None] * vectors)[:, ::-1]
    kept = inverse > 1e-9 * inverse[0]  # of still higher ones rounding couples the damping
    inverse, vectors = inverse[kept], vectors[:, kept]
    squares = 1 / inverse - scale
    if squares[0] < -STILL * scale:
        raise _buckled(galerkin.scene)
    return squares, vectors / np.sqrt(inverse)


def _lowest(galerkin: Galerkin, highest: float, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the same, by shift and inversion."""
    scene = galerkin.scene
    width, height = scene.plate.size
    # Weyl's law, and a margin for its boundary term.
    wanted = math.ceil(1.1 * math.pi / 4 * _half_waves(scene, highest) ** 2 * width * height) + 40
    shifted = scipy.sparse.csc_array(galerkin.stiffness + scale * galerkin.mass)
    solve = scipy.sparse.linalg.splu(
        shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    ).solve
    inverse = scipy.sparse.linalg.LinearOperator(shifted.shape, matvec=solve, dtype=float)
    start = np.random.default_rng(0).normal(size=shifted.shape[0])
    squares, vectors = scipy.sparse.linalg.eigsh(
        galerkin.stiffness, min(wanted, shifted.shape[0] // 2), galerkin.mass, sigma=-scale, OPinv=inverse, v0=start
    )
    if squares.min() < -STILL * scale:
        raise _buckled(scene)
    order = np.argsort(squares, kind="stable")
    return squares[order], vectors[:, order]


def _intervals(scene: Scene, highest: float, density: float) -> tuple[int, int]:
    """Return the number of intervals between knots along x and along y."""
    waves, longer = _half_waves(scene, highest), max(scene.plate.size)
    counts = [
        math.ceil(max(FEWEST * math.sqrt(side / longer), PER_HALF_WAVE * waves * side)) for side in scene.plate.size
    ]
    x, y = (math.ceil(density * count) for count in counts)
    if max(x, y) > MOST_INTERVALS:
        raise SceneError(
            f"drive.frequency: {waves * max(scene.plate.size):.0f} half-waves fit on a side at {highest:g} Hz, too "
            f"many for modes; at most {MOST_INTERVALS / PER_HALF_WAVE:.0f} are possible"
        )
    return x, y


def _frequency_of(scene: Scene, count: int) -> float:
    """Return an upper estimate of the frequency of mode number ``count`` [Hz], by Weyl's law."""
    width, height = scene.plate.size
    half_waves = math.sqrt(4 / math.pi * count) + 2 if count else 0.0
    return _wave_frequency(scene, half_waves / math.sqrt(width * height))


def _half_waves(scene: Scene, frequency: float) -> float:
    """Return half-waves per metre of a bending wave of the bare plate [1/m]."""
    return math.sqrt(frequency / _wave_frequency(scene, 1.0))


def _wave_frequency(scene: Scene, half_waves: float) -> float:
    """Return the frequency [Hz] of a bending wave of the bare plate with so many half-waves per metre."""
    plate, orthotropic = scene.plate, scene.effects.orthotropic
    rigidity = plate.rigidity if orthotropic is None else min(orthotropic.Dx, orthotropic.Dy)
    return math.sqrt(rigidity / (plate.density * plate.thickness)) * math.pi * half_waves**2 / 2


def _diagonal(matrix: np.ndarray) -> bool:
    """Return whether a positive semidefinite matrix is diagonal but for rounding."""
    size = np.sqrt(np.abs(np.diag(matrix)))
    off = np.abs(matrix - np.diag(np.diag(matrix)))
    return bool(np.all(off <= PROPORTIONAL * np.outer(size, size) + ROUNDING * size.max(initial=0.0) ** 2))


def _buckled(scene: Scene) -> SceneError:
    tension = scene.effects.tension
    x, y = (tension.x, tension.y) if tension else (0.0, 0.0)
    return SceneError(f"effects.tension = {{x = {x:g}, y = {y:g}}}: the plate buckles; write smaller pressures")

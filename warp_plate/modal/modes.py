"""Natural modes of a scene's plate, and responses in terms of them.

    K φ = ω² M φ,     Φᵀ M Φ = 1,     u = Σ_r φ_r(x, y) q_r(t),     q̈ + C q̇ + (Λ + iH) q = Φᵀ f

With the matrices of :mod:`warp_plate.modal.assemble`, Λ = diag(ω_r²) and C = Φᵀ C Φ, which is not diagonal where
dampers sit on patches or the plate's mass varies. H is the imaginary part of the stiffness of a plate with a constant
loss factor, which has only steady responses. All modes of a small plate are kept, so that nothing is truncated; of a
large one those that matter below a frequency.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from warp_plate.effects.effect import per_mode
from warp_plate.modal.assemble import Galerkin, load_integrals, make_galerkin, make_space
from warp_plate.modal.coils import Coils
from warp_plate.modal.eigenproblem import bending_energies, projected, solve_eigenproblem
from warp_plate.modal.poles import NEGLIGIBLE, CoupledModes, Poles, make_poles
from warp_plate.modal.spaces.added import ties_banks
from warp_plate.modal.spaces.integrals import mean_wave_frequency
from warp_plate.modal.spaces.knots import intervals_for
from warp_plate.modal.spaces.space import FunctionSpace
from warp_plate.modal.unbaffled import AirLoads, air_on
from warp_plate.plate.section import laminate_of
from warp_plate.plate.signals import highest_frequency
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import Area
from warp_plate.scene.model import Scene, SceneSource
from warp_plate.scene.target import PlateRegion, Target

# Most intervals between knots along a side.
MOST_INTERVALS = 400
# Modes up to the highest frequency, by Weyl's law: so many take some 45 s and 2.7 GB, or without higher ones more.
MOST_MODES, MOST_ALONE = 1000, 1500
# Modes that are wanted: those up to REACH times the highest frequency, and FURTHER ones for what higher ones add to
# responses, or SPARE without responses.
REACH, FURTHER, SPARE = 4.0, 600, 40
# Frequencies below this part of √(D/ρH)(π/longer side)² are those of rigid motions.
STILL = 1e-4
# Damping that couples two modes by less than this part of their own has no effect; by less than the other of the
# largest of all modes, it is rounding.
PROPORTIONAL, RELATIVE_ZERO = 1e-6, 1e-13
# Functions along each side of the modes that frequencies are compared with, relative to the others. The error of a
# frequency is FACTOR times the largest change of it and of lower ones, and at least LEAST. Where rigidity jumps, it
# falls as the first power of the spacing, so that it is 3.5 times the change. With an outline errors fall unevenly: of
# 51 random plates, the largest was up to 6.6 times the largest change.
FINER, FACTOR, OUTLINE_FACTOR, LEAST = 1.4, 4.0, 8.0, 1e-6
# Least error with a narrow slanted hole both sides of which splines tie: more functions do not show what that changes.
SLIT = 0.3
# Further modes that are solved for, so that no group of equal frequencies is cut.
UNCUT = 4


@dataclass(frozen=True, eq=False)
class ModalPlate:
    """Modes of a scene's plate by rising frequency, mass-normalised."""

    galerkin: Galerkin  # Matrices that they come from
    frequencies: np.ndarray  # (modes,) natural frequencies of the undamped plate [Hz], 0 for rigid motions
    vectors: np.ndarray  # (unknowns, modes) Φ [1/√kg]
    damping: np.ndarray  # (modes, modes) viscous damping C [1/s], 2ζω on the diagonal
    hysteretic: np.ndarray  # (modes, modes) imaginary part H of the stiffness [1/s²]
    highest: float  # Frequency up to which responses are accurate [Hz]
    negligible: float = NEGLIGIBLE  # Part of energies that free motions which are left out may change

    def __repr__(self) -> str:
        return f"<ModalPlate {len(self.frequencies)} modes, the highest at {self.frequencies.max(initial=0):.4g} Hz>"

    @property
    def scene(self) -> Scene:
        """The scene."""
        return self.galerkin.scene

    @property
    def space(self) -> FunctionSpace:
        """Functions that the shapes are sums of."""
        return self.galerkin.space

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
    def errors(self) -> np.ndarray:
        """(modes,) relative errors of the frequencies, if these are the lowest: from a second solution with more
        functions, solved for at the first access; NaN if these are too many."""
        return errors_of_frequencies(self.scene, self.frequencies)

    @cached_property
    def proportional(self) -> bool:
        """True if damping does not couple the modes."""
        return all(_is_diagonal(matrix) for matrix in (self.damping, self.hysteretic))

    @cached_property
    def coupled(self) -> CoupledModes | None:
        """The modes as damping couples them; None if it does not."""
        if self.proportional:
            return None
        return CoupledModes(self.angular_frequencies**2, self.damping, self.hysteretic, self.highest)

    @cached_property
    def coils(self) -> Coils | None:
        """The scene's coils, which the modes are those of the plate without; None if there are none."""
        patches = [self.scene.actuators[index] for index in self.scene.coil_indices]
        return Coils(self, self.region_forces(patches) / self.space.region_areas(patches)) if patches else None

    @property
    def coil_columns(self) -> np.ndarray:
        """(modes, coils) modal forces of 1 N of the coils."""
        assert self.coils is not None
        return self.coils.means

    @cached_property
    def air(self) -> AirLoads | None:
        """The load of the scene's air on the modes, which are those in vacuo; None if there is none."""
        return None if self.scene.effects.air is None else air_on(self, self.scene.effects.air)

    @cached_property
    def _poles(self) -> dict[float, Poles]:
        return {}

    def poles(self, longest: float) -> Poles:
        """Return the poles under viscous damping for times up to ``longest`` [s], computed once for each."""
        if longest not in self._poles:
            poles = make_poles(self.angular_frequencies, self.damping, self.proportional, longest)
            self._poles[longest] = replace(poles, negligible=self.negligible)
        return self._poles[longest]

    @property
    def resonances(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies and half-widths [Hz] of all resonances, or of the lowest if damping or coils couple modes."""
        if self.coils is not None:
            both = [self.coils.resonances(opened) for opened in (True, False)]
            return np.concatenate([both[0][0], both[1][0]]), np.concatenate([both[0][1], both[1][1]])
        if self.air is not None:
            return self.air.resonances
        if self.coupled is not None:
            return self.coupled.resonances
        return self.frequencies, self.damping_ratios * self.frequencies

    def part(self, indices: np.ndarray) -> ModalPlate:
        """Return the plate with some of its modes."""
        crossed = np.ix_(indices, indices)
        arrays = {"damping": self.damping[crossed], "hysteretic": self.hysteretic[crossed]}
        return replace(self, frequencies=self.frequencies[indices], vectors=self.vectors[:, indices], **arrays)

    def shapes(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return (modes, ny, nx) shapes φ [1/√kg] on the grid of x and y [m]."""
        return self.space.on_grid(self._plate_vectors.T, x, y)

    def at_points(self, points: Sequence[tuple[float, float]] | np.ndarray) -> np.ndarray:
        """Return (modes, points) shapes φ [1/√kg] at points (x, y) [m]."""
        return np.asarray(self._plate_vectors.T @ self.space.at_points(points).T)

    def patch_forces(self, areas: Sequence[Area] | np.ndarray) -> np.ndarray:
        """Return (modes, areas) ∫ φ dA [m²/√kg] over rectangles x0, x1, y0, y1 [m], the modal forces of 1 N/m²."""
        return np.asarray(self._plate_vectors.T @ self.space.patch_integrals(np.asarray(areas, dtype=float)).T)

    def region_forces(self, regions: Sequence[PlateRegion]) -> np.ndarray:
        """Return (modes, regions) the same over the parts of regions on the plate."""
        return np.asarray(self._plate_vectors.T @ self.space.region_integrals(regions).T)

    def actuator_forces(self) -> np.ndarray:
        """Return (modes, actuators) modal forces of 1 N/m², 1 V on piezo patches or 1 N of the scene's coils."""
        return self.drive_forces([actuator.box for actuator in self.scene.actuators])

    def drive_forces(self, areas: Sequence[Area] | np.ndarray) -> np.ndarray:
        """Return (modes, areas) the same of the actuators in places (..., actuators, 4) x0, x1, y0, y1 [m]."""
        forces = np.asarray(self._plate_vectors.T @ load_integrals(self.galerkin, np.asarray(areas, dtype=float)).T)
        for column, index in enumerate(self.scene.coil_indices):  # which stay in their places
            forces[:, index :: len(self.scene.actuators)] = self.coil_columns[:, [column]]
        return forces

    def drive_gains(self, frequency: np.ndarray) -> np.ndarray | float:
        """Return the (n, actuators) complex factors of the response to unit forces of the actuators at frequencies (n,
        actuators or 1) [Hz] that make it that to unit drives: the force [N] per volt or ampere of coils, and 1."""
        return 1.0 if self.coils is None else self.coils.gains(2 * math.pi * frequency)

    def respond_to_drives(self, frequency: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return the (plates, modes, actuators) steady response to unit drives at frequencies (plates, actuators or 1)
        [Hz], from modal forces (plates or 1, modes, actuators), see :meth:`drive_forces`."""
        amplitudes = self.respond_each(frequency, forces)
        return amplitudes if self.coils is None else amplitudes * self.coils.gains(2 * math.pi * frequency)[:, None, :]

    def respond_to_drive(self, frequencies: np.ndarray, phasors: np.ndarray) -> np.ndarray:
        """Return the (n, modes, 1) steady response to the phasors (actuators,) of a drive at frequencies (n,) [Hz]."""
        forces = self.actuator_forces()
        if self.coils is None:
            return self.respond(frequencies, forces @ phasors[:, None])
        loads = (forces * self.coils.gains(2 * math.pi * frequencies[:, None])[:, None, :]) @ phasors[:, None]
        return self.respond_each(frequencies[:, None], loads)

    def displacement(self, amplitudes: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return displacements (..., ny, nx) [m] of modal amplitudes (..., modes) on the grid of x and y [m]."""
        return self.space.on_grid(amplitudes @ self._plate_vectors.T, x, y)

    @property
    def attached_motions(self) -> np.ndarray:
        """(modes, attached masses) motions of the masses [1/√kg]."""
        return self.vectors[self.space.unknowns :].T

    def kinetic_matrix(self, region: str | Area | Target = "plate", within: Area | None = None) -> np.ndarray:
        """Return (modes, modes) ∫ ρH φ φ dA over a region: ½ q̇ᵀ matrix q̇ is its kinetic energy [J].

        A region is "plate", a rectangle x0, x1, y0, y1 [m], or a target, and counts within a rectangle only, if one is
        given.
        """
        if isinstance(region, str) and within is None:
            attached = self.attached_motions * np.sqrt([attachment.mass for attachment in self.galerkin.masses])
            return np.eye(len(self.frequencies)) - attached @ attached.T
        matrix = self.galerkin.region_matrix(self.scene.plate.box if isinstance(region, str) else region, within)
        return projected(matrix, self.vectors)

    def respond(self, frequencies: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return the (frequencies, modes, loads) complex modal amplitudes q, u = Re Σ φ q exp(iωt), under forces that
        turn as exp(iωt), of frequencies (frequencies,) [Hz] and complex modal forces (modes, loads).

        They are infinite where an undamped mode is driven at its natural frequency.
        """
        return self.respond_each(np.asarray(frequencies, dtype=float)[:, None], forces[None])

    def respond_each(self, frequency: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return the (plates, modes, loads) steady response, see :meth:`respond`, of plates to forces (plates or 1,
        modes, loads) at separate frequencies (plates, loads or 1) [Hz]."""
        omega = 2 * math.pi * frequency
        if self.coupled is None and self.coils is None and self.air is None:
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.asarray(forces / self.dynamic_stiffness(omega).mT)
        respond = self.respond_alone if self.coils is None else self.coils.respond
        loads = np.broadcast_to(forces, (len(omega), *forces.shape[1:]))
        if (omega == omega[:, :1]).all():
            return respond(omega[:, 0], loads)
        alone = respond(omega.ravel(), loads.mT.reshape(omega.size, -1, 1))
        return alone.reshape(loads.mT.shape).mT

    def respond_alone(self, omega: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Return the (n, modes, loads) response without coils to forces (n, modes, loads) at ω (n,) [rad/s]."""
        if self.air is not None:
            return self.air.respond(omega, forces)
        if self.coupled is not None:
            return self.coupled.respond(omega, forces)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(forces / self.dynamic_stiffness(omega)[:, :, None])

    def dynamic_stiffness(self, omega: np.ndarray) -> np.ndarray:
        """Return (..., modes) Λ + iH + iωC − ω² of the modes without their coupling, at ω (...) [rad/s]."""
        turn = np.asarray(omega)[..., None]
        damped = turn * np.diag(self.damping) + np.diag(self.hysteretic)
        return np.asarray(self.angular_frequencies**2 - turn**2 + 1j * damped)

    @property
    def _plate_vectors(self) -> np.ndarray:
        return self.vectors[: self.space.unknowns]


def solve_modes(
    scene: SceneSource,
    highest: float | None = None,
    count: int = 0,
    density: float = 1.0,
    alone: bool = False,
    most: int = MOST_MODES,
    key: str | None = None,
    improve: bool = True,
) -> ModalPlate:
    """Return the modes of a linear scene.

    Args:
        scene: Scene; its grid, time steps and drive are not used.
        highest: Frequency up to which responses are accurate [Hz] (default: the highest of the scene's drive).
        count: Number of modes, from the lowest, that must be accurate.
        density: Factor of the number of functions along each side, besides ``grid.modal_density`` (default: 1, whose
            errors docs/modal.md lists).
        alone: Leave out modes above ``highest`` and beyond ``count``, which responses need, but for a few.
        most: Limit of the number of modes up to ``highest``, and of ``count``.
        key: Where ``highest`` or ``count`` comes from, for errors (default: ``drive.frequency``, or ``count``).
        improve: Solve for the lowest modes once more, so that the rounding of large matrices does not remain in them.

    Raises:
        SceneError: The scene is not linear, its plate buckles, too many modes are wanted, or a file that it names
            cannot be read.
    """
    scene = Scene.load(scene)
    if scene.nonlinear_key is not None:
        raise SceneError(f"{scene.nonlinear_key}: has no modes, for it is not linear; simulate it in time steps")
    # More functions follow shorter waves, and higher modes are kept of a plate that has too many for all.
    finer = scene.grid.modal_density
    highest, density = finer * (highest_frequency(scene) if highest is None else highest), finer * density
    wave, area = mean_wave_frequency(laminate_of(scene)), scene.plate.area
    counted = wave * (math.sqrt(4 / math.pi * count) + 2) ** 2 / area if count else 0.0
    from_rest = highest > 0 and not alone and not scene.steady
    intervals = intervals_for(scene.plate.size, scene.outline, max(highest, counted), wave, density, from_rest)
    below = max(math.pi / 4 * area * highest / wave, count)
    _check_size(scene, key or ("drive.frequency" if highest >= counted else "count"), below, most, intervals)
    galerkin = make_galerkin(scene, make_space(scene, intervals))
    # Weyl's law, and a margin for its boundary term.
    wanted = 1.1 * math.pi / 4 * area * max(REACH * highest, counted) / wave + (FURTHER if highest else SPARE)
    least = 0.0
    if alone:
        wanted, least = max(math.pi / 4 * area * highest / wave, 2 * count), (2 * math.pi * highest) ** 2
    lowest = wave / max(scene.plate.size) ** 2
    squares, vectors = solve_eigenproblem(galerkin, math.ceil(wanted), (2 * math.pi * lowest) ** 2, least, improve)
    return damped_modes(galerkin, squares, vectors, highest, improve)


def damped_modes(
    galerkin: Galerkin, squares: np.ndarray, vectors: np.ndarray, highest: float, improve: bool = True
) -> ModalPlate:
    """Return a plate with mass-normalised modes (unknowns, modes), by rising ω² [1/s²], and the damping of its scene;
    ``highest`` [Hz] and ``improve`` as for :func:`solve_modes`."""
    frequencies = np.sqrt(np.maximum(squares, 0.0)) / (2 * math.pi)
    lowest = mean_wave_frequency(laminate_of(galerkin.scene)) / max(galerkin.scene.plate.size) ** 2
    frequencies[frequencies < STILL * lowest] = 0.0
    damping, hysteretic = _viscous(galerkin, vectors), np.zeros((squares.size, squares.size))
    lost = galerkin.losses
    if lost.retardation:
        damping += lost.retardation * bending_energies(galerkin, squares, vectors, improve)
    if lost.ratios is not None:
        ratios = per_mode(lost.ratios, frequencies.size)
        damping[np.diag_indices_from(damping)] += 2 * ratios * 2 * math.pi * frequencies
    if lost.loss_factors is not None:
        hysteretic = np.diag(per_mode(lost.loss_factors, frequencies.size) * np.maximum(squares, 0))
    elif lost.hysteretic:
        hysteretic = lost.hysteretic * bending_energies(galerkin, squares, vectors, improve)
    return ModalPlate(galerkin, frequencies, vectors, damping, hysteretic, highest)


def errors_of_frequencies(scene: Scene, frequencies: np.ndarray) -> np.ndarray:
    """Return (count,) relative errors of the lowest frequencies [Hz] of a linear scene.

    They come from a second solution with more functions: 0 for rigid motions, NaN if these functions are too many.
    """
    try:
        finer = solve_modes(scene, highest=0.0, count=frequencies.size + UNCUT, density=FINER, alone=True)
    except SceneError:
        return np.full(frequencies.shape, math.nan)
    reference = finer.frequencies[: frequencies.size]
    moving = (frequencies > 0) & (reference > 0)
    changes = np.abs(np.divide(reference, frequencies, out=np.ones_like(frequencies), where=moving) - 1)
    uneven = scene.outline is not None and changes.size > 0
    largest = OUTLINE_FACTOR * changes.max() if uneven else FACTOR * np.maximum.accumulate(changes)
    if ties_banks(scene):
        largest = np.maximum(largest, SLIT)
    return np.where(frequencies > 0, largest + LEAST, 0.0)


def _viscous(galerkin: Galerkin, vectors: np.ndarray) -> np.ndarray:
    """Return Φᵀ C Φ [1/s] without the damping of the material, diagonal for a multiple of the mass."""
    factor = galerkin.damping.trace() / galerkin.mass.trace()
    if abs(galerkin.damping - factor * galerkin.mass).max() <= RELATIVE_ZERO * abs(galerkin.damping).max():
        return np.diag(np.full(vectors.shape[1], factor))
    return projected(galerkin.damping, vectors)


def _check_size(scene: Scene, key: str, below: float, most: int, intervals: tuple[int, int]) -> None:
    """Raise a SceneError, beginning with ``key``, if there are too many modes or too many intervals along a side."""
    if below > most:
        size = "the plate is {:g} × {:g} m".format(*scene.plate.size)
        raise SceneError(f"{key}: about {below:.3g} modes are needed; at most {most} are computed ({size})")
    if max(intervals) > MOST_INTERVALS:
        raise SceneError(
            f"{key}: {max(intervals)} intervals between the knots of splines are needed along a side of the plate; at "
            f"most {MOST_INTERVALS} are possible" + (f" ({scene.outline.widening})" if scene.outline else "")
        )


def _is_diagonal(matrix: np.ndarray) -> bool:
    """Return whether a positive semidefinite matrix is diagonal but for rounding."""
    size = np.sqrt(np.abs(np.diag(matrix)))
    off = np.abs(matrix - np.diag(np.diag(matrix)))
    return bool(np.all(off <= PROPORTIONAL * np.outer(size, size) + RELATIVE_ZERO * size.max(initial=0.0) ** 2))

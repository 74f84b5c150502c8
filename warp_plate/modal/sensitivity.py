"""Slopes of mean energies by the matrices of a plate, by the adjoint method, for one tone of all actuators.

With M, C, K the matrices of :mod:`warp_plate.modal.assemble`, H = ηB of a loss factor and D(s) = s²M + sC + K + iH,
a change of the matrices changes the steady rate v = iω q, D(iω) q = f, and its energy E = ¼ v̄ᵀGv of a region by

    δE = ¼ v̄ᵀ δG v + Re λᵀ (δf − δD q),     D λ = ½ iω G v̄,

so that one more solution serves all changes. From rest, with the poles s_p, free motions ψ_p and inputs χ_p of
:mod:`warp_plate.modal.poles`, the rate under the load Re f exp(σt) is the real part of

    v = Σ_p ψ_p (χ_p f) φ(s_p),     φ = the divided difference of ξ exp(ξt) at s_p and σ,

and by δ(D⁻¹) = −D⁻¹ δD D⁻¹ and the theorem of residues a change δX of the matrix X of s^k in D changes it by

    δv = −Σ_pp' ψ_p (χ_p δX ψ_p') (χ_p' f) φ_k(s_p, s_p'),     φ_k = that of ξ^(k+1) exp(ξt) at s_p, s_p' and σ.

The means ⟨Re vᵀG δv⟩ over the window are then products of matrices with closed formulas for exponentials. Where poles
nearly coincide, the divided difference is the mean of the derivatives at both.

From rest the lowest modes alone are taken. A change turns them towards the others, φ_s:

    δφ_r = Σ_s φ_s (φ_sᵀ (δK − ω_r² δM) φ_r) / (ω_r² − ω_s²)

(R. B. Nelson, AIAA J. 14, 1976, pp. 1201-1205), so that slopes are those of the truncated energies. A mode within the
others needs no slope of its own: energies do not depend on the basis of a space.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from warp_plate.effects.effect import DISPLACEMENT, Factors, per_mode
from warp_plate.modal.assemble import Galerkin, load_integrals
from warp_plate.modal.eigenproblem import solve_eigenproblem
from warp_plate.modal.gram import Means, gram_matrices, mean_exponential, mean_exponential_with_time
from warp_plate.modal.modes import ModalPlate
from warp_plate.modal.poles import Poles
from warp_plate.modal.spaces.integrals import Integrals, bending_terms, mean_wave_frequency, region_rule
from warp_plate.modal.spaces.tensor_splines import ORDERS, TensorSplines
from warp_plate.plate.section import bilinear
from warp_plate.scene.errors import SceneError
from warp_plate.scene.grid import Window
from warp_plate.scene.model import Scene
from warp_plate.scene.target import Target

# Modes that count from rest: those up to REACH times the drive's frequency, at least FEWEST, and up to so many more
# that the gap to the next one is wide.
REACH, FEWEST, MORE = 3.0, 40, 8
# Complex step of the slopes of coefficients by a factor of the thickness.
STEP = 1e-30
# Poles closer than this part of one over the end of the window count as coincident.
COINCIDENT = 1e-3


@dataclass(frozen=True)
class PlateMatrices:
    """Matrices of a plate over its unknowns; or slopes of a number by their entries, for symmetric changes."""

    mass: np.ndarray  # (n, n) M [kg]
    bending: np.ndarray  # (n, n) B [N/m]
    support: np.ndarray  # (n, n) K − B [N/m]
    damping: np.ndarray  # (n, n) C without that of the material and of modes [N·s/m]
    regions: np.ndarray  # (2, n, n) mass of the plate without what is attached, and of the target [kg]
    forces: np.ndarray  # (n, M) loads of unit drives of the actuators

    def __sub__(self, other: PlateMatrices) -> PlateMatrices:
        return PlateMatrices(*(mine - others for mine, others in zip(self._arrays, other._arrays, strict=True)))

    def product(self, other: PlateMatrices) -> float:
        """Return the sum of the products of all entries: the change of a number by slopes and changes."""
        pairs = zip(self._arrays, other._arrays, strict=True)
        return float(sum(np.vdot(mine, others) for mine, others in pairs))

    @property
    def _arrays(self) -> tuple[np.ndarray, ...]:
        return self.mass, self.bending, self.support, self.damping, self.regions, self.forces


def plate_matrices(galerkin: Galerkin) -> PlateMatrices:
    """Return the matrices of a scene over a space as dense arrays."""
    scene, masses = galerkin.scene, [attachment.mass for attachment in galerkin.masses]
    mass = galerkin.mass.toarray()
    plate = mass.copy()
    plate[np.diag_indices_from(plate)] -= np.pad(masses, (len(mass) - len(masses), 0))
    loads = load_integrals(galerkin, np.array([actuator.box for actuator in scene.actuators])).T
    return PlateMatrices(
        mass=mass,
        bending=galerkin.bending.toarray(),
        support=galerkin.support.toarray(),
        damping=galerkin.damping.toarray(),
        regions=np.stack([plate, galerkin.region_matrix(scene.target).toarray()]),
        forces=np.pad(loads, ((0, len(masses)), (0, 0))),
    )


def check_differentiable(scene: Scene) -> None:
    """Raise a SceneError, naming the key, unless slopes by the matrices of a scene's plate are known."""
    kinds = {f"actuators[{index}].kind": row.kind for index, row in enumerate(scene.actuators)}
    key = scene.nonlinear_table or scene.nonperiodic_key
    key = key or next((key for key, kind in kinds.items() if kind == "coil"), None)
    if key is not None:
        raise SceneError(
            f"{key}: slopes are known for one tone of pressures or piezo patches on a linear plate; delete it"
        )
    if scene.outline is not None:
        key = "supports" if scene.plate.outline is None else "plate.outline"
        raise SceneError(f"{key}: slopes are known for rectangular plates; write plate.size, and springs of edges")
    if scene.effects.air is not None:
        raise SceneError("effects.air: slopes are known in vacuo; delete it")
    damped = [(key, getattr(row, name)) for key, row in scene.effects.rows for name in row.damping_keys]
    for key in (key for key, value in damped if isinstance(value, tuple)):
        raise SceneError(f"{key}: slopes are not known for a number for each mode; write one for all")


class EnergyAdjoint:
    """Mean kinetic energies of the plate and the target of a scene, and their slopes by its matrices.

    Attributes:
        plate: Modes that the motion is a sum of.
        matrices: (2, 2M, 2M) Gram matrices of plate and target [J per (N/m²)²], see :mod:`warp_plate.modal.gram`.

    Raises:
        SceneError: The plate buckles, or slopes are not known, see :func:`check_differentiable`.
    """

    def __init__(self, galerkin: Galerkin, of_plate: PlateMatrices | None = None) -> None:
        scene = galerkin.scene
        check_differentiable(scene)
        self._all = plate_matrices(galerkin) if of_plate is None else of_plate
        self.window = None if scene.steady else scene.window
        self._omega, self._lost = scene.drive.angular_frequency, galerkin.losses
        lowest = mean_wave_frequency(galerkin.space.laminate) / max(scene.plate.size) ** 2
        unknowns = galerkin.mass.shape[0]
        squares, vectors = solve_eigenproblem(galerkin, unknowns, (2 * math.pi * lowest) ** 2, improve=False)
        count = squares.size if self.window is None else _count_modes(squares, REACH * self._omega)
        self._squares, self._vectors = squares, vectors
        phi, omega = vectors[:, :count], np.sqrt(np.maximum(squares[:count], 0))
        bending = phi.T @ self._all.bending @ phi
        damping = phi.T @ self._all.damping @ phi + self._lost.retardation * bending
        if self._lost.ratios is not None:
            damping[np.diag_indices_from(damping)] += 2 * per_mode(self._lost.ratios, count) * omega
        loss = self._lost.hysteretic * bending
        highest = scene.drive.frequency
        self.plate = ModalPlate(galerkin, omega / (2 * math.pi), phi, damping, loss, highest, negligible=0.0)

    @cached_property
    def _regions(self) -> np.ndarray:
        return np.stack([self.plate.vectors.T @ region @ self.plate.vectors for region in self._all.regions])

    @cached_property
    def _forces(self) -> np.ndarray:
        return np.asarray(self.plate.vectors.T @ self._all.forces)

    @cached_property
    def matrices(self) -> np.ndarray:
        means = Means(self.plate, list(self._regions), self.window)
        frequency = np.array([[self._omega / (2 * math.pi)]])
        return gram_matrices(means, self._forces[None], np.repeat(frequency, self._forces.shape[1], axis=1))[0]

    @property
    def natural(self) -> np.ndarray:
        """Natural frequencies [Hz] of the undamped plate, rising."""
        return np.asarray(np.sqrt(np.maximum(self._squares, 0)) / (2 * math.pi))

    @property
    def without_slopes(self) -> PlateMatrices:
        """Slopes of 0 by all entries."""
        all_of = self._all
        square, regions = np.zeros_like(all_of.mass), np.zeros_like(all_of.regions)
        return PlateMatrices(square, square, square, square, regions, np.zeros_like(all_of.forces))

    def frequency_slopes(self, indices: np.ndarray, weights: np.ndarray) -> PlateMatrices:
        """Return the slopes of Σ ``weights`` times the logarithms of natural frequencies, by δλ = φᵀ(δK − λ δM)φ.

        Equal frequencies have slopes only together, with equal weights.
        """
        squares, shapes = self._squares[indices], self._vectors[:, indices]
        stiffness = (shapes * (weights / (2 * squares))) @ shapes.T
        mass = -(shapes * (weights / 2)) @ shapes.T
        return replace(self.without_slopes, mass=mass, bending=stiffness, support=stiffness)

    def slopes(self, phasors: np.ndarray, weights: np.ndarray) -> PlateMatrices:
        """Return the slopes of Σ weights_r E_r of plate and target under phasors (M,) [N/m²]."""
        region, force = np.tensordot(weights, self._regions, axes=1), self._forces @ phasors
        by = self._steady(region, force) if self.window is None else self._from_rest(region, force, self.window)
        of_stiffness, of_mass, of_damping, of_loss, by_force, mean = by
        phi, omega = self.plate.vectors, self.plate.angular_frequencies
        of_stiffness, of_mass, of_damping, of_loss = (
            (part + part.T) / 2 for part in (of_stiffness, of_mass, of_damping, of_loss)
        )
        bending = self._lost.retardation * of_damping + self._lost.hysteretic * of_loss
        turned = self._turned(of_damping, bending, weights, mean, np.outer(by_force, phasors).real)
        if self._lost.ratios is not None:  # C = 2ζ M (M⁻¹K)^½
            both = 2 * self._lost.ratios * of_damping / np.maximum(omega[:, None] + omega, np.finfo(float).tiny)
            of_stiffness, of_mass = of_stiffness + both, of_mass + np.outer(omega, omega) * both
        stiffness = phi @ of_stiffness @ phi.T
        mass = phi @ of_mass @ phi.T
        if turned is not None:
            rest, shares = turned
            stiffness += _symmetric(rest @ shares @ phi.T)
            mass -= _symmetric(rest @ (shares * omega**2) @ phi.T)
        return PlateMatrices(
            mass=mass,
            bending=stiffness + phi @ bending @ phi.T,
            support=stiffness,
            damping=phi @ of_damping @ phi.T,
            regions=np.multiply.outer(weights, phi @ mean @ phi.T),
            forces=phi @ np.outer(by_force, phasors).real,
        )

    def _turned(
        self, damping: np.ndarray, bending: np.ndarray, weights: np.ndarray, mean: np.ndarray, forces: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the modes φ_s that are left out, and the slopes (modes left out, modes) by the φ_sᵀ δK φ_r that turn
        the others towards them; None if all modes count."""
        count, phi, all_of = len(self.plate.frequencies), self.plate.vectors, self._all
        if count == self._squares.size:
            return None
        rest = self._vectors[:, count:]
        energy = np.tensordot(weights, all_of.regions, axes=1)
        towards = all_of.damping @ phi @ damping + all_of.bending @ phi @ bending + energy @ phi @ mean
        shares = rest.T @ (2 * towards + all_of.forces @ forces.T)
        return rest, shares / (self._squares[:count] - self._squares[count:, None])

    def _steady(self, region: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return slopes by modal K, M, C and H, by modal forces per phasor, and ½⟨v vᵀ⟩."""
        rate, plate = 1j * self._omega, self.plate
        dynamic = np.diag(plate.angular_frequencies**2 + rate**2) + rate * plate.damping + 1j * plate.hysteretic
        motion = np.linalg.solve(dynamic, force)
        adjoint = np.linalg.solve(dynamic, rate * (region @ (rate * motion).conj()) / 2)
        by = -np.outer(adjoint, motion)
        mean = np.outer((rate * motion).conj(), rate * motion).real / 4
        return by.real, (rate**2 * by).real, (rate * by).real, (1j * by).real, adjoint, mean

    def _from_rest(self, region: np.ndarray, force: np.ndarray, window: Window) -> tuple[np.ndarray, ...]:
        """Return the same over a window; H is zero."""
        poles = self.plate.poles(window.end)
        (rate,) = poles.shift_rates(np.array([1j * self._omega]), window.end)
        gains = poles.gains(force[:, None])[:, 0]
        gap, vectors = 1 / (rate - poles.values), poles.vectors
        exponents = np.concatenate([[rate], poles.values])
        free = -vectors * (gains * gap * poles.values)
        motion = np.column_stack([vectors @ (gains * gap) * rate, free])
        momenta = vectors.T @ region @ np.hstack([motion, motion.conj()]) / 2
        both = np.concatenate([exponents, exponents.conj()])
        loaded, resting = _mean_products(momenta, both, poles.values, window)
        forced = _mean_products(momenta, both, np.array([rate]), window)[0][:, 0]
        means = [mean_exponential(side[:, None], exponents, window) for side in (exponents, exponents.conj())]
        mean = ((motion @ means[0] + motion.conj() @ means[1]) @ motion.T).real / 4
        slopes = [
            -(poles.inputs.T @ (kernel * gains) @ vectors.T).real
            for kernel in (self._kernel(poles, rate, power, (forced, loaded, resting), window) for power in (1, 3, 2))
        ]
        by_force = poles.inputs.T @ ((forced * rate - np.diag(loaded) * poles.values) * gap)
        return *slopes, np.zeros_like(slopes[0]), by_force, mean

    @staticmethod
    def _kernel(
        poles: Poles, rate: complex, power: int, means: tuple[np.ndarray, np.ndarray, np.ndarray], window: Window
    ) -> np.ndarray:
        """Return (poles, poles) ⟨ψ_pᵀ G Re v · divided difference of ξ^power exp(ξt) at s_p, s_p' and σ⟩."""
        forced, loaded, resting = means
        values = poles.values
        gap = 1 / (rate - values)
        first = (forced[:, None] * rate**power - loaded * values**power) * gap
        slope = (first - power * values ** (power - 1) * loaded - values**power * resting) * gap
        apart = values[:, None] - values
        close = np.abs(apart) < COINCIDENT / window.end
        differences = (np.diag(first)[:, None] - first) / np.where(close, 1, apart)
        return np.where(close, (np.diag(slope)[:, None] + slope) / 2, differences)


def _mean_products(
    amplitudes: np.ndarray, exponents: np.ndarray, values: np.ndarray, window: Window
) -> tuple[np.ndarray, np.ndarray]:
    """Return the (rows, values) means over the window of motions Σ amplitudes exp(exponents t), of amplitudes (rows,
    exponents), times exp(values t), and times t exp(values t)."""
    plain, with_time = mean_exponential_with_time(exponents[:, None], values, window)
    return amplitudes @ plain, amplitudes @ with_time


def _symmetric(matrix: np.ndarray) -> np.ndarray:
    return (matrix + matrix.T) / 2


def _count_modes(squares: np.ndarray, highest: float) -> int:
    """Return how many of the modes with ω² (modes,) [1/s²], rising, count up to ``highest`` [rad/s]."""
    least = max(FEWEST, int(np.searchsorted(squares, highest**2)))
    if least + MORE >= squares.size:
        return int(squares.size)
    gaps = np.diff(np.sqrt(squares[least - 1 : least + MORE]))
    return least + int(gaps.argmax())


class FieldSlopes:
    """Slopes of a number by the fields of a plate at points, from those by its matrices, which are linear in them."""

    def __init__(self, space: TensorSplines, slopes: PlateMatrices, by_mass: float = 0.0) -> None:
        """Prepare the slopes; ``by_mass`` is that by the mass of the plate [1/kg] beside those by its matrices."""
        self.space, self.slopes, self.by_mass = space, slopes, by_mass

    @cached_property
    def _by_field(self) -> list[tuple[int, np.ndarray]]:
        """Indices of fields, Dx, D1, Dy, Dxy and the mass per area, and slopes by them at Gauss's points (y, x)."""
        integrals, count, slopes = self.space.integrals, self.space.unknowns, self.slopes
        rows = [(4, _by_coefficient(integrals, slopes.mass + slopes.regions[0], count))]
        if self.by_mass:
            rows.append((4, self.by_mass * integrals.weights))
        for index in range(4):
            for term in bending_terms([float(index == field) for field in range(5)]):
                if term.coefficient:
                    rows.append(
                        (index, term.coefficient * _by_coefficient(integrals, slopes.bending, count, term.factors))
                    )
        return rows

    def by_fields(self, changes: Sequence[np.ndarray]) -> np.ndarray:
        """Return the changes of the number by those of the fields at each of Gauss's points (y, x), but for the mass of
        the target."""
        return np.asarray(sum(changes[index] * slopes for index, slopes in self._by_field))

    @cached_property
    def of_target(self) -> tuple[Integrals, np.ndarray]:
        """The rule over a target with an area or a mask, and slopes by its mass per area at its points (y, x)."""
        integrals, share = region_rule(self.space.laminate, self.space.along, self.space.scene.target)
        return integrals, share * _by_coefficient(integrals, self.slopes.regions[1], self.space.unknowns)


def has_rule(target: Target) -> bool:
    """Return whether integrals over a target are those at points (y, x) of a grid."""
    return target.area is not None or target.mask is not None


def thickness_slopes(of: FieldSlopes) -> np.ndarray:
    """Return the slopes (rows, columns) of a number by the scene's map of thickness.

    The fields have slopes by the thickness at each point, which a complex step gives exactly.
    """
    space, slopes = of.space, of.slopes
    scene, integrals, count = space.scene, space.integrals, space.unknowns
    laminate, factors = space.laminate, space.laminate.factors_at(*integrals.points)
    factors["thickness"] = factors["thickness"] + 1j * STEP
    rigidities, twist, mass, _ = laminate.fields(*integrals.points, factors)
    by_thickness = of.by_fields([np.asarray(field).imag / STEP for field in (*rigidities, twist, mass)])
    maps, of_mass = laminate.maps, scene.plate.density * scene.plate.thickness
    rows, columns = maps["thickness"].shape
    total = _hats(scene, 1, rows, integrals.points[1]).T @ by_thickness @ _hats(scene, 0, columns, integrals.points[0])
    if has_rule(scene.target):
        integrals, by_target = of.of_target
        (x, y) = integrals.points
        by_mass = of_mass * laminate.factors_at(x, y)["density"] * by_target
        return np.asarray(total + _hats(scene, 1, rows, y).T @ by_mass @ _hats(scene, 0, columns, x))
    points, weights = space.chord_points(scene.target)
    values = space.at_points(points)
    by_mass = of_mass * weights * ((values @ slopes.regions[1][:count, :count]) * values).sum(axis=1)
    if (density := maps.get("density")) is not None:
        along_y, along_x = (_hats(scene, axis, density.shape[1 - axis], points[:, axis]) for axis in (1, 0))
        by_mass *= ((along_y @ density) * along_x).sum(axis=1)
    along_y, along_x = _hats(scene, 1, rows, points[:, 1]), _hats(scene, 0, columns, points[:, 0])
    return np.asarray(total + (along_y * by_mass[:, None]).T @ along_x)


def _by_coefficient(
    integrals: Integrals, slopes: np.ndarray, count: int, factors: Factors = DISPLACEMENT
) -> np.ndarray:
    """Return the slopes at Gauss's points (y, x) by the coefficient of a term, from those by its matrix, of which the
    first ``count`` unknowns are those of the plate."""
    (row_x, column_x), (row_y, column_y) = integrals.pairs
    sides = [splines.functions for splines in reversed(integrals.along)]
    tables = slopes[:count, :count].reshape(*sides, *sides)
    gathered = tables[row_y[:, None], row_x, column_y[:, None], column_x]
    products = []
    for axis, splines in enumerate(integrals.along):
        first, second = (splines.values(integrals.points[axis], ORDERS[factor][axis]) for factor in factors)
        rows, columns = integrals.pairs[axis]
        products.append(first[rows] * second[columns])
    return np.asarray(integrals.weights * (products[1].T @ gathered @ products[0]))


def _hats(scene: Scene, axis: int, count: int, places: np.ndarray) -> np.ndarray:
    """Return (places, count) shares of the numbers of a map along x (0) or y (1) in its values at places [m]."""
    return bilinear(np.eye(count), np.linspace(0, 1, count), places / scene.plate.size[axis])

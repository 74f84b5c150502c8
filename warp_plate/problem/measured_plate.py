"""A panel known by its measured responses alone: energies of regions as forms of the drive, and their errors.

Velocities v = H z at the points of a scan are interpolated by cubic radial functions, r³ with a linear polynomial
(M. D. Buhmann, Radial Basis Functions, Cambridge 2003), so that the mean square over a region is a form of the drive,

    |v|²_R = zᴴ A_R z,     A_R = Hᴴ Q_R H,     Q_R = Sᵀ W_R S

with S the interpolation to the middles of small cells and W_R their areas in the region. Its error is at most

    ‖v‖_R − e_R ≤ true ≤ ‖v‖_R + e_R,     e_R² = zᴴ U_R z,     U_R = (L H)ᴴ W_R (L H)/4 + diag Σ_p (Q_R)_pp σ²_pk.

L v are the differences of each velocity from what the other points say of it (S. Rippa, Adv. Comput. Math. 11, 1999,
pp. 193-210, has them without a new interpolation for each point). The middle of four points is nearer to them, by √2,
than a point to its neighbours, and errors fall at least as the square of the distance: they are at most half of L v.
The other part is the noise, which drives with much cancellation amplify: the variances σ² of the measurement or, where
they are not known, the mean of |L H|² of each actuator, which is larger.

Noise of known variance adds N_R = diag Σ_p (Q_R)_pp σ²_pk to A_R on average. It makes the best drive look worse if that
moves the panel little, so that a part κ of it is subtracted before a drive is sought,

    κ = min(1, λ) − α M/n,     λ the least eigenvalue of A z = λ N z for the whole panel,

with M actuators and n points: the modified estimator of W. A. Fuller (Measurement Error Models, Wiley 1987, section
2.5), without bias to first order for α = 0, and of less variance for α > 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
import shapely
from shapely import Geometry as Geometry

from warp_plate.fitting.measured_matrix import MeasuredMatrix
from warp_plate.optimize.quadratic import RANK_TOLERANCE
from warp_plate.problem.allowed_drives import AllowedDrives
from warp_plate.problem.bounds import bound_localization
from warp_plate.problem.worst_points import shape_of
from warp_plate.scene.errors import SceneError
from warp_plate.scene.measured import MeasuredScene
from warp_plate.scene.target import Target
from warp_plate.solve.response import Response

# Powers of the angular frequency by which motions become accelerations.
POWERS = {"accelerance": 0, "mobility": 1, "receptance": 2}
# Cells along the longer side of the panel, and cells times points at most.
CELLS, MOST_NUMBERS = 96, 2**24
# Points beyond the panel by more than this part of its longer side are refused.
OUTSIDE = 1e-6
# Error between the points over that at a point that is left out.
NEARER = 0.5
# Weights of the errors in the rest that are tried for a robust drive; least relative errors of the rest, and rounds, in
# the bound of all true drives.
ROBUST = 0.0, 0.1, 1.0, 10.0, 100.0
# α of the noise that is subtracted.
LEFT = 6.0
SHARES, ROUNDS = (1e-9, 0.1, 0.3, 0.6, 0.9), 8


@dataclass(frozen=True, eq=False)
class Forms:
    """Forms of the drive, zᴴ matrix z, for one region at one frequency."""

    square: np.ndarray  # (actuators, actuators) A: integral of |motion|² over the region
    error: np.ndarray  # (actuators, actuators) U: square of the largest error of its root
    noise: np.ndarray  # (actuators,) diagonal of N: what noise adds to A on average; 0 where that is not known
    area: float  # [m²]

    def root(self, drive: np.ndarray) -> float:
        """Return the root mean square of the complex motion under a drive (actuators,)."""
        return math.sqrt(_form(self.square, drive) / self.area)

    def uncertainty(self, drive: np.ndarray) -> float:
        """Return the largest error of :meth:`root`."""
        return math.sqrt(_form(self.error, drive) / self.area)


def _form(matrix: np.ndarray, drive: np.ndarray) -> float:
    return max(float((drive.conj() @ matrix @ drive).real), 0.0)


class MeasuredPlate:
    """The measured responses of a scene, interpolated over the panel."""

    def __init__(self, scene: MeasuredScene, matrix: MeasuredMatrix) -> None:
        points = matrix.points
        if len(points) <= len(matrix.names) + 3:
            needed = f"{len(matrix.names)} actuators take more than {len(matrix.names) + 3}"
            raise SceneError(f"measured.file = {scene.measured.file!r}: has {len(points)} points; {needed}")
        self.scene, self.matrix = scene, matrix
        table = scene.measured.panel
        hull = shapely.MultiPoint(points).convex_hull
        self.shape = hull if table is None else shapely.box(table[0], table[2], table[1], table[3])
        x0, y0, x1, y1 = self.shape.bounds
        self._middle, self._side = np.array([x0 + x1, y0 + y1]) / 2, max(x1 - x0, y1 - y0)
        if not self.shape.area > OUTSIDE * self._side**2:
            raise SceneError(f"measured.file = {scene.measured.file!r}: all points are on one line")
        beyond = shapely.distance(shapely.points(points), self.shape) > OUTSIDE * self._side
        if beyond.any():
            x, y = points[beyond.argmax()]
            raise SceneError(f"measured.panel = {list(table or ())}: point {beyond.argmax() + 1}, {x:g}, {y:g}, is off")
        cells = min(CELLS, int(math.sqrt(MOST_NUMBERS / len(points))))
        nx, ny = (max(4, round(cells * side / self._side)) for side in (x1 - x0, y1 - y0))
        x, y = np.linspace(x0, x1, nx + 1), np.linspace(y0, y1, ny + 1)
        left, low = (part.ravel() for part in np.meshgrid(x[:-1], y[:-1]))
        boxes = shapely.box(left, low, left + (x[1] - x[0]), low + (y[1] - y[0]))
        here = shapely.intersects(boxes, self.shape)
        self._boxes = boxes[here]
        self.cells = np.stack([left + (x[1] - x[0]) / 2, low + (y[1] - y[0]) / 2], axis=1)[here]
        self.grid = (nx, ny), here

    def _functions(self, places: np.ndarray) -> np.ndarray:
        """Return the radial functions of all points and the polynomials (places, points + 3)."""
        centres, places = ((some - self._middle) / self._side for some in (self.matrix.points, places))
        distances = scipy.spatial.distance.cdist(places, centres)
        return np.hstack([distances**3, np.ones((len(places), 1)), places])

    @cached_property
    def _inverse(self) -> np.ndarray:
        """Inverse of the interpolation's matrix, (points + 3, points + 3)."""
        rows = self._functions(self.matrix.points)
        below = np.hstack([rows[:, -3:].T, np.zeros((3, 3))])
        return np.asarray(np.linalg.inv(np.vstack([rows, below])))

    def interpolation(self, places: np.ndarray) -> np.ndarray:
        """Return the matrix (places, points) from values at the points to values at places (places, 2) [m]."""
        return np.asarray(self._functions(places) @ self._inverse[:, : len(self.matrix.points)])

    @cached_property
    def _to_cells(self) -> np.ndarray:
        return self.interpolation(self.cells)

    @cached_property
    def _nearest(self) -> np.ndarray:
        """Point next to each cell."""
        return np.asarray(scipy.spatial.cKDTree(self.matrix.points).query(self.cells)[1])

    @cached_property
    def _left_out(self) -> np.ndarray:
        """L (points, points): each value minus what the others say of it."""
        inverse, count = self._inverse, len(self.matrix.points)
        return np.asarray(inverse[:count, :count] / np.diag(inverse)[:count, None])

    @cached_property
    def targets(self) -> dict[str, Geometry]:
        """Shapes of the targets on the panel by their names."""
        shapes = {name: shapely.intersection(shape_of(name, row), self.shape) for name, row in self._keys.items()}
        for name, shape in shapes.items():
            if not shape.area > 0:
                raise SceneError(f"{name}.{self._keys[name].shape}: is off the measured panel, {self.extent}")
        return dict(zip(self.scene.regions, shapes.values(), strict=True))

    @cached_property
    def all_targets(self) -> Geometry:
        """Shape of all targets together."""
        return shapely.union_all(list(self.targets.values()))

    @property
    def _keys(self) -> dict[str, Target]:
        regions = list(self.scene.regions.values())
        return {"target" if self.scene.target else f"targets[{k}]": region for k, region in enumerate(regions)}

    @property
    def extent(self) -> str:
        """Range of x and y, in words."""
        x0, y0, x1, y1 = self.shape.bounds
        return f"x {x0:g} to {x1:g}, y {y0:g} to {y1:g} m"

    @cached_property
    def largest(self) -> np.ndarray:
        """(actuators,) largest drives; SceneError if there are others than actuators."""
        given, count = self.scene.measured.largest, len(self.matrix.names)
        if isinstance(given, tuple) and len(given) != count:
            raise SceneError(f"measured.largest = {list(given)}: must be one number, or {count}, as many as actuators")
        return np.full(count, 1.0) * given

    def holds(self, point: tuple[float, float]) -> bool:
        """Return whether a point x, y [m] is on the panel."""
        return bool(shapely.distance(shapely.Point(point), self.shape) <= OUTSIDE * self._side)

    def points_in(self, shape: Geometry) -> np.ndarray:
        """Return the indices of the scanned points in a shape."""
        return np.flatnonzero(shapely.distance(shapely.points(self.matrix.points), shape) <= 1e-9 * self._side)

    def forms(self, shape: Geometry, line: int) -> Forms:
        """Return the forms of a region at a frequency, by its index, of drives in parts of their largest ones."""
        areas, square = self._areas(shape), self.quadrature(shape)
        rows = self.rows(line)
        left_out, weights = self._left_out @ rows, np.bincount(self._nearest, areas, minlength=len(rows))
        variance = np.mean(np.abs(left_out) ** 2, axis=0, keepdims=True)
        if self.matrix.variance is not None:
            variance = self.matrix.variance[line] * self.largest**2
        spread = np.diag(square) @ np.broadcast_to(variance, rows.shape)
        error = left_out.conj().T @ (weights[:, None] * left_out) * NEARER**2 + np.diag(spread)
        noise = np.zeros(len(self.largest)) if self.matrix.noise is None else self.matrix.noise[line] * self.largest**2
        noise = np.diag(square) @ np.broadcast_to(noise, rows.shape)
        return Forms(rows.conj().T @ (square @ rows), error, noise, float(areas.sum()))

    def _areas(self, shape: Geometry) -> np.ndarray:
        """Return the areas (cells,) [m²] of the cells in a region."""
        if shape not in self._known:
            areas = shapely.area(shapely.intersection(self._boxes, shapely.intersection(shape, self.shape)))
            self._known[shape] = areas, self._to_cells.T @ (areas[:, None] * self._to_cells)
        return self._known[shape][0]

    def quadrature(self, shape: Geometry) -> np.ndarray:
        """Return Q (points, points): vᴴ Q v is the integral of |v|² over a region."""
        self._areas(shape)
        return self._known[shape][1]

    @cached_property
    def _known(self) -> dict[Geometry, tuple[np.ndarray, np.ndarray]]:
        """Areas of cells, and Q, of regions."""
        return {}

    def to_acceleration(self, line: int) -> float:
        """Return the size of accelerations over that of the measured quantity, at a frequency, by its index."""
        return float((2 * math.pi * self.matrix.frequencies[line]) ** POWERS[self.scene.measured.quantity])

    def rows(self, line: int) -> np.ndarray:
        """Return (points, actuators) responses to the largest drives at a frequency, by its index."""
        return np.asarray(self.matrix.responses[line] * self.largest)

    def field(self, line: int, drive: np.ndarray) -> np.ndarray:
        """Return the motion (ny, nx) in the middles of cells under a drive (actuators,), in parts of the largest."""
        (nx, ny), here = self.grid
        field = np.full(nx * ny, np.nan, dtype=complex)
        field[here] = self._to_cells @ (self.rows(line) @ drive)
        return field.reshape(ny, nx)


@dataclass(frozen=True, eq=False)
class Localized:
    """A drive for the largest localization factor at one frequency."""

    drive: np.ndarray  # (actuators,) complex amplitudes, in parts of the largest ones
    factor: float  # localization factor by the measured responses
    interval: tuple[float, float]  # the true one, with the errors of noise and of places between the points
    robust_drive: np.ndarray  # (actuators,) the drive with the largest lower end of that interval
    robust_factor: float
    robust_interval: tuple[float, float]
    measured_bound: float  # largest factor of all drives by the measured responses
    bound: float  # largest factor of all drives, whatever the errors are; at most 1


def localize_measured(target: Forms, rest: Forms, points: int, equal: bool = False) -> Localized:
    """Return the best drive by the forms of the target and the rest of the panel, and what bounds all others.

    ``points`` is the number of scanned points.
    """
    allowed, bounds, drives = _allowed(len(target.square), equal), [], []
    whole = target.square + rest.square
    part = _noise_part(whole, target.noise + rest.noise, points)
    pairs = [(whole + weight * rest.error, target.square) for weight in ROBUST]
    if part > 0:
        pairs.append((whole - part * np.diag(target.noise + rest.noise), target.square - part * np.diag(target.noise)))
    for pair in pairs:
        bound = bound_localization(Response(np.stack([_real(form) for form in pair])), allowed)
        if bound is None or bound.drive is None:
            raise SceneError("measured: no drive moves the panel")
        bounds.append(bound.value)
        drives.append(bound.drive / bound.drive[np.abs(bound.drive).argmax()])
    best, robust = drives[-1 if part > 0 else 0], max(drives, key=lambda drive: _interval(target, rest, drive)[0])
    (own, ends), (other, others) = (
        (_factor(target, rest, one), _interval(target, rest, one)) for one in (best, robust)
    )
    return Localized(best, own, ends, robust, other, others, bounds[0], _true_bound(target, rest, best))


def _noise_part(whole: np.ndarray, noise: np.ndarray, points: int) -> float:
    """Return the part κ of the noise (actuators,) that is subtracted from forms; 0 if it is not known or is nothing."""
    if not (noise > 0).all():
        return 0.0
    least = float(np.linalg.eigvalsh(whole / np.sqrt(np.outer(noise, noise)))[0])
    return max(min(1.0, least) - LEFT * len(noise) / points, 0.0)


def measured_factor_bound(target: Forms, rest: Forms, equal: bool = False) -> float:
    """Return the largest localization factor of all drives by the measured responses."""
    matrices = np.stack([_real(target.square + rest.square), _real(target.square)])
    bound = bound_localization(Response(matrices), _allowed(len(target.square), equal), attain=False)
    return math.nan if bound is None else min(bound.value, 1.0)


def _allowed(count: int, equal: bool) -> AllowedDrives:
    lower = np.full(count, 1.0 if equal else 0.0)
    return AllowedDrives(lower, np.ones(count), np.full(count, np.nan), equal=equal)


def _real(form: np.ndarray) -> np.ndarray:
    """Return the matrix of a Hermitian form over (Re z, −Im z), as of :mod:`warp_plate.optimize.quadratic`."""
    return np.block([[form.real, form.imag], [-form.imag, form.real]])


def _factor(target: Forms, rest: Forms, drive: np.ndarray) -> float:
    inside, outside = _form(target.square, drive), _form(rest.square, drive)
    return inside / (inside + outside)


def _interval(target: Forms, rest: Forms, drive: np.ndarray) -> tuple[float, float]:
    """Return the least and the largest localization factor within the errors."""
    (a, da), (b, db) = (
        (math.sqrt(_form(of.square, drive)), math.sqrt(_form(of.error, drive))) for of in (target, rest)
    )
    low, high = max(a - da, 0.0) ** 2, (a + da) ** 2
    return low / max(low + (b + db) ** 2, 1e-300), high / max(high + max(b - db, 0.0) ** 2, 1e-300)


def _true_bound(target: Forms, rest: Forms, drive: np.ndarray) -> float:
    """Return a localization factor that no drive exceeds, if all motions are within their errors; 1 without a proof.

    For any s, t > 0, (a + e)² ≤ (1 + s) a² + (1 + 1/s) e² and (b − f)² ≥ (1 − t) b² − (1/t − 1) f², so that the largest
    eigenvalue of these forms bounds the ratio of all true energies; s and t are those of the drive before, t no less
    than some of the ``SHARES``.
    """
    least, count, first = math.inf, len(drive), drive
    for held in SHARES:
        drive = first
        for _ in range(ROUNDS):
            ratios = [math.sqrt(_form(of.error, drive) / max(_form(of.square, drive), 1e-300)) for of in (target, rest)]
            s, t = max(ratios[0], 1e-9), min(max(ratios[1], held), SHARES[-1])
            above = (1 + s) * target.square + (1 + 1 / s) * target.error
            below = (1 - t) * rest.square - (1 / t - 1) * rest.error
            size = np.sqrt(np.maximum(np.diag(rest.square).real, 1e-300))
            if np.linalg.eigvalsh(below / np.outer(size, size))[0] <= RANK_TOLERANCE:
                break
            values, vectors = scipy.linalg.eigh(above, below, subset_by_index=(count - 1, count - 1))
            drive = vectors[:, 0]
            if values[0] >= least * (1 - 1e-6):
                break
            least = float(values[0])
    return 1.0 if math.isinf(least) else least / (1 + least)

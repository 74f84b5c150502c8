"""Comparison of a drive measured on the panel with the prediction of its result.

With squares s = v² of the measured root mean square velocities, interpolated by thin-plate splines, the energies of the
target and of the plate are sums a_T·s and a_P·s over the measured points, so that the localization factor is

    LF = a_T·s / a_P·s,     var LF = Σ_k (a_T − LF a_P)_k² (2 v_k σ_k)² / (a_P·s)²

with the standard deviations σ of the velocities. Noise adds σ² to each square, which is subtracted. The error of
sampling at few points is estimated from the predicted field, whose factor is known; it counts twice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import scipy

from warp_plate.analysis.motion import motions
from warp_plate.fitting.measured_modes import column_numbers, read_table_columns
from warp_plate.fitting.verdict import LEFT, moves
from warp_plate.plate.weights import node_positions, region_weights
from warp_plate.result.model import Result
from warp_plate.scene.errors import SceneError, check_type
from warp_plate.scene.fields import SMALLEST

MOST_POINTS = 2000
# Readings nearer than this part of the largest coordinate are of one point; points with less of their extent across a
# line are on it.
NEAR, FLAT = 1e-6, 1e-4
NORMAL = 1.96  # half-width of 95 % intervals in standard deviations
COLUMNS = "x", "y", "velocity", "uncertainty"
UNLIKE = 0.02  # what the cosine of velocities lacks of 1, from which on mirrored points are looked for


@dataclass(frozen=True, eq=False)
class MeasuredField:
    """Velocities of a panel under a drive."""

    source: str  # file that they come from
    points: np.ndarray  # (n, 2) x, y [m]
    velocity: np.ndarray  # (n,) root mean square velocities [m/s], or anything in proportion to them
    uncertainty: np.ndarray | None  # (n,) their standard deviations; None if not known


@dataclass(frozen=True, eq=False)
class Verification:
    """Comparison of measured and predicted velocities."""

    case: str  # name of the drive
    measured: MeasuredField  # with repeated readings averaged
    promised: np.ndarray  # (n,) predicted root mean square velocities at the points [m/s]
    promised_factor: float  # localization factor of the result
    localization_factor: float  # measured localization factor
    deviation: float  # its standard deviation from the noise; NaN if that is not known
    sampling: float  # localization factor of the predicted field sampled at these points, less its true one
    scale: float  # measured over predicted velocity, by least squares
    correlation: float  # cosine between the measured and the predicted velocities
    mirrored: str | None = None  # "mirrored in x", ... where that gives another cosine by far; None if not
    mirrored_correlation: float = math.nan  # that cosine

    def __repr__(self) -> str:
        measured, (low, high) = self.localization_factor, self.interval
        return f"<Verification of {self.case}: localization factor {measured:.4g}, {low:.4g} to {high:.4g}>"

    @property
    def interval(self) -> tuple[float, float]:
        """Lowest and highest localization factor: 95 % for the noise, and twice the error of sampling."""
        width = NORMAL * float(np.nan_to_num(self.deviation)) + 2 * abs(self.sampling)
        low, high = np.clip([self.localization_factor - width, self.localization_factor + width], 0.0, 1.0).tolist()
        return low, high

    @property
    def kept(self) -> bool:
        """True if the predicted localization factor is not above the interval."""
        return self.promised_factor <= self.interval[1]

    @property
    def warnings(self) -> tuple[str, ...]:
        """Lines that the command prints after "!"."""
        lines = {
            "The drive does not keep its promise: fit the scene to a measurement, and search again.": not self.kept,
            f"The scan is {self.mirrored}: the cosine of the velocities is then {self.mirrored_correlation:.4f}, not "
            f"{self.correlation:.4f}. Correct x and y of the file.": self.mirrored is not None,
            "The noise is not known: add a column uncertainty, or measure each point twice.": np.isnan(self.deviation),
        }
        return tuple(line for line, applies in lines.items() if applies)


def verify(result: Result, data: Path | MeasuredField, case: str | None = None) -> Verification:
    """Compare velocities measured under a drive with those of its result.

    Args:
        result: Result of ``localize`` or ``simulate``.
        data: Measured velocities, or a CSV file with the columns x, y, velocity and optionally uncertainty.
        case: Name of the drive (default: the best one, or the one that was simulated).

    Raises:
        SceneError: The file is invalid, the velocities are noise, or the points are not on the panel or on one line.
    """
    check_type("result", result, Result)
    check_type("data", data, Path, MeasuredField)
    ((name, chosen),) = result.select_cases([result.main_name if case is None else case]).items()
    scene = result.case_scene(chosen)
    measured = average_readings(read_field(data) if isinstance(data, Path) else data)
    (motion,) = motions(result.scene, {name: chosen})
    field = motion.rms_velocity.astype(float)
    weights = region_weights(scene) * motion.surface_density
    axes = node_positions(scene)
    x, y = measured.points.T
    if np.any((measured.points < 0) | (measured.points > scene.plate.size)):
        raise SceneError(f"{measured.source}: a point is off the plate of {list(scene.plate.size)} m")
    predict = scipy.interpolate.RegularGridInterpolator(axes[::-1], field)
    promised = predict(np.stack([y, x], axis=1))
    plate, target = _quadrature(measured, axes, weights)
    squares, noise = measured.velocity**2, measured.uncertainty
    seen = (target @ promised**2) / (plate @ promised**2)
    true = np.sum(weights[1] * field**2) / np.sum(weights[0] * field**2)
    whole = plate @ (squares if noise is None else squares - noise**2)
    if not whole > 0:
        raise SceneError(f"{measured.source}: velocities are not above their uncertainty; measure with less noise")
    factor = target @ (squares if noise is None else squares - noise**2) / whole
    deviation = math.nan
    if noise is not None:
        deviation = float(np.linalg.norm((target - factor * plate) * 2 * measured.velocity * noise) / whole)
    product, size = measured.velocity @ promised, promised @ promised
    correlation, cosines = _cosine(measured.velocity, promised), {}
    for moved, (_, move) in moves(*scene.plate.size).items():
        places = np.array([move(*point) for point in measured.points])
        if np.all(places <= scene.plate.size):
            cosines[moved] = _cosine(measured.velocity, predict(places[:, ::-1]))
    best = max(cosines, key=lambda moved: cosines[moved])
    mirrored = 1 - correlation > UNLIKE and 1 - cosines[best] < LEFT * (1 - correlation)
    return Verification(
        case=name,
        measured=measured,
        promised=promised,
        promised_factor=chosen.localization_factor,
        localization_factor=float(factor),
        deviation=deviation,
        sampling=float(seen - true),
        scale=float(product / size),
        correlation=correlation,
        mirrored=best if mirrored else None,
        mirrored_correlation=cosines[best] if mirrored else math.nan,
    )


def _cosine(one: np.ndarray, other: np.ndarray) -> float:
    return float(one @ other / math.sqrt((one @ one) * (other @ other)))


def read_field(path: Path) -> MeasuredField:
    """Return the velocities of a CSV file with the columns x, y [m], velocity [m/s] and maybe uncertainty [m/s]."""
    columns = read_table_columns(path, "velocity")
    if missing := [name for name in COLUMNS[:3] if name not in columns]:
        raise SceneError(f"{path}: has no column {missing[0]!r}; the columns are: {', '.join(columns)}")
    table = {name: column_numbers(path, name, columns[name]) for name in COLUMNS if name in columns}
    if not any(table["velocity"] > SMALLEST):
        raise SceneError(f"{path}: needs velocities that are not all 0")
    points = np.stack([table["x"], table["y"]], axis=1)
    return MeasuredField(str(path), points, table["velocity"], table.get("uncertainty"))


def average_readings(field: MeasuredField) -> MeasuredField:
    """Average the readings of each point; where all have several and no uncertainty, it is that of their mean.

    Readings that are NaN, as of points that a scanner did not see, are left out.
    """
    seen = np.isfinite(field.velocity) & (field.uncertainty is None or np.isfinite(field.uncertainty))
    uncertainty = None if field.uncertainty is None else field.uncertainty[seen]
    field = replace(field, points=field.points[seen], velocity=field.velocity[seen], uncertainty=uncertainty)
    places = np.rint(field.points / (NEAR * (np.abs(field.points).max(initial=0.0) or 1.0)))
    _, first, which, counts = np.unique(places, axis=0, return_index=True, return_inverse=True, return_counts=True)
    points, which = field.points[first], which.ravel()
    if not 4 <= len(points) <= MOST_POINTS:
        raise SceneError(f"{field.source}: {len(points)} points; 4 to {MOST_POINTS} are possible")
    mean = np.bincount(which, field.velocity) / counts
    if field.uncertainty is not None:
        return MeasuredField(field.source, points, mean, np.sqrt(np.bincount(which, field.uncertainty**2)) / counts)
    if counts.min() < 2:
        return MeasuredField(field.source, points, mean, None)
    spread = np.bincount(which, (field.velocity - mean[which]) ** 2) / (counts - 1)
    return MeasuredField(field.source, points, mean, np.sqrt(spread / counts))


def _quadrature(measured: MeasuredField, axes: tuple[np.ndarray, np.ndarray], weights: np.ndarray) -> np.ndarray:
    """Return (2, n) weights of the squares at the points in the energies of the plate and of the target."""
    x, y = np.meshgrid(*axes)
    nodes, identity = np.stack([x.ravel(), y.ravel()], axis=1), np.eye(len(measured.points))
    along, across = np.linalg.svd(measured.points - measured.points.mean(axis=0), compute_uv=False)
    if across < FLAT * along:
        raise SceneError(f"{measured.source}: all points lie on one line; measure over the panel")
    spline = scipy.interpolate.RBFInterpolator(measured.points, identity, kernel="thin_plate_spline")
    total = np.zeros((2, len(identity)))
    for part in np.array_split(np.arange(len(nodes)), -(-nodes.shape[0] * len(identity) // 2**22)):
        total += weights.reshape(2, -1)[:, part] @ spline(nodes[part])
    return total

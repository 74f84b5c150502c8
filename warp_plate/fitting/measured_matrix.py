"""Responses of all points of a scan to all actuators, from HDF5, MAT and universal files.

A coherence γ² of n averages leaves a response with the variance (Bendat, Piersol, Random Data, chapter 9)

    E|ΔH|² = |H|² (1 − γ²) / (γ² (n − 1)),

n − 1 because γ² is estimated by the same averages.

Where there is a fitted plate with responses M, responses of each actuator at each frequency are taken between both,

    H' = g M + w (H − g M),     w = τ² / (τ² + σ²),     τ² = mean |H − g M|² − σ²,

with the gain g of least squares: the posterior means if the plate's errors have the variance τ², estimated by that of
the differences (C. N. Morris, J. Am. Stat. Assoc. 78, 1983, pp. 47-55). Their variance is w σ², and that of the gain;
noise adds w² σ² to their squares on average.

A plate with few modes in a range has responses whose dependences on the frequency are combinations of few. With known
variances, the matrix X (lines, points · actuators) of neighbouring lines is scaled by rows and columns until they are
1 on average in each (B. Landa, T. T. C. K. Zhang, Y. Kluger, SIAM J. Math. Data Sci. 4, 2022, pp. 1388-1413). Singular
values of noise alone are then at most √lines + √(points · actuators) (M. Gavish, D. L. Donoho, IEEE Trans. Inf. Theory
63, 2017, pp. 2137-2152), and the projection P on the left singular vectors of larger ones leaves the variances

    Σ_m |P_lm|² σ²_mc,

r of L in the mean for r vectors of L lines. Smoothness in space cannot do the same: to first order, the drive depends
on the noise along the fields of the actuators alone, which are smooth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from warp_plate.fitting.measured_modes import check_file
from warp_plate.fitting.measured_universal import ACROSS, COHERENCE, ORDERS, RESPONSE, UNKNOWN, read_universal
from warp_plate.modal.modes import solve_modes
from warp_plate.plate.memory import refuse_beyond_memory
from warp_plate.result.frequency_response import DERIVATIVES
from warp_plate.result.hdf5 import HDF5, MAT, read_arrays
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import LARGEST, SMALLEST
from warp_plate.scene.measured import Measured, MeasuredScene
from warp_plate.scene.model import Scene

MATRIX_BYTES, MOST_POINTS, MOST_ACTUATORS, MOST_LINES = 2**30, 2000, 64, 2**16
ARRAYS = "frequency", "points", "response", "real", "imaginary", "coherence", "impulse", "rate"
LEAST_COHERENCE = 1e-6
# Lines that are taken together to reduce noise, fewest of them, rounds that scale rows and columns, and the least
# variance over the mean.
TOGETHER, FEWEST, SCALINGS, NEGLIGIBLE = 256, 8, 8, 1e-12


@dataclass(frozen=True, eq=False)
class MeasuredMatrix:
    """Responses of the points of a scan to the actuators, for motion that varies as exp(iωt)."""

    source: str  # file that they come from
    frequencies: np.ndarray  # (n,) [Hz], rising, above 0
    responses: np.ndarray  # (n, points, actuators) complex motion per unit of drive
    points: np.ndarray  # (points, 2) x, y [m]
    names: tuple[str, ...]  # of the actuators
    variance: np.ndarray | None = None  # (n, points, actuators) E|ΔH|²; None if it is not known
    impulses: np.ndarray | None = None  # (actuators, points, samples) motion after a unit sample; None if not measured
    rate: float = 0.0  # samples a second of the impulse responses
    noise: np.ndarray | None = None  # (n, points, actuators) what noise adds to |H|² on average; None if not known


@np.errstate(all="ignore")  # of numbers that are refused in the end
def read_matrix(scene: MeasuredScene) -> MeasuredMatrix:
    """Return the responses of a scene's file.

    HDF5 and MAT files have the arrays ``points`` (points, 2) [m], ``frequency`` (n,) [Hz], and ``response``, or
    ``real`` and ``imaginary``, (actuators, points, n), and maybe ``coherence`` of the same shape. Instead of
    frequencies and responses they may have ``impulse`` (actuators, points, samples) and ``rate`` [1/s]. A universal
    file has a dataset 58 for each response, and places of its nodes in a dataset 15 or 2411.

    Raises:
        SceneError: The file cannot be read, or holds no such responses.
    """
    table = scene.measured
    path = (scene.folder or Path()) / table.file
    try:
        check_file(path, MATRIX_BYTES)
        return (_arrays if path.suffix.lower() in (*MAT, *HDF5) else _universal)(path, table)
    except (OSError, ValueError) as error:
        raise SceneError(f"measured.file = {table.file!r}: {str(error).removeprefix(f'{path}: ')}") from None


def _check(matrix: MeasuredMatrix) -> None:
    count, points, actuators = matrix.responses.shape
    for name, value, most in (
        ("frequencies", count, MOST_LINES),
        ("points", points, MOST_POINTS),
        ("actuators", actuators, MOST_ACTUATORS),
    ):
        if not 1 <= value <= most:
            raise ValueError(f"has {value} {name}; 1 to {most} are possible")
    if not (matrix.frequencies[0] > 0 and (np.diff(matrix.frequencies) > 0).all()):
        raise ValueError("frequencies must rise, from above 0 Hz")
    if matrix.frequencies[-1] > LARGEST:
        raise ValueError(f"frequencies are at most {LARGEST:g} Hz")
    if not (np.isfinite(matrix.points).all() and np.abs(matrix.points).max() < LARGEST):
        raise ValueError("points must be numbers in metres")
    if len(np.unique(matrix.points, axis=0)) < points:
        raise ValueError("two points are at one place; average their responses")
    if not (np.abs(matrix.responses) < LARGEST).all():
        row, point, column = np.argwhere(~(np.abs(matrix.responses) < LARGEST))[0].tolist()
        at = f"{matrix.names[column]}, point {point + 1}, {matrix.frequencies[row]:g} Hz"
        raise ValueError(f"the response of {at} is {matrix.responses[row, point, column]:g}; leave that point out")
    largest = np.abs(matrix.responses).max(axis=(0, 1))
    if not (largest >= SMALLEST).all():
        raise ValueError(f"the responses to {matrix.names[int(np.argmin(largest))]} are 0, or below {SMALLEST:g}")


def _arrays(path: Path, table: Measured) -> MeasuredMatrix:
    """Return the responses of a MAT or HDF5 file."""
    arrays = {name: np.atleast_1d(values) for name, values in read_arrays(path, ARRAYS).items()}
    places = arrays.get("points", np.empty(0))
    places = places.T if places.shape[0] == 2 != places.shape[-1] else places
    if places.ndim != 2 or places.shape[1] != 2:
        raise ValueError(f"needs the array points, x and y in metres, of shape (points, 2); has {', '.join(arrays)}")
    impulses, rate = arrays.get("impulse"), 0.0
    if impulses is not None:
        if impulses.ndim != 3 or impulses.shape[1] != len(places):
            raise ValueError(f"impulse has shape {impulses.shape}; must be (actuators, {len(places)}, samples)")
        rates = arrays.get("rate", np.empty(0)).ravel().tolist()
        if len(rates) != 1 or not SMALLEST <= rates[0] <= LARGEST:
            has = f"{rates[0]:g}" if len(rates) == 1 else f"{len(rates)} numbers"
            rule = f"impulse comes with rate in samples a second, one number from {SMALLEST:g} to {LARGEST:g}"
            raise ValueError(f"rate has {has}; {rule}")
        rate = rates[0]
        if not (np.abs(impulses) < LARGEST).all():
            raise ValueError(f"impulse must hold numbers up to {LARGEST:g}")
        if impulses.shape[2] < 2:
            raise ValueError("impulse has fewer than 2 samples")
        frequency = np.arange(1, impulses.shape[2] // 2 + 1) * rate / impulses.shape[2]
        responses, coherence = np.fft.rfft(impulses)[..., 1:], None
    else:
        given = arrays.get("response")
        if given is None and {"real", "imaginary"} <= set(arrays):
            if arrays["real"].shape != arrays["imaginary"].shape:
                raise ValueError(f"imaginary has shape {arrays['imaginary'].shape}; real has {arrays['real'].shape}")
            given = arrays["real"] + 1j * arrays["imaginary"]
        if given is None or "frequency" not in arrays:
            raise ValueError(f"needs frequency and response, or impulse and rate; has {', '.join(arrays)}")
        frequency = arrays["frequency"].ravel()
        responses = _ordered("response", given, len(places), len(frequency))
        coherence = arrays.get("coherence")
        if coherence is not None:
            coherence = _ordered("coherence", coherence, len(places), len(frequency))
            if coherence.shape != responses.shape:
                raise ValueError(f"coherence has shape {coherence.shape}; response has {responses.shape}")
    names = tuple(f"actuator {number}" for number in range(1, len(responses) + 1))
    spectra = frequency, responses.T, None if coherence is None else coherence.T
    return _matrix(path, table, spectra, places, names, impulses, rate)


def _ordered(name: str, values: np.ndarray, points: int, lines: int) -> np.ndarray:
    """Return values of one or several actuators as (actuators, points, lines)."""
    values = values[None] if values.ndim == 2 else values
    if values.ndim == 3 and values.shape[1:] != (points, lines):  # MATLAB's order, or that of xarray
        axes = [[axis for axis, size in enumerate(values.shape) if size == wanted] for wanted in (points, lines)]
        if len(axes[0]) == len(axes[1]) == 1 and axes[0] != axes[1]:
            values = np.moveaxis(values, (axes[0][0], axes[1][0]), (1, 2))
    if values.ndim != 3 or values.shape[1:] != (points, lines):
        raise ValueError(f"{name} has shape {values.shape}; must be (actuators, {points} points, {lines} frequencies)")
    return values


def _matrix(
    path: Path,
    table: Measured,
    spectra: tuple[np.ndarray, np.ndarray, np.ndarray | None],
    places: np.ndarray,
    names: tuple[str, ...],
    impulses: np.ndarray | None = None,
    rate: float = 0.0,
) -> MeasuredMatrix:
    """Return the matrix of frequencies, responses and coherences (n, points, actuators) without 0 Hz."""
    frequency, responses, coherence = spectra
    above = frequency != 0
    frequency, responses = frequency[above], responses[above]
    matrix = MeasuredMatrix(str(path), frequency, responses, places, names, None, impulses, rate)
    _check(matrix)
    variance = None
    if table.noise is not None:
        sizes = np.mean(np.abs(responses) ** 2, axis=1, keepdims=True)
        variance = np.broadcast_to(table.noise**2 * sizes, responses.shape)
    elif coherence is not None and table.averages is not None:
        coherence = coherence[above]
        if not np.all((coherence >= 0) & (coherence <= 1 + 1e-6)):
            raise ValueError("coherence must be from 0 to 1")
        coherence = np.clip(coherence, LEAST_COHERENCE, 1)
        variance = np.abs(responses) ** 2 * (1 - coherence) / (coherence * (table.averages - 1))
    elif table.averages is not None:
        raise ValueError("has no coherences; delete measured.averages, or write measured.noise")
    return replace(matrix, variance=variance, noise=variance)


def _universal(path: Path, table: Measured) -> MeasuredMatrix:
    """Return the responses of a universal file: references are actuators, responses points."""
    file = read_universal(path)
    functions = {
        kind: _by_ends([item for item in file.of(58) if item["func_type"] == kind]) for kind in (RESPONSE, COHERENCE)
    }
    found = functions[RESPONSE]
    if not found:
        raise ValueError("has no frequency response (dataset 58 of function type 4)")
    references, nodes = sorted({reference for reference, _ in found}), sorted({node for _, node in found})
    for reference in references:
        for node in nodes:
            if (reference, node) not in found:
                raise ValueError(f"has no response of node {node} to {_name(reference)}")
    for item in found.values():
        _check_kind(item, table.quantity)
    places = file.places()
    if missing := [node for node in nodes if node not in places]:
        raise ValueError(f"node {missing[0]} has no place (dataset 15 or 2411)")
    frequency = np.asarray(next(iter(found.values()))["x"], dtype=float)

    def values(kind: int) -> np.ndarray:
        """Return (n, points, actuators) values."""
        items = [[functions[kind][reference, node] for reference in references] for node in nodes]
        if any(not np.array_equal(item["x"], frequency) for row in items for item in row):
            raise ValueError("its functions are at different frequencies")
        signs = [[_sign(item) if kind == RESPONSE else 1 for item in row] for row in items]
        data = np.array([[item["data"] for item in row] for row in items]) * np.array(signs)[..., None]
        return np.asarray(np.moveaxis(data, 2, 0))

    coherence = values(COHERENCE).real if set(functions[COHERENCE]) >= set(found) else None
    spectra = frequency, values(RESPONSE), coherence
    return _matrix(path, table, spectra, np.array([places[node] for node in nodes]), tuple(map(_name, references)))


def _by_ends(items: list[dict[str, Any]]) -> dict[tuple[tuple[int, int], int], dict[str, Any]]:
    """Return functions by their ends: of several directions of the responses those along Z, or of none."""
    directions = {abs(item["rsp_dir"]) for item in items}
    across = [item for item in items if len(directions) == 1 or abs(item["rsp_dir"]) in (0, ACROSS)]
    if items and not across:
        raise ValueError("has responses along several directions, but none along Z")
    found: dict[tuple[tuple[int, int], int], dict[str, Any]] = {}
    for item in across:
        if (ends := _ends(item)) in found:
            raise ValueError(f"has two functions of type {item['func_type']} of node {ends[1]} to {_name(ends[0])}")
        found[ends] = item
    return found


def _check_kind(item: dict[str, Any], quantity: str) -> None:
    """Raise a ValueError unless a response is complex, and of the quantity that it is taken for."""
    code, what = item["ordinate_spec_data_type"], f"the response of node {item['rsp_node']}"
    if item["ord_data_type"] not in (5, 6):
        raise ValueError(f"{what} is real; a response has real and imaginary parts")
    if code not in UNKNOWN and ORDERS.get(code) != DERIVATIVES[quantity]:
        stated = list(DERIVATIVES)[ORDERS[code]] if code in ORDERS else f"ordinates of type {code}"
        raise ValueError(f"{what} states {stated}, but measured.quantity is {quantity}")


def _ends(item: dict[str, Any]) -> tuple[tuple[int, int], int]:
    """Return node and direction of the reference, without its sign, and the node of the response."""
    return (int(item["ref_node"]), abs(int(item["ref_dir"]))), int(item["rsp_node"])


def _sign(item: dict[str, Any]) -> int:
    return -1 if (int(item["ref_dir"]) < 0) != (int(item["rsp_dir"]) < 0) else 1


def _name(reference: tuple[int, int]) -> str:
    return f"node {reference[0]}" + f" {' XYZ'[reference[1]]}" * (reference[1] in (1, 2, 3))


def reduce_noise(matrix: MeasuredMatrix) -> MeasuredMatrix:
    """Return responses with less noise where its variance is known, by what neighbouring frequencies have in common.

    Their ``variance`` stays that of the measured responses: what lines have in common may be a disturbance too.
    """
    lines, variance = len(matrix.frequencies), matrix.variance
    if variance is None or lines < FEWEST or not variance.any():
        return matrix
    refuse_beyond_memory(64.0 * matrix.responses.size, f"{matrix.source}: noise of responses at {lines} frequencies")
    reduced = matrix.responses.copy(), variance.copy()
    for start in range(0, max(lines - TOGETHER // 2, 1), TOGETHER // 2):
        together = slice(start, start + TOGETHER)
        parts = _common(matrix.responses[together], variance[together])
        better = np.mean(parts[1] - variance[together], axis=1, keepdims=True) < 0
        inner = slice(TOGETHER // 4 if start else 0, None)  # its end is overwritten by the lines that come next
        for whole, part in zip(reduced, parts, strict=True):
            np.copyto(whole[together][inner], part[inner], where=better[inner])
    return replace(matrix, responses=reduced[0], noise=reduced[1])


def _common(responses: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what responses (lines, points, actuators) of neighbouring lines share, and the variances of its noise."""
    lines, count = len(responses), responses[0].size
    sigma2 = np.maximum(variance, NEGLIGIBLE * variance.mean()).reshape(lines, count)
    columns = np.ones((1, count))
    for _ in range(SCALINGS):
        rows = np.mean(sigma2 / columns, axis=1, keepdims=True)
        columns = np.mean(sigma2 / rows, axis=0, keepdims=True)
    scale = rows * columns
    scaled = responses.reshape(lines, count) / np.sqrt(scale)
    squares, vectors = np.linalg.eigh(scaled @ scaled.conj().T)
    vectors = vectors[:, squares > (math.sqrt(lines) + math.sqrt(count)) ** 2]
    vectors = vectors if vectors.size else np.eye(lines)  # all is noise: what is left must not be nothing
    projection = vectors @ vectors.conj().T
    noise = np.abs(projection) ** 2 @ (sigma2 / scale) * scale
    return (projection @ scaled * np.sqrt(scale)).reshape(responses.shape), noise.reshape(responses.shape)


def blend(matrix: MeasuredMatrix, scene: MeasuredScene) -> MeasuredMatrix:
    """Return responses between the measured ones and those of the plate ``measured.fitted``; SceneError: it does not
    fit them."""
    name, sigma2 = scene.measured.fitted, matrix.noise
    assert name is not None
    head = f"measured.fitted = {name!r}"
    try:
        fitted = Scene.load((scene.folder or Path()) / name)
    except SceneError as error:
        raise SceneError(f"{head}: {error}") from None
    if matrix.variance is None or sigma2 is None:
        raise SceneError(f"{head}: its part follows from the noise; write measured.noise or averages")
    if len(fitted.actuators) != len(matrix.names):
        raise SceneError(f"{head}: has {len(fitted.actuators)} actuators; the responses have {len(matrix.names)}")
    if ((matrix.points < 0) | (matrix.points > fitted.plate.size)).any():
        raise SceneError(f"{head}: a scanned point is off its plate of {list(fitted.plate.size)} m")
    plate = solve_modes(fitted, float(matrix.frequencies[-1]), key=head)
    lines, modes = len(matrix.frequencies), len(plate.frequencies)
    needed = 36.0 * lines * modes * len(matrix.names) + 64.0 * matrix.responses.size
    refuse_beyond_memory(needed, f"{head}: responses of {modes} modes at {lines} frequencies")
    forces, shapes = plate.actuator_forces()[None], plate.at_points(matrix.points).T
    moved = np.stack([plate.respond_to_drives(np.array([[at]]), forces)[0] for at in matrix.frequencies])
    power = DERIVATIVES[scene.measured.quantity]
    model = (2j * np.pi * matrix.frequencies[:, None, None]) ** power * (shapes @ moved)
    size = np.sum(np.abs(model) ** 2, axis=1, keepdims=True)
    product = np.sum(model.conj() * matrix.responses, axis=1, keepdims=True)
    model = model * np.divide(product, size, out=np.zeros_like(product), where=size > 0)
    rest = matrix.responses - model
    tau2 = np.mean(np.abs(rest) ** 2 - sigma2, axis=1, keepdims=True).clip(min=0)
    weight = tau2 / np.maximum(tau2 + sigma2, 1e-300)
    variance = matrix.variance * (weight + 1 / len(matrix.points))
    noise = sigma2 * weight**2
    return replace(matrix, responses=model + weight * rest, variance=variance, noise=noise)

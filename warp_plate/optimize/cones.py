"""Drives that keep wanted and allowed levels: second-order cone programs, and the proof of what no drive can do.

A drive z (inputs,) is a vector of complex amplitudes, each as a part of what its actuator may have. With rows g and
blocks of rows G of the plate's response, in units of what is wanted or allowed, find the drive of the least scale s for

    Re(g z) ≥ 1,     ‖G z‖ ≤ s (scaled blocks),     ‖G z‖ ≤ 1 (other blocks),     |z_k| ≤ s or 1.

Any multipliers λ ≥ 0 and m with Σ λ g = Σ mᴴ G prove that no drive has a smaller scale than

    (Σ λ − Σ_others ‖m‖) / Σ_scaled ‖m‖ ≤ s,

since Σ λ ≤ Re(Σ λ g z) = Re(Σ mᴴ G z) ≤ Σ ‖m‖ ‖G z‖ (S. Boyd and L. Vandenberghe, Convex Optimization, chapter 5).
Those of the solver are made exact by the rows of the single actuators, which absorb its rounding.

A wanted mean square, ‖R z‖ ≥ 1, is not convex. Its relaxation, Z ⪰ 0 in place of z zᴴ, has a bound, proved by
Σ ν GᴴG − Σ λ RᴴR ⪰ 0; drives come from Re(dᴴR z) ≥ 1 with d = R z₀/‖R z₀‖, which implies ‖R z‖ ≥ 1 and is true
of z₀ (T. Lipp and S. Boyd, Optim. Eng. 17, 2016, pp. 263-287). The best of drives drawn with the covariance Z are
starts, too (Z.-Q. Luo et al., IEEE Signal Process. Mag. 27(3), 2010, pp. 20-34).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import clarabel
import numpy as np
import scipy

from warp_plate.optimize.relaxation import LARGEST, ROUNDING, best_multipliers, make_forms

TOLERANCE = 1e-10
LARGE = 80  # unknowns above which Clarabel's method of dense blocks takes less time
RANK = 1e-9  # least singular value, over the largest, of rows that absorb the rounding of a proof
INFEASIBLE = (clarabel.SolverStatus.PrimalInfeasible, clarabel.SolverStatus.AlmostPrimalInfeasible)
EXCESS = 1e-3  # violation of a normalised program from which on what the solver ends with is no solution
# Steps of the drive's phases in a problem that is not convex, and the relative gain below which they end.
STEPS, GAIN = 60, 1e-7
PROMISING = 2  # searches that go on after their first step
DRAWN, BEST = 512, 3  # drives that are drawn from the relaxation, and those of the least scales, which start searches


@dataclass(frozen=True)
class Block:
    """Blocks of rows whose norms are limited."""

    rows: np.ndarray  # (blocks, rows, inputs) in units of what is allowed
    scaled: bool = False  # true if s is allowed instead of 1


@dataclass(frozen=True)
class LeastScale:
    """The least scale of a program."""

    scale: float  # s; infinite if no scale helps
    bound: float  # proved lower bound of s
    drive: np.ndarray  # (inputs,) complex amplitudes; NaN where there is none
    wanted: np.ndarray  # (wanted,) multipliers λ
    allowed: tuple[np.ndarray, ...]  # (blocks,) multipliers ‖m‖ of each entry of the blocks, those of actuators first

    @property
    def start(self) -> np.ndarray | None:
        """The drive for another search to start from, if there is one."""
        return self.drive if np.isfinite(self.drive).all() else None


def least_scale(wanted: np.ndarray, blocks: Sequence[Block], actuators_scaled: bool = False) -> LeastScale:
    """Return the least scale for the wanted rows g (wanted, inputs), and blocks."""
    inputs = wanted.shape[1]
    unit, scale_unit, wanted, every = _normalised(wanted, blocks, actuators_scaled)
    matrix, limits, cones = [-_real_parts(wanted)], [-np.ones(len(wanted))], [clarabel.NonnegativeConeT(len(wanted))]
    for block in every:
        count, rows, _ = block.rows.shape
        real = np.stack([_real_parts(block.rows), _real_parts(-1j * block.rows)], axis=2)
        part = np.zeros((count, 1 + 2 * rows, 2 * inputs + 1))
        part[:, 1:, :-1] = -real[..., :-1].reshape(count, 2 * rows, 2 * inputs)
        part[:, 0, -1] = -1.0 if block.scaled else 0.0
        limit = np.zeros((count, 1 + 2 * rows))
        limit[:, 0] = 0.0 if block.scaled else 1.0
        matrix.append(part.reshape(-1, 2 * inputs + 1))
        limits.append(limit.ravel())
        cones += [clarabel.SecondOrderConeT(1 + 2 * rows)] * count
    cost = np.zeros(2 * inputs + 1)
    cost[-1] = 1.0
    solution = _solve(cost, np.concatenate(matrix), np.concatenate(limits), cones)
    multipliers = np.nan_to_num(np.array(solution.z), posinf=0.0, neginf=0.0)  # any multipliers prove a bound
    wanted_by = np.maximum(multipliers[: len(wanted)], 0)
    bound, norms = _proof(wanted, wanted_by, every, multipliers[len(wanted) :])
    allowed = tuple(norm / (scale_unit if block.scaled else 1.0) for norm, block in zip(norms, every, strict=True))
    x = np.array(solution.x)
    drive = unit * (x[:inputs] + 1j * x[inputs:-1])
    if solution.status in INFEASIBLE or not _excess(x, wanted, every) <= EXCESS:
        return LeastScale(math.inf, scale_unit * bound, np.full(inputs, np.nan), wanted_by, allowed)
    return LeastScale(scale_unit * float(x[-1]), scale_unit * bound, drive, wanted_by, allowed)


def _excess(x: np.ndarray, wanted: np.ndarray, blocks: Sequence[Block]) -> float:
    """Return by how much a solution violates a normalised program; NaN where it has no numbers."""
    z = x[: wanted.shape[1]] + 1j * x[wanted.shape[1] : -1]
    limits = ((block, x[-1] if block.scaled else 1.0) for block in blocks)
    over = [np.linalg.norm(block.rows @ z, axis=1) - limit for block, limit in limits]
    return float(np.concatenate([1 - (wanted @ z).real, *over]).max())


def _normalised(
    wanted: np.ndarray, blocks: Sequence[Block], actuators_scaled: bool
) -> tuple[float, float, np.ndarray, tuple[Block, ...]]:
    """Return units of the drive and of the scale in which rows are of size one; the wanted rows in them; and the
    blocks, that of the single actuators first."""
    inputs = wanted.shape[1]
    every = (Block(np.eye(inputs, dtype=complex)[:, None, :], actuators_scaled), *blocks)
    unit = 1 / max(float(np.linalg.norm(wanted, axis=1).max(initial=0.0)), 1e-300)
    sizes = [unit * float(np.abs(block.rows).max(initial=0.0)) for block in every if block.scaled]
    scale_unit = max(sizes, default=0.0) or 1.0
    scaled = (replace(block, rows=block.rows * (unit / scale_unit if block.scaled else unit)) for block in every)
    return unit, scale_unit, unit * wanted, tuple(scaled)


def _proof(
    wanted: np.ndarray, wanted_by: np.ndarray, blocks: Sequence[Block], multipliers: np.ndarray
) -> tuple[float, tuple[np.ndarray, ...]]:
    """Return the bound that multipliers prove after their repair, and the norms of those of the blocks.

    What is left of Σ λ g − Σ mᴴ G is absorbed by all rows, as far as their rounding allows, or by the actuators' alone.
    """
    place, vectors = 0, []
    for block in blocks:
        count, rows, _ = block.rows.shape
        part = multipliers[place : place + count * (1 + 2 * rows)].reshape(count, 1 + 2 * rows)[:, 1:]
        vectors.append(-(part[:, ::2] - 1j * part[:, 1::2]))
        place += count * (1 + 2 * rows)
    stacked = np.concatenate([block.rows.reshape(-1, wanted.shape[1]) for block in blocks])

    def rest() -> np.ndarray:
        return wanted_by @ wanted - np.concatenate([vector.ravel() for vector in vectors]) @ stacked

    def repaired() -> tuple[float, tuple[np.ndarray, ...]]:
        actuators = vectors[0] + rest()[:, None] / blocks[0].rows[0, 0, 0]
        norms = tuple(np.linalg.norm(vector, axis=1) for vector in (actuators, *vectors[1:]))
        scaled = sum(norm.sum() for norm, block in zip(norms, blocks, strict=True) if block.scaled)
        others = sum(norm.sum() for norm, block in zip(norms, blocks, strict=True) if not block.scaled)
        return _bound(wanted_by.sum() - others, scaled), norms

    alone = repaired()
    parts = np.split(np.linalg.lstsq(stacked.T, rest(), RANK)[0], np.cumsum([vector.size for vector in vectors])[:-1])
    vectors = [vector + part.reshape(vector.shape) for vector, part in zip(vectors, parts, strict=True)]
    return max(alone, repaired(), key=lambda proof: proof[0])


def _bound(proved: float, scaled: float) -> float:
    """Return the bound of a scale from both sides of its proof; 0 if they prove none."""
    return float(proved / scaled) if scaled > 0 and proved > 0 else 0.0


def _real_parts(rows: np.ndarray) -> np.ndarray:
    """Return (..., 2 inputs + 1) coefficients of Re(rows z) over the real parts, imaginary parts and the scale."""
    return np.concatenate([rows.real, -rows.imag, np.zeros((*rows.shape[:-1], 1))], axis=-1)


def _solve(cost: np.ndarray, matrix: np.ndarray, limits: np.ndarray, cones: list[Any]) -> Any:
    """Return Clarabel's solution of: minimise cost · x, limits − matrix x in the cones."""
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    if cost.size > LARGE:
        settings.direct_solve_method, settings.max_threads = "faer", 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = TOLERANCE
    sparse = scipy.sparse.csc_matrix
    return clarabel.DefaultSolver(sparse((cost.size, cost.size)), cost, sparse(matrix), limits, cones, settings).solve()


def least_scale_of_squares(
    wanted: np.ndarray,
    squares: Sequence[np.ndarray],
    blocks: Sequence[Block],
    actuators_scaled: bool = False,
    start: np.ndarray | None = None,
    steps: int = STEPS,
) -> LeastScale:
    """Return the least scale that a search attains where mean squares ‖R z‖ ≥ 1 are wanted too, by their factors R
    (rows, inputs) in ``squares``.

    The search starts from the relaxation, whose bound is returned, or takes some steps from a drive (inputs,), without
    a bound.
    """
    if not squares:
        return least_scale(wanted, blocks, actuators_scaled)
    if start is not None:
        return replace(_ascend(wanted, squares, blocks, actuators_scaled, start, steps), bound=0.0)
    bound, starts = _relaxed(wanted, squares, blocks, actuators_scaled)
    if all(len(factor) == 1 for factor in squares):
        in_phase = least_scale(np.vstack([wanted, *squares]), blocks, actuators_scaled)
        starts += [] if in_phase.start is None else [in_phase.start]
    ascend = partial(_ascend, wanted, squares, blocks, actuators_scaled)
    ends = sorted((ascend(start, 1) for start in starts), key=lambda end: end.scale)[:PROMISING]
    if not actuators_scaled and not (ends and math.isfinite(ends[0].scale)):
        # The drive of the least effort is within the limits if any is.
        others = [Block(block.rows, True) for block in blocks if not block.scaled]
        ends = [least_scale_of_squares(wanted, squares, others, True)]
    none = LeastScale(math.inf, bound, np.full(wanted.shape[1], np.nan), np.zeros(len(wanted)), ())
    best = min((none, *(ascend(end.drive) for end in ends if math.isfinite(end.scale))), key=lambda end: end.scale)
    return replace(best, bound=min(bound, best.scale))


def _ascend(
    wanted: np.ndarray,
    squares: Sequence[np.ndarray],
    blocks: Sequence[Block],
    actuators_scaled: bool,
    z: np.ndarray,
    steps: int = STEPS,
) -> LeastScale:
    """Return the result of convex programs that follow one another from a drive z."""
    best = LeastScale(math.inf, 0.0, z, np.zeros(len(wanted)), ())
    for _ in range(steps):
        rows = [_along(factor @ best.drive, factor) for factor in squares]
        following = least_scale(np.vstack([wanted, *rows]), blocks, actuators_scaled)
        if not following.scale < best.scale * (1 - GAIN):
            return min(following, best, key=lambda end: end.scale)  # without a drive if there is none at these phases
        best = following
    return best


def _along(image: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """Return dᴴR (inputs,) with the unit vector d along an image R z, or along the strongest row where that is 0."""
    size = float(np.linalg.norm(image))
    return np.asarray(image.conj() @ factor / size if size > 0 else factor[np.linalg.norm(factor, axis=1).argmax()])


def _relaxed(
    wanted: np.ndarray, squares: Sequence[np.ndarray], blocks: Sequence[Block], actuators_scaled: bool
) -> tuple[float, list[np.ndarray]]:
    """Return the bound of the relaxation, and drives to start a search from.

    What is left of S(y) ⪰ 0 by rounding is absorbed by the multipliers of the limits.
    """
    inputs, count = wanted.shape[1], len(wanted)
    unit, scale_unit, rows, every = _normalised(np.vstack([wanted, *squares]), blocks, actuators_scaled)
    limited = [(rows, block.scaled) for block in every for rows in block.rows]
    forms = make_forms(rows[:count], [unit * factor for factor in squares], limited)
    multipliers, products = best_multipliers(forms)
    rounding = ROUNDING * float(forms.sums((np.abs(forms.rows) ** 2).sum(axis=1)) @ multipliers)
    missing = max(0.0, rounding - float(np.linalg.eigvalsh(forms.slack(multipliers))[0]))
    multipliers[-1] += missing
    bound, least = 0.0, count + len(squares)
    for absorbing in (slice(least, least + inputs), slice(least, -1)):  # limits of actuators alone, or all
        added = np.zeros(len(multipliers))
        added[absorbing] = 1.0
        least_added = float(np.linalg.eigvalsh(forms.slack(added)[:-1, :-1])[0])
        if least_added > 0:
            raised = multipliers + missing / least_added * added
            bound = max(bound, _bound(float(forms.gains @ raised), float(raised[forms.scaled].sum())))
    if bound > LARGEST:
        return scale_unit * math.sqrt(bound), []
    values, vectors = np.linalg.eigh(products[:-1, :-1])
    scaled_vectors = (vectors * np.sqrt(np.maximum(values, 0))).T[::-1]
    parts = [products[:-1, -1], *scaled_vectors[:2], scaled_vectors.sum(axis=0)]
    mixed = np.random.default_rng(0).normal(size=(2, DRAWN, len(values)))
    drawn = (mixed[0] + 1j * mixed[1]) @ scaled_vectors
    parts += _best_of(drawn, rows[:count], [unit * factor for factor in squares], every)
    return scale_unit * math.sqrt(bound), [unit * part for part in parts if np.abs(part).any()]


def _best_of(
    drives: np.ndarray, wanted: np.ndarray, squares: Sequence[np.ndarray], blocks: Sequence[Block]
) -> list[np.ndarray]:
    """Return the ``BEST`` of drives (drives, inputs) by the scale of a normalised program at their own phases."""
    rotated = drives * np.exp(-1j * np.angle((drives @ wanted.T).sum(axis=1)))[:, None]
    levels = [(rotated @ wanted.T).real.min(axis=1, initial=math.inf)]
    levels += [np.linalg.norm(drives @ factor.T, axis=1) for factor in squares]
    level = np.maximum(np.min(levels, axis=0), 1e-300)

    def sizes(scaled: bool) -> np.ndarray:
        images = (np.einsum("bri,di->dbr", block.rows, drives) for block in blocks if block.scaled == scaled)
        norms = [np.linalg.norm(image, axis=2).max(axis=1, initial=0.0) for image in images]
        return np.max([np.zeros(len(drives)), *norms], axis=0) / level

    return list(rotated[np.lexsort((sizes(True), np.maximum(sizes(False), 1.0)))[:BEST]])

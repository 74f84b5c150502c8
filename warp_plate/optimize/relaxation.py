"""Bounds of quadratic programs of drives by a semidefinite relaxation, from products of rows alone.

A drive z (inputs,) is to keep Re(g z) ≥ 1, ‖R z‖² ≥ 1 and ‖G z‖² ≤ σ or 1 with the least σ. With W ⪰ 0 in place of
w wᴴ, w = (z, 1), each of these is linear in W, as Re(g z) = (|g z + 1|² − |g z − 1|²)/4. Its matrix is A = Σ ± uᴴ u
over a few rows u. All multipliers y ≥ 0 whose S(y) = Σ y_i A_i is positive semidefinite and whose sum over the limits σ
is 1 prove Σ_wanted y − Σ_others y ≤ σ. A primal-dual method finds the best of them, along the direction HKM with a
predictor and a corrector (C. Helmberg et al., SIAM J. Optim. 6, 1996, pp. 342-361; S. Mehrotra, SIAM J. Optim. 2,
1992, pp. 575-601). Its equations have the entries tr(A_i W A_j S⁻¹), which are sums of products of u W vᴴ and u S⁻¹ vᴴ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

# The method ends when the duality gap is below GAP of the bound, or of LEAST, and W violates nothing by more than
# VIOLATION; when the bound is above LARGEST; or after MOST_STEPS, fewer where rounding stops it.
GAP, LEAST, VIOLATION, LARGEST, MOST_STEPS = 1e-9, 1e-12, 1e-7, 1e12, 60
REFINEMENTS = 3  # solutions of an equation, each for what rounding left of the last
BACK = 0.98  # part of the way to the boundary that a step takes
ROUNDING = 64 * np.finfo(float).eps  # relative error of an eigenvalue of S


@dataclass(frozen=True)
class RowForms:
    """Matrices A_i = Σ sign uᴴ u (size, size), each by its own rows u, and what they limit."""

    rows: np.ndarray  # (rows, size) u of all matrices, one after another
    signs: np.ndarray  # (rows,) their signs, of wanted ones reversed
    starts: np.ndarray  # (forms,) first row of each matrix
    gains: np.ndarray  # (forms,) 1 of wanted ones, −1 of limits, 0 of limits σ
    scaled: np.ndarray  # (forms,) true for limits σ

    def slack(self, y: np.ndarray) -> np.ndarray:
        """Return S(y), shape (size, size)."""
        weights = np.repeat(y, np.diff(np.append(self.starts, len(self.rows)))) * self.signs
        return np.asarray(self.rows.conj().T @ (weights[:, None] * self.rows))

    def of(self, matrix: np.ndarray) -> np.ndarray:
        """Return tr(A_i M), (forms,), of a Hermitian matrix M (size, size)."""
        values = ((self.rows @ matrix) * self.rows.conj()).sum(axis=1).real
        return self.sums(self.signs * values)

    def sums(self, values: np.ndarray, axis: int = 0) -> np.ndarray:
        """Return the sums of values of rows over those of each matrix, along an axis."""
        return np.asarray(np.add.reduceat(values, self.starts, axis=axis))


def make_forms(
    wanted: np.ndarray, squares: Sequence[np.ndarray], limits: Sequence[tuple[np.ndarray, bool]]
) -> RowForms:
    """Return the matrices of wanted rows g (wanted, inputs), of wanted squares by R (rows, inputs) and of limited ones
    by G (rows, inputs), each with whether σ limits it."""
    sizes = np.sqrt(np.maximum(np.linalg.norm(wanted, axis=1), 1e-300))[:, None]
    pairs = [np.concatenate([wanted / sizes, sign * sizes], axis=1) / 2 for sign in (1, -1)]
    linear = np.stack(pairs, axis=1).reshape(-1, wanted.shape[1] + 1)
    one = np.append(np.zeros(wanted.shape[1]), 1.0)[None]
    others = [np.pad(rows, ((0, 0), (0, 1))) for rows in (*squares, *(rows for rows, _ in limits))]
    counts = np.array([*(2 for _ in wanted), *map(len, others), 1])
    scaled = np.array([*(False for _ in (*wanted, *squares)), *(scaled for _, scaled in limits), False])
    gains, least = np.where(scaled, 0.0, -1.0), len(wanted) + len(squares)
    gains[:least] = 1.0
    signs = np.repeat(np.where(gains > 0, -1.0, 1.0), counts)
    signs[1 : 2 * len(wanted) : 2] = 1.0
    starts = np.cumsum(counts) - counts
    return RowForms(np.concatenate([linear, *others, one]), signs, starts, gains, scaled)


@dataclass(frozen=True)
class _Point:
    """Iterate of the method, or a change of it."""

    y: np.ndarray  # (forms,) multipliers
    matrix: np.ndarray  # (size, size) W
    room: np.ndarray  # (forms,) by how much W keeps each requirement

    def moved(self, change: _Point, dual: float, primal: float) -> _Point:
        """Return the point after parts of a change of its multipliers, and of the others."""
        matrix, room = self.matrix + primal * change.matrix, self.room + primal * change.room
        return _Point(self.y + dual * change.y, matrix, room)

    def gap(self, forms: RowForms) -> float:
        """Return tr(W S) + room · y."""
        return float(forms.of(self.matrix) @ self.y + self.room @ self.y)


def best_multipliers(forms: RowForms) -> tuple[np.ndarray, np.ndarray]:
    """Return the multipliers (forms,) of the largest bound, with S(y) ⪰ 0 up to rounding, and W (size, size)."""
    size, wanted = forms.rows.shape[1], forms.gains > 0
    y = np.where(forms.scaled, 1 / np.count_nonzero(forms.scaled), 1.0)
    y[wanted] = 0.0
    y[wanted] = float(np.linalg.eigvalsh(forms.slack(y))[0]) / (4 * np.abs(forms.rows) ** 2).sum()
    point, best = _Point(y, np.eye(size, dtype=complex), np.ones(len(y))), y
    for _ in range(MOST_STEPS):
        gap, bound = point.gap(forms), float(forms.gains @ point.y)
        kept = forms.of(point.matrix) + forms.gains + point.room
        off = kept - kept[forms.scaled].mean() * forms.scaled
        converged = gap < GAP * max(abs(bound), LEAST) and np.abs(off).max() < VIOLATION * max(1.0, np.abs(kept).max())
        following = None if converged or bound > LARGEST else _step(forms, point, gap / (size + len(y)))
        if following is None:
            break
        point = following
        best = max(best, point.y, key=lambda y: float(forms.gains @ y))
    return best, point.matrix


def _step(forms: RowForms, point: _Point, mu: float) -> _Point | None:
    """Return the next point from one whose gap is ``mu`` for each multiplier and row of W; None if rounding prevents
    it."""
    y, scaled = point.y, forms.scaled.astype(float)
    try:
        roots = [np.linalg.inv(np.linalg.cholesky(matrix)) for matrix in (forms.slack(y), point.matrix)]
        inverse = roots[0].conj().T @ roots[0]
        products = [forms.rows @ matrix @ forms.rows.conj().T for matrix in (point.matrix, inverse)]
        signed = (products[0] * products[1].conj()).real * np.outer(forms.signs, forms.signs)
        curvature = forms.sums(forms.sums(signed), axis=1) + np.diag(point.room / y)
        unit = 1 / np.sqrt(np.maximum(np.diag(curvature), 1e-300))
        factor = scipy.linalg.cho_factor(curvature * np.outer(unit, unit))
    except (np.linalg.LinAlgError, ValueError):
        return None

    def towards(target: float, second: _Point) -> _Point:
        """Return the change that leads to W S = target·1 and room·y = target, with terms of second order."""
        right = forms.gains + target * (forms.of(inverse) + 1 / y) - forms.of(second.matrix) - second.room / y
        along, change, sigma = unit * scipy.linalg.cho_solve(factor, unit * scaled), 0 * y, 0.0
        for _ in range(REFINEMENTS):
            down = unit * scipy.linalg.cho_solve(factor, unit * (right - curvature @ change - sigma * scaled))
            more = (scaled @ (change + down)) / (scaled @ along)
            change, sigma = change + down - along * more, sigma + more
        matrix = target * inverse - point.matrix - _hermitian(point.matrix @ forms.slack(change) @ inverse)
        room = (target - second.room - point.room * change) / y - point.room
        return _Point(change, matrix - second.matrix, room)

    def lengths(change: _Point) -> tuple[float, float]:
        """Return the parts of a change that keep the multipliers and S, and W and the room, positive."""
        dual = _longest(roots[0], forms.slack(change.y), change.y / y)
        return dual, _longest(roots[1], change.matrix, change.room / point.room)

    zero = _Point(0 * y, 0 * point.matrix, 0 * y)
    predicted = towards(0.0, zero)
    reached = point.moved(predicted, *lengths(predicted)).gap(forms) / (mu * (len(y) + len(inverse)))
    second = _hermitian(predicted.matrix @ forms.slack(predicted.y) @ inverse)
    corrector = _Point(zero.y, second, predicted.room * predicted.y)
    change = towards(mu * min(1.0, max(reached, 0.0)) ** 3, corrector)
    dual, primal = lengths(change)
    return point.moved(change, dual, primal) if max(dual, primal) > ROUNDING else None


def _hermitian(matrix: np.ndarray) -> np.ndarray:
    return (matrix + matrix.conj().T) / 2


def _longest(root: np.ndarray, change: np.ndarray, ratios: np.ndarray) -> float:
    """Return the part of a change of a matrix, whose inverse has the root, and of numbers, by their ratios to these,
    that keeps both positive; at most 1."""
    least = min(float(np.linalg.eigvalsh(root @ change @ root.conj().T)[0]), float(ratios.min()))
    return min(1.0, BACK / -least) if least < 0 else 1.0

"""A primal-dual method for second-order cone programs with full matrices of rows.

The program is: minimise c x where s = h − G x is in a product of half-lines and cones s₀ ≥ ‖s₁‖. With the scaling W of
Nesterov and Todd, W z = W⁻¹ s, each step solves Gᵀ W⁻² G dx = r, in two right sides: a predictor and a corrector
(L. Vandenberghe, The CVXOPT linear and quadratic cone program solvers, 2010). Sparse solvers take longer for rows that
are full.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

# The method ends where relative gap and residuals are below ENDED, or after MOST_STEPS, fewer where rounding stops it;
# ENOUGH is good enough then.
ENDED, ENOUGH, MOST_STEPS, SHORTEST = 1e-10, 1e-8, 60, 1e-6
# Part of the way to the boundary that a step takes, solutions for what rounding left of the last, and what is added to
# the diagonal of a matrix of ones there.
BACK, REFINEMENTS, REGULAR = 0.99, 2, 1e-14
Cones = Sequence[tuple[int, int]]  # numbers and dimensions of cones, those of one dimension for half-lines


@dataclass
class _Cones:
    """Vectors of a product of cones, and the scaling at a pair of them."""

    cones: Cones

    def split(self, vector: np.ndarray) -> list[np.ndarray]:
        """Return the parts (count, dimension, ...) of a vector or matrix (rows, ...)."""
        ends = np.cumsum([count * dimension for count, dimension in self.cones])[:-1]
        parts = zip(np.split(vector, ends), self.cones, strict=True)
        return [part.reshape(*cone, *vector.shape[1:]) for part, cone in parts]

    def joined(self, function: Callable[..., np.ndarray], *vectors: np.ndarray) -> np.ndarray:
        """Return a function of the parts of vectors as one vector."""
        parts = zip(*map(self.split, vectors), strict=True)
        return np.concatenate([function(*part).reshape(-1, *vectors[-1].shape[1:]) for part in parts])

    @cached_property
    def unit(self) -> np.ndarray:
        """The unit (rows,) of the product: 1 for each cone."""
        return self.joined(_unit_like, np.zeros(sum(count * dimension for count, dimension in self.cones)))

    def least(self, vector: np.ndarray) -> float:
        """Return how far a vector is inside: the least s₀ − ‖s₁‖."""
        return min(float((part[:, 0] - np.linalg.norm(part[:, 1:], axis=1)).min()) for part in self.split(vector))

    def longest(self, vector: np.ndarray, change: np.ndarray) -> float:
        """Return the largest multiple of a change, at most 1, that a vector takes within the cones."""
        pairs = zip(self.split(vector), self.split(change), strict=True)
        length = min(1.0, BACK * min(float(_lengths(*pair).min()) for pair in pairs))
        while length > SHORTEST and not self.least(vector + length * change) > 0:  # by rounding
            length *= BACK
        return length


def _unit_like(part: np.ndarray) -> np.ndarray:
    unit = np.zeros(part.shape)
    unit[:, 0] = 1.0
    return unit


def _square(part: np.ndarray) -> np.ndarray:
    """Return s₀² − ‖s₁‖² (count,)."""
    norm = np.linalg.norm(part[:, 1:], axis=1)
    return np.asarray((part[:, 0] - norm) * (part[:, 0] + norm))


def _lengths(part: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Return the multiples (count,) of changes at which vectors reach the boundary of their cones."""
    a, c = _square(change), _square(part)
    b = part[:, 0] * change[:, 0] - (part[:, 1:] * change[:, 1:]).sum(axis=1)
    root = np.sqrt(np.maximum(b**2 - a * c, 0.0))
    above, below = np.where(b > 0, b + root, c), np.where(b > 0, -a, root - b)
    crosses = (b**2 >= a * c * (1 - 1e-9)) & (below > 0)  # also of one dimension, where both are equal
    return np.where(crosses, above / np.where(crosses, below, 1.0), np.inf)


def _product(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the Jordan products of vectors (count, dimension)."""
    rest = first[:, :1] * second[:, 1:] + second[:, :1] * first[:, 1:]
    return np.concatenate([(first * second).sum(axis=1)[:, None], rest], axis=1)


def _quotient(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the x (count, dimension) whose products with the first vectors are the second ones."""
    inner = first[:, 0] * second[:, 0] - (first[:, 1:] * second[:, 1:]).sum(axis=1)
    head = (inner / _square(first))[:, None]
    return np.concatenate([head, (second[:, 1:] - head * first[:, 1:]) / first[:, :1]], axis=1)


def _scaling(s: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the scaling's w (count, dimension) and β (count,) at vectors."""
    roots = [np.sqrt(_square(part)) for part in (s, z)]
    s, z = s / roots[0][:, None], z / roots[1][:, None]
    mean = np.sqrt((1 + (s * z).sum(axis=1)) / 2)[:, None]
    return (s + z * np.where(np.arange(s.shape[1]) == 0, 1, -1)) / (2 * mean), np.sqrt(roots[0] / roots[1])


def _scaled(w: np.ndarray, scale: np.ndarray, sign: float, part: np.ndarray) -> np.ndarray:
    """Return W x, or W⁻¹ x for a negative sign, for vectors or matrices (count, dimension, ...)."""
    wide = (slice(None), slice(None), *[None] * (part.ndim - 2))
    head, tail, w0, w1 = part[:, :1], part[:, 1:], w[:, :1][wide], sign * w[:, 1:][wide]
    inner = (w1 * tail).sum(axis=1, keepdims=True)
    result = np.concatenate([w0 * head + inner, w1 * head + tail + w1 * (inner / (1 + w0))], axis=1)
    return np.asarray(result * (scale**sign)[:, None][wide])


def solve_cones(
    cost: np.ndarray, matrix: np.ndarray, limits: np.ndarray, cones: Cones
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the solution x (unknowns,) and the multipliers (rows,); None where the method does not find them, as where
    there is no solution.

    Args:
        cost: (unknowns,) c.
        matrix: (rows, unknowns) G.
        limits: (rows,) h.
        cones: Cones of the rows, one after another.
    """
    parts, degree = _Cones(cones), sum(count for count, _ in cones)
    size, entry = max(1.0, float(np.linalg.norm(cost))), max(1.0, float(np.abs(limits).max()))
    least, best = ENOUGH, None
    try:
        factor = scipy.linalg.cho_factor(matrix.T @ matrix)
        x = scipy.linalg.cho_solve(factor, matrix.T @ limits)
        s, z = limits - matrix @ x, -matrix @ scipy.linalg.cho_solve(factor, cost)
        s, z = (part + max(0.0, 1 - parts.least(part)) * parts.unit for part in (s, z))
        for _ in range(MOST_STEPS):
            dual, primal, gap = cost + matrix.T @ z, matrix @ x + s - limits, float(s @ z)
            left = max(gap / max(abs(float(cost @ x)), 1e-12), float(np.linalg.norm(dual)) / size)
            left = max(left, float(np.abs(primal).max()) / entry)
            if best is not None and left > least:
                break
            if left < least:
                least, best = left, (x, z)
            if left < ENDED:
                break
            with np.errstate(divide="ignore", invalid="ignore"):
                (dx, ds, dz), along, across = _step(parts, matrix, s, z, (dual, primal), gap / degree)
            if not min(along, across) > SHORTEST:
                break
            x, s, z = x + along * dx, s + along * ds, z + across * dz
    except (np.linalg.LinAlgError, ValueError):  # at the boundary, up to rounding
        pass
    return best


def _step(
    parts: _Cones,
    matrix: np.ndarray,
    s: np.ndarray,
    z: np.ndarray,
    residuals: tuple[np.ndarray, np.ndarray],
    mu: float,
) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], float, float]:
    """Return the changes of x, s and z, and their lengths."""
    scalings = [_scaling(*pair) for pair in zip(parts.split(s), parts.split(z), strict=True)]

    def scaled(vector: np.ndarray, sign: float) -> np.ndarray:
        pairs = zip(scalings, parts.split(vector), strict=True)
        return np.concatenate([_scaled(*one, sign, part).reshape(-1, *vector.shape[1:]) for one, part in pairs])

    middle, rows = scaled(z, 1.0), scaled(matrix, -1.0)
    normal = rows.T @ rows
    unit = 1 / np.sqrt(np.diag(normal))
    factor = scipy.linalg.cho_factor(normal * np.outer(unit, unit) + REGULAR * np.eye(len(unit)))

    def change(second: np.ndarray, part: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the changes that remove a part of the residuals, with terms of second order."""
        quotient = parts.joined(_quotient, middle, second)
        right = scaled(part * residuals[1], -1.0) - quotient
        dx, inner = np.zeros(matrix.shape[1]), right
        for _ in range(REFINEMENTS):
            dx = dx + unit * scipy.linalg.cho_solve(factor, -unit * (part * residuals[0] + rows.T @ inner))
            inner = rows @ dx + right
        return dx, scaled(-quotient - inner, 1.0), scaled(inner, -1.0)

    square = parts.joined(_product, middle, middle)
    _, ds, dz = change(square, 1.0)
    reached = min(parts.longest(s, ds), parts.longest(z, dz))
    centring = (1 - reached) ** 3
    cross = parts.joined(_product, scaled(ds, -1.0), scaled(dz, 1.0))
    changes = change(square + cross - centring * mu * parts.unit, 1 - centring)
    return changes, parts.longest(s, changes[1]), parts.longest(z, changes[2])

"""A local maximum of a quadratic form, or of the ratio of two, under quadratic limits.

A semidefinite relaxation points at drives that may be a little off, or violate a limit where it is not tight. From
there SLSQP leads to a drive that keeps all limits (D. Kraft, DFVLR-FB 88-28, 1988; J. Nocedal and S. Wright, Numerical
Optimization, 2006, section 18).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

# A limit xᵀ matrix x + entry ≤ 0, or = 0: matrix, entry, whether it is an equation.
Limit = tuple[np.ndarray, float, bool]
MOST_STEPS, TOLERANCE = 100, 1e-13


def local_maximum(
    numerator: np.ndarray, denominator: np.ndarray | None, limits: Sequence[Limit], least: np.ndarray, start: np.ndarray
) -> np.ndarray:
    """Return the x (n,) to which an ascent from ``start`` leads, up to rounding within the limits and above ``least``.

    The maximised value is xᵀ numerator x, divided by xᵀ denominator x if there is one; matrices are (n, n).
    """
    x = start * _scale(limits, start)
    size = float(np.linalg.norm(x))
    below = 1.0 if denominator is None else float(x @ denominator @ x)
    typical = float(x @ numerator @ x) / below if below > 0 else 0.0
    if not (size > 0 and 0 < typical < np.inf):
        return start
    top = numerator * (size**2 / typical)
    bottom = None if denominator is None else denominator * size**2

    def fall(y: np.ndarray) -> tuple[float, np.ndarray]:
        slope, above = 2 * top @ y, float(y @ top @ y)
        if bottom is None:
            return -above, -slope
        below = max(float(y @ bottom @ y), 1e-300)
        return -above / below, -(slope - above / below * 2 * bottom @ y) / below

    result = scipy.optimize.minimize(
        fall,
        x / size,
        jac=True,
        method="SLSQP",
        bounds=scipy.optimize.Bounds(least / size),
        constraints=_constraints(limits, size),
        options={"maxiter": MOST_STEPS, "ftol": TOLERANCE},
    )
    return np.asarray(result.x * size) if np.isfinite(result.x).all() else start


def _scale(limits: Sequence[Limit], x: np.ndarray) -> float:
    """Return the largest factor on x (n,) with which no limit from above is passed; 1 if there is none."""
    ratios = [-entry / form for matrix, entry, _ in limits if entry < 0 and (form := float(x @ matrix @ x)) > 0]
    return float(np.sqrt(min(ratios, default=1.0)))


def _constraints(limits: Sequence[Limit], size: float) -> list[dict[str, object]]:
    """Return the limits as SLSQP takes them, equations first, of x / size and in units of their own size."""
    constraints: list[dict[str, object]] = []
    for kind in ("eq", "ineq"):
        chosen = [(matrix * size**2, entry) for matrix, entry, equation in limits if equation == (kind == "eq")]
        if not chosen:
            continue
        units = np.array([abs(entry) or float(np.abs(matrix).max()) or 1.0 for matrix, entry in chosen])
        matrices = np.array([matrix for matrix, _ in chosen]) / units[:, None, None]
        entries = np.array([entry for _, entry in chosen]) / units
        constraints.append(
            {
                "type": kind,
                "fun": lambda y, matrices=matrices, entries=entries: -(matrices @ y @ y + entries),
                "jac": lambda y, matrices=matrices: -2 * matrices @ y,
            }
        )
    return constraints

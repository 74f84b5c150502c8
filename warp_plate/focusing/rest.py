"""The optimum of all waveforms of one energy that keep the rest of the plate quiet at the moment of the focus.

With amplitudes a = B w of the modes at the moment and G the matrix of the mean square over the rest, it solves

    max g·w   under   |w|² ≤ E,   aᵀ G a ≤ r² (g·w)²,

a convex problem, for the second bound is a cone. Its solution is a multiple of w = (1 + μ BᵀGB)⁻¹ g with a multiplier
μ ≥ 0 of that bound, which is 0 if time reversal, w = g, keeps it. With G = S² and S B Bᵀ S = V diag(k) Vᵀ,
c = Vᵀ S B g, motion and rest are sums over k,

    g·w = g·g − Σ μ c² / (1 + μ k),   aᵀ G a = Σ c² / (1 + μ k)²,

whose ratio falls as μ grows.
"""

from __future__ import annotations

import math

import numpy as np
import scipy

from warp_plate.focusing.responses import HeldResponses
from warp_plate.scene.focus import Focus
from warp_plate.scene.target import Target

# Range of μ in units of 1 / max k, and halvings of its logarithm.
RANGE, HALVINGS = 1e10, 100


def quiet_optimum(responses: HeldResponses, table: Focus, gains: np.ndarray) -> tuple[np.ndarray, list[bool]]:
    """Return the waveforms (foci, actuators, samples), of no certain size, and whether each attains the bound.

    Where no waveforms keep the bound, those of the least motion of the rest over that of the focus, nearly.
    """
    assert table.rest is not None
    samples, ratio = gains.shape[-1], 10 ** (-table.rest.contrast / 20)
    moved, gram = responses.end_motions(samples, gains)
    best, attained, combined = [], [], []
    for gain, motion, point in zip(gains, moved, table.points, strict=True):
        root = _root_mean_square(responses, (*point, table.rest.radius))
        values, vectors = scipy.linalg.eigh(root @ gram @ root)
        values, parts = np.maximum(values, 0), vectors.T @ (root @ motion)
        multiplier, holds = _multiplier(values, parts, float((gain**2).sum()), ratio)
        attained.append(holds)
        combined.append(root @ (vectors @ (multiplier * parts / (1 + multiplier * values))))
    best = gains - responses.reversed_motions(np.array(combined), samples)
    return best, attained


def _multiplier(values: np.ndarray, parts: np.ndarray, square: float, ratio: float) -> tuple[float, bool]:
    """Return the smallest μ that keeps the bound and whether it is attained, 0 and False if it need not be."""

    def excess(multiplier: float) -> float:
        share = 1 / (1 + multiplier * values)
        return float(np.linalg.norm(parts * share) - ratio * (square - (multiplier * parts**2 * share).sum()))

    if excess(0.0) <= 0:
        return 0.0, False
    low, high = 1 / RANGE / values.max(), RANGE / values.max()
    if excess(high) > 0:
        return high, False
    for _ in range(HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if excess(middle) > 0 else (low, middle)
    return high, True


def _root_mean_square(responses: HeldResponses, disc: tuple[float, float, float]) -> np.ndarray:
    """Return the root S of the matrix of the mean square, by mass, outside a disc x, y, radius [m]."""
    plate = responses.plate
    width, height = plate.scene.plate.size
    inside = plate.kinetic_matrix(Target(disc=disc), (0.0, width, 0.0, height))
    outside, total = plate.kinetic_matrix() - inside, plate.space.plate_mass
    mass = total * (1 - math.pi * disc[2] ** 2 / (width * height))
    squares, vectors = scipy.linalg.eigh(outside)
    return np.asarray((vectors * np.sqrt(np.maximum(squares, 0) / mass)) @ vectors.T)

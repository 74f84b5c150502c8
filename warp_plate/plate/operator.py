"""The biharmonic as two passes of one-dimensional taps: curvature from displacement, force from curvature.

    curvature = (Bx ⊗ I + I ⊗ By) u,   ∇⁴u ≈ (Bxᵀ ⊗ I + I ⊗ Byᵀ) curvature / spacing⁴

B is a second difference from the nodes that move to all nodes, the two edge nodes included. That the second pass is
the transposed of the first makes the operator symmetric and never negative, whatever holds the edges: its spectrum is
real, and a lossless plate cannot grow below the stability limit.

Fourth order. Inside, 12·h²·u_xx = −u₋₂ + 16u₋₁ − 30u₀ + 16u₁ − u₂. A supported edge continues u and the curvature as
odd functions. At a clamped edge, where u = x²(…), the rows of nodes 0 and 1 are

    B₀ = (p, q) on nodes 1, 2,      B₁ = (r, s, −1/12) on nodes 1, 2, 3      [× 1/h²]

found from the weak form: the sums over nodes of (Bu)(Bv) and of (Bu)v must equal ∫u''v'' and ∫u''v up to h⁴ for all
smooth u and v. By the Euler-Maclaurin formula of functions x^a, x^b that is one equation for each of
(a, b) = (2, 2), (2, 3), (2, 4), (3, 3) in the first sum, and for (2, 2) in the second:

    β₂² + γ₂² = 6,   β₂β₃ + γ₂γ₃ = 13,   β₂β₄ + γ₂γ₄ = 24,   β₃² + γ₃² = 36,   γ₂ = 2,

β_k = p + 2^k q and γ_k = r + 2^k s − 3^k/12 being what B₀ and B₁ make of x^k. (The edge node counts half in an
integral, so that β₂ = √2 where u'' = 2.) Errors then fall as h⁴.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy

from warp_plate.effects.edges import Edges

# By order: the taps inside, from order/2 nodes to one side to as many to the other; their divisor; and the fewest nodes
# on which the closures of two edges keep apart.
INSIDE = {2: (1.0, -2.0, 1.0), 4: (-1.0, 16.0, -30.0, 16.0, -1.0)}
DIVISOR = {2: 1.0, 4: 12.0}
FEWEST_NODES = {2: 5, 4: 9}
# The largest eigenvalue of −h²·(second difference): the end of the spectrum of the periodic plate.
LARGEST = {2: 4.0, 4: 16.0 / 3.0}


def clamped_rows() -> tuple[tuple[float, float], tuple[float, float, float]]:
    """Return (p, q) and (r, s, −1/12), the fourth-order rows of nodes 0 and 1 of a clamped edge."""
    third = (13 * math.sqrt(2) - 2 * math.sqrt(47)) / 6  # β₃; β₂ = √2
    q = (third - math.sqrt(2)) / 4
    p = math.sqrt(2) - 4 * q
    s = ((13 - math.sqrt(2) * third) / 2 - 0.5) / 4
    r = 2.75 - 4 * s
    return (p, q), (r, s, -1 / 12)


@dataclass(frozen=True)
class Taps:
    """Weights of each node's neighbours in both passes along one axis, in units of spacing² / DIVISOR.

    Neighbours go from −reach to reach = order/2; those beyond the edges have weight zero.
    """

    bend: np.ndarray  # (nodes, 2·reach + 1) weights of displacements in the curvature
    # (nodes, 2·reach + 1) weights of curvatures in the force; zero for the edge nodes, which do not move
    move: np.ndarray

    @property
    def factors(self) -> np.ndarray:
        """(nodes,) factors that make ``bend`` of the taps inside, with zeros beyond the edges; second order only."""
        factors = np.ones(len(self.bend))
        factors[0], factors[-1] = self.bend[0, -1], self.bend[-1, 0]
        return factors


def make_taps(nodes: int, low: object, high: object, order: int) -> Taps:
    """Return the taps along an axis of ``nodes`` nodes between edges that are "clamped", otherwise supported."""
    reach = order // 2
    bend = np.tile(INSIDE[order], (nodes, 1))
    _close(bend, low, order)
    _close(bend[::-1, ::-1], high, order)
    move = np.zeros_like(bend)
    for offset in range(-reach, reach + 1):
        taker = np.arange(max(0, -offset), min(nodes, nodes - offset))
        move[taker, reach + offset] = bend[taker + offset, reach - offset]
    move[[0, -1]] = 0
    if order == 2:
        # Edge nodes count half; that factor goes into the first pass, which leaves the second plain.
        bend[[0, -1]] *= 2
        move[1, 0] = move[-2, -1] = 1
    return Taps(bend, move)


def plain_taps(edges: Edges, nodes: tuple[int, int], order: int) -> tuple[Taps, Taps]:
    """Return the taps along x and y of a plain plate."""
    along_x, along_y = (edges.left, edges.right), (edges.bottom, edges.top)
    return make_taps(nodes[0], *along_x, order), make_taps(nodes[1], *along_y, order)


def _close(bend: np.ndarray, edge: object, order: int) -> None:
    """Write the rows of the first pass next to the edge at its low end."""
    reach = order // 2
    bend[0] = 0
    if order == 2:
        bend[0, 2] = edge == "clamped"  # half of the 2u₁ that the mirror node makes
        return
    bend[1, 0] = 0  # beyond the edge
    if edge == "clamped":
        first, second = clamped_rows()
        bend[0, reach + 1 :] = np.multiply(first, DIVISOR[order])
        bend[1, reach - 1] = 0  # the edge node, which rests
        bend[1, reach:] = np.multiply(second, DIVISOR[order])
    else:
        bend[1, reach] += 1  # u₋₁ = −u₁


def biharmonic(taps_x: Taps, taps_y: Taps, spacing: tuple[float, float], order: int) -> scipy.sparse.csc_array:
    """Return the symmetric matrix of ∇⁴ [1/m⁴] of a plain plate on its inner nodes, row by row."""
    nx, ny, aspect = len(taps_x.bend), len(taps_y.bend), (spacing[0] / spacing[1]) ** 2
    identity_x, identity_y = scipy.sparse.eye_array(nx), scipy.sparse.eye_array(ny)
    kept = np.add.outer(nx * np.arange(1, ny - 1), np.arange(1, nx - 1)).ravel()

    def laplacian(along_x: np.ndarray, along_y: np.ndarray) -> scipy.sparse.csr_array:
        second_x = scipy.sparse.kron(identity_y, _banded(along_x))
        return scipy.sparse.csr_array(second_x + aspect * scipy.sparse.kron(_banded(along_y), identity_x))

    matrix = laplacian(taps_x.move, taps_y.move) @ laplacian(taps_x.bend, taps_y.bend)
    return scipy.sparse.csc_array(matrix[kept][:, kept] / (DIVISOR[order] * spacing[0] ** 2) ** 2)


def _banded(bands: np.ndarray) -> scipy.sparse.dia_array:
    """Return the square matrix of bands (nodes, 2·reach + 1), a row for each node."""
    nodes, width = bands.shape
    reach = width // 2
    diagonals = [bands[max(0, -k) : nodes - max(0, k), k + reach] for k in range(-reach, reach + 1)]
    return scipy.sparse.diags_array(diagonals, offsets=list(range(-reach, reach + 1)), shape=(nodes, nodes))

"""Natural frequencies of the plate as the differences have it."""

from __future__ import annotations

import math

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import eigsh

from warp_plate.plate.operator import DIVISOR
from warp_plate.plate.scheme import make_scheme
from warp_plate.scene.model import Scene


def biharmonic(scene: Scene) -> sparse.csc_matrix:
    """Square sparse matrix of ∇⁴ [1/m⁴] on the nodes that move, row by row; symmetric.

    Raises:
        SceneError: see ``make_scheme``.
    """
    scheme = make_scheme(scene)
    nx, ny = scheme.nodes
    one_x, one_y = sparse.identity(nx), sparse.identity(ny)

    def twice(along_x: np.ndarray, along_y: np.ndarray) -> sparse.csr_matrix:
        first = sparse.kron(one_y, _matrix(along_x))
        return (first + scheme.aspect * sparse.kron(_matrix(along_y), one_x)).tocsr()

    bend = twice(scheme.taps_x.bend, scheme.taps_y.bend)
    move = twice(scheme.taps_x.move, scheme.taps_y.move)
    inner = np.zeros((ny, nx), dtype=bool)
    inner[1:-1, 1:-1] = True
    kept = np.flatnonzero(inner)
    whole = (move @ bend)[kept][:, kept] / (DIVISOR[scheme.order] * scheme.spacing[0] ** 2) ** 2
    return whole.tocsc()


def natural_frequencies(scene: Scene, count: int) -> np.ndarray:
    """(count,) first natural frequencies [Hz] of the scene's grid, continuous in time.

    Raises:
        SceneError: see ``make_scheme``.
    """
    scheme = make_scheme(scene)
    matrix = biharmonic(scene)
    count = min(count, matrix.shape[0] - 2)
    values = eigsh(matrix, count, sigma=0, which="LM", return_eigenvectors=False)
    frequencies: np.ndarray = np.sort(scheme.kappa * np.sqrt(np.maximum(values, 0))) / (2 * math.pi)
    return frequencies


def _matrix(bands: np.ndarray) -> sparse.dia_matrix:
    """Square matrix of (nodes, 2·reach + 1) bands, a row a node."""
    nodes, width = bands.shape
    reach = width // 2
    diagonals = [bands[max(0, -k) : nodes - max(0, k), k + reach] for k in range(-reach, reach + 1)]
    return sparse.diags(diagonals, range(-reach, reach + 1), shape=(nodes, nodes))

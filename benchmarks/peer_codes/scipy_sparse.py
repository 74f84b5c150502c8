"""SciPy: the biharmonic of one plate as a sparse matrix, applied to all plates at once as columns."""

from __future__ import annotations

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from peer_codes.problem import Problem, Run


def make(problem: Problem, threads: int) -> Run:
    """The state is (interior nodes, plates); SciPy works on one thread whatever `threads` says."""
    in_phase, quadrature = as_columns(problem.in_phase), as_columns(problem.quadrature)
    operator = stiffness_matrix(problem)
    weights = problem.weights[:, 1:-1, 1:-1].reshape(2, -1)

    def run() -> NDArray[np.float64]:
        u, q, squares = np.zeros_like(in_phase), np.zeros_like(in_phase), np.zeros_like(in_phase)
        work = np.empty_like(in_phase)
        for m in range(problem.steps):
            q *= problem.decay
            q -= operator @ u
            np.multiply(in_phase, problem.cosine[m], out=work)
            q += work
            np.multiply(quadrature, problem.sine[m], out=work)
            q += work
            u += q
            if m >= problem.first:
                np.multiply(q, q, out=work)
                squares += work
        return (weights @ squares).T.reshape(problem.plates, 2).astype(np.float64)

    return run


def as_columns(load: NDArray) -> NDArray:
    """(plates, nodes, nodes) as (interior nodes, plates); one plate as a vector, which is faster."""
    columns = load[:, 1:-1, 1:-1].reshape(len(load), -1).T
    return columns[:, 0].copy() if len(load) == 1 else np.ascontiguousarray(columns)


def stiffness_matrix(problem: Problem) -> scipy.sparse.csr_array:
    """stiffness x biharmonic of one clamped plate, interior nodes only, in CSR."""
    inside = problem.nodes - 2
    second = band([1, -2, 1], inside)
    fourth = band([1, -4, 6, -4, 1], inside).tolil()
    fourth[0, 0] += 1  # the ghost outside a clamped edge equals the first node inside
    fourth[inside - 1, inside - 1] += 1
    unit = scipy.sparse.eye_array(inside)
    kron = scipy.sparse.kron
    operator = kron(fourth, unit) + kron(unit, fourth) + 2 * kron(second, second)
    return scipy.sparse.csr_array(problem.stiffness * operator).astype(problem.dtype)


def band(coefficients: list[float], size: int) -> scipy.sparse.dia_array:
    """A square matrix with these numbers on and beside its diagonal."""
    reach = len(coefficients) // 2
    offsets = list(range(-reach, reach + 1))
    return scipy.sparse.diags_array(coefficients, offsets=offsets, shape=(size, size), dtype=np.float64)

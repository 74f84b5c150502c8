"""Numba: plain loops over rows, compiled by LLVM; prange shares out plates, or rows of a few large plates."""

from __future__ import annotations

import numba
import numpy as np
from numba import prange
from numpy.typing import NDArray

from peer_codes.problem import PeerMissing, Problem, Run


def make(problem: Problem, threads: int) -> Run:
    """Run on `threads` threads; raise PeerMissing if Numba was started with fewer."""
    try:
        numba.set_num_threads(threads)
    except ValueError as error:
        raise PeerMissing(f"Numba has fewer than {threads} threads") from error
    solve = share_plates if problem.plates >= threads else share_rows
    arrays = (problem.in_phase, problem.quadrature, problem.cosine, problem.sine, problem.weights)
    # typed numbers: a float literal in a kernel would turn float32 arithmetic into float64
    numbers = np.array([problem.decay, problem.stiffness, 2, 4], problem.dtype)

    def run() -> NDArray[np.float64]:
        numba.set_num_threads(threads)
        energy = np.zeros((problem.plates, 2))
        solve(*arrays, numbers, problem.first, energy)
        return energy

    return run


@numba.njit(fastmath=True, inline="always")
def laplacian_row(u, j, two, four, out):
    """Row j of the Laplacian, edge columns included; on a clamped edge it is twice the node inside."""
    below, here, above, last = u[j - 1], u[j], u[j + 1], u.shape[1] - 1
    for i in range(1, last):
        out[i] = (here[i - 1] + here[i + 1]) + (below[i] + above[i]) - four * here[i]
    out[0] = two * here[1]
    out[last] = two * here[last - 1]


@numba.njit(fastmath=True, inline="always")
def edge_rows(u, two, laplacian):
    """The Laplacian along the first and the last row."""
    last = u.shape[0] - 1
    for i in range(u.shape[1]):
        laplacian[0, i] = two * u[1, i]
        laplacian[last, i] = two * u[last - 1, i]


@numba.njit(fastmath=True, inline="always")
def update_row(laplacian, j, a, b, cosine, sine, numbers, measured, u, q, squares):
    """Take a step of row j; a, b, u, q and squares are that row."""
    below, here, above = laplacian[j - 1], laplacian[j], laplacian[j + 1]
    decay, stiffness, four = numbers[0], numbers[1], numbers[3]
    if measured:
        for i in range(1, u.size - 1):
            biharmonic = (here[i - 1] + here[i + 1]) + (below[i] + above[i]) - four * here[i]
            x = decay * q[i] - stiffness * biharmonic + (cosine * a[i] + sine * b[i])
            q[i] = x
            u[i] += x
            squares[i] += x * x
    else:
        for i in range(1, u.size - 1):
            biharmonic = (here[i - 1] + here[i + 1]) + (below[i] + above[i]) - four * here[i]
            x = decay * q[i] - stiffness * biharmonic + (cosine * a[i] + sine * b[i])
            q[i] = x
            u[i] += x


@numba.njit(fastmath=True, parallel=True)
def share_plates(in_phase, quadrature, cosine, sine, weights, numbers, first, energy):
    """A thread takes a plate through all its steps."""
    plates, nodes = in_phase.shape[0], in_phase.shape[1]
    for plate in prange(plates):
        u = np.zeros((nodes, nodes), in_phase.dtype)
        q, squares, laplacian = np.zeros_like(u), np.zeros_like(u), np.zeros_like(u)
        a, b = in_phase[plate], quadrature[plate]
        for m in range(cosine.size):
            edge_rows(u, numbers[2], laplacian)
            for j in range(1, nodes - 1):
                laplacian_row(u, j, numbers[2], numbers[3], laplacian[j])
            c, s, measured = cosine[m], sine[m], m >= first
            for j in range(1, nodes - 1):
                update_row(laplacian, j, a[j], b[j], c, s, numbers, measured, u[j], q[j], squares[j])
        for region in range(2):
            energy[plate, region] = (weights[region] * squares).sum()


@numba.njit(fastmath=True, parallel=True)
def share_rows(in_phase, quadrature, cosine, sine, weights, numbers, first, energy):
    """Run one plate after another, its rows over the threads, with two parallel loops per step."""
    plates, nodes = in_phase.shape[0], in_phase.shape[1]
    for plate in range(plates):
        u = np.zeros((nodes, nodes), in_phase.dtype)
        q, squares, laplacian = np.zeros_like(u), np.zeros_like(u), np.zeros_like(u)
        a, b = in_phase[plate], quadrature[plate]
        for m in range(cosine.size):
            edge_rows(u, numbers[2], laplacian)
            for j in prange(1, nodes - 1):
                laplacian_row(u, j, numbers[2], numbers[3], laplacian[j])
            c, s, measured = cosine[m], sine[m], m >= first
            for j in prange(1, nodes - 1):
                update_row(laplacian, j, a[j], b[j], c, s, numbers, measured, u[j], q[j], squares[j])
        for region in range(2):
            energy[plate, region] = (weights[region] * squares).sum()

"""Numba with the plate index innermost: LLVM finds long loops to vectorise even on a small grid.

Up to 24 plates lie side by side, so that a row of a group is (nodes x lanes) numbers in a line and the
neighbour to the left is `lanes` numbers back. Groups are shared out by prange.
"""

from __future__ import annotations

import numba
import numpy as np
from numba import prange
from numpy.typing import NDArray

from peer_codes.problem import PeerMissing, Problem, Run

MOST_LANES = 24  # 16 to 24 were the fastest of 5, 10, 16, 20 and 24 on 27 x 27 nodes


def make(problem: Problem, threads: int) -> Run:
    """Run on `threads` threads; raise PeerMissing if there are too few plates to fill the lanes."""
    groups = threads * -(-problem.plates // (threads * MOST_LANES))
    lanes = -(-problem.plates // groups)
    if lanes < 4:
        raise PeerMissing("fewer than four plates a thread")
    try:
        numba.set_num_threads(threads)
    except ValueError as error:
        raise PeerMissing(f"Numba has fewer than {threads} threads") from error
    loads = (in_lines(problem.in_phase, lanes), in_lines(problem.quadrature, lanes))
    drive = (problem.cosine, problem.sine)
    # typed numbers: a float literal in a kernel would turn float32 arithmetic into float64
    numbers = np.array([problem.decay, problem.stiffness, 2, 4], problem.dtype)

    def run() -> NDArray[np.float64]:
        numba.set_num_threads(threads)
        squares = np.zeros_like(loads[0])
        share_groups(*loads, *drive, numbers, lanes, problem.first, squares)
        nodes = squares.reshape(len(squares), problem.nodes, problem.nodes, lanes)
        energy = np.einsum("gjil,rji->glr", nodes, problem.weights)
        return energy.reshape(-1, 2)[: problem.plates].astype(np.float64)

    return run


def in_lines(load: NDArray, lanes: int) -> NDArray:
    """(plates, nodes, nodes) as (groups, nodes, nodes x lanes), the last group filled up with idle plates."""
    plates, nodes = load.shape[:2]
    groups = -(-plates // lanes)
    full = np.zeros((groups * lanes, nodes, nodes), load.dtype)
    full[:plates] = load
    lanes_last = np.moveaxis(full.reshape(groups, lanes, nodes, nodes), 1, -1)
    return np.ascontiguousarray(lanes_last).reshape(groups, nodes, nodes * lanes)


@numba.njit(fastmath=True, inline="always")
def laplacian_line(below, here, left, right, above, four, out):
    """The Laplacian between the edge columns of one line."""
    for i in range(here.size):
        out[i] = (left[i] + right[i]) + (below[i] + above[i]) - four * here[i]


@numba.njit(fastmath=True, inline="always")
def update_line(below, here, left, right, above, a, b, cosine, sine, numbers, measured, u, q, squares):
    """Take a step between the edge columns of one line."""
    decay, stiffness, four = numbers[0], numbers[1], numbers[3]
    if measured:
        for i in range(here.size):
            biharmonic = (left[i] + right[i]) + (below[i] + above[i]) - four * here[i]
            x = decay * q[i] - stiffness * biharmonic + (cosine * a[i] + sine * b[i])
            q[i] = x
            u[i] += x
            squares[i] += x * x
    else:
        for i in range(here.size):
            biharmonic = (left[i] + right[i]) + (below[i] + above[i]) - four * here[i]
            x = decay * q[i] - stiffness * biharmonic + (cosine * a[i] + sine * b[i])
            q[i] = x
            u[i] += x


@numba.njit(fastmath=True, parallel=True)
def share_groups(in_phase, quadrature, cosine, sine, numbers, lanes, first, all_squares):
    """A thread takes a group of plates through all its steps; views shifted by `lanes` are the neighbours."""
    nodes, line = in_phase.shape[1], in_phase.shape[2]
    two, four = numbers[2], numbers[3]
    for group in prange(in_phase.shape[0]):
        u = np.zeros((nodes, line), in_phase.dtype)
        q, laplacian = np.zeros_like(u), np.zeros_like(u)
        a, b, squares = in_phase[group], quadrature[group], all_squares[group]
        start, stop = lanes, line - lanes
        for m in range(cosine.size):
            for i in range(line):
                laplacian[0, i] = two * u[1, i]
                laplacian[nodes - 1, i] = two * u[nodes - 2, i]
            for j in range(1, nodes - 1):
                below, here, above, out = u[j - 1, start:stop], u[j], u[j + 1, start:stop], laplacian[j]
                left, right = here[: stop - lanes], here[start + lanes :]
                laplacian_line(below, here[start:stop], left, right, above, four, out[start:stop])
                for lane in range(lanes):
                    out[lane] = two * here[start + lane]
                    out[stop + lane] = two * here[stop - lanes + lane]
            c, s, measured = cosine[m], sine[m], m >= first
            for j in range(1, nodes - 1):
                below, here, above = laplacian[j - 1, start:stop], laplacian[j], laplacian[j + 1, start:stop]
                left, right = here[: stop - lanes], here[start + lanes :]
                load_a, load_b, middle = a[j, start:stop], b[j, start:stop], here[start:stop]
                x, v, w = u[j, start:stop], q[j, start:stop], squares[j, start:stop]
                update_line(below, middle, left, right, above, load_a, load_b, c, s, numbers, measured, x, v, w)

"""NumPy: whole-array slices, every result written in place, no temporary arrays in the step loop.

Twice: plates first, as arrays of plates are usually written, and plates last, where a slice along a row is
one long run of memory instead of many short ones.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from peer_codes.problem import Problem, Run


def make(problem: Problem, threads: int) -> Run:
    """Arrays lie in memory as (plates, nodes, nodes). One thread, whatever `threads` says."""
    return _make(problem, lambda array: np.array(array, order="C"))


def make_plates_last(problem: Problem, threads: int) -> Run:
    """Arrays lie in memory as (nodes, nodes, plates). One thread, whatever `threads` says."""
    return _make(problem, lambda array: np.moveaxis(np.array(np.moveaxis(array, 0, -1), order="C"), -1, 0))


def _make(problem: Problem, lay_out: Callable[[NDArray], NDArray]) -> Run:
    """Arrays are indexed (plate, row, column); `lay_out` sets their order in memory, zeros_like keeps it."""
    whole = lay_out(problem.in_phase)
    in_phase = lay_out(problem.in_phase[:, 1:-1, 1:-1])
    quadrature = lay_out(problem.quadrature[:, 1:-1, 1:-1])
    weights = problem.weights[:, 1:-1, 1:-1]

    def run() -> NDArray[np.float64]:
        u, laplacian = np.zeros_like(whole), np.zeros_like(whole)
        q, squares, work = np.zeros_like(in_phase), np.zeros_like(in_phase), np.zeros_like(in_phase)
        for m in range(problem.steps):
            write_laplacian(u, laplacian[:, 1:-1, 1:-1])
            # on a clamped edge the Laplacian is twice the node inside
            np.multiply(u[:, 1], 2, out=laplacian[:, 0])
            np.multiply(u[:, -2], 2, out=laplacian[:, -1])
            np.multiply(u[:, :, 1], 2, out=laplacian[:, :, 0])
            np.multiply(u[:, :, -2], 2, out=laplacian[:, :, -1])
            write_laplacian(laplacian, work)
            q *= problem.decay
            work *= problem.stiffness
            q -= work
            np.multiply(in_phase, problem.cosine[m], out=work)
            q += work
            np.multiply(quadrature, problem.sine[m], out=work)
            q += work
            u[:, 1:-1, 1:-1] += q
            if m >= problem.first:
                np.multiply(q, q, out=work)
                squares += work
        return np.einsum("pji,rji->pr", squares, weights).astype(np.float64)

    return run


def write_laplacian(field: NDArray, out: NDArray) -> None:
    """The five-point Laplacian of field (plates, n, n) at its interior, into out (plates, n - 2, n - 2)."""
    np.multiply(field[:, 1:-1, 1:-1], -4, out=out)
    out += field[:, :-2, 1:-1]
    out += field[:, 2:, 1:-1]
    out += field[:, 1:-1, :-2]
    out += field[:, 1:-1, 2:]

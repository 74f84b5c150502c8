"""CuPy: CUDA kernels written by hand, a thread a node, a launch a step; at fourth order two, one for each pass."""

from __future__ import annotations

import cupy
import numpy as np
from numpy.typing import NDArray

from peer_codes.problem import PeerMissing, Problem, Run

THREADS_A_BLOCK = 256

# u is held twice because a thread must not overwrite what its neighbours still read; edge nodes stay zero in
# both. Beside a clamped edge the node two steps away is the ghost, which mirrors the node itself.
SOURCE = r"""
extern "C" __global__ void step(
    const REAL *__restrict__ u, REAL *__restrict__ u_next, REAL *__restrict__ q, REAL *__restrict__ squares,
    const REAL *__restrict__ in_phase, const REAL *__restrict__ quadrature,
    const REAL *__restrict__ cosine, const REAL *__restrict__ sine,
    const REAL decay, const REAL stiffness, const int m, const int measured, const unsigned int count)
{
    const unsigned int k = blockIdx.x * blockDim.x + threadIdx.x;
    if (k >= count)
        return;
    const unsigned int i = k % NODES, j = k / NODES % NODES;
    if (i == 0 || i == NODES - 1 || j == 0 || j == NODES - 1)
        return;
    const REAL here = u[k];
    const REAL near = (u[k - 1] + u[k + 1]) + (u[k - NODES] + u[k + NODES]);
    const REAL diagonal = (u[k - NODES - 1] + u[k - NODES + 1]) + (u[k + NODES - 1] + u[k + NODES + 1]);
    const REAL far = ((i > 1 ? u[k - 2] : here) + (i < NODES - 2 ? u[k + 2] : here))
                   + ((j > 1 ? u[k - 2 * NODES] : here) + (j < NODES - 2 ? u[k + 2 * NODES] : here));
    const REAL biharmonic = 20 * here - 8 * near + 2 * diagonal + far;
    const REAL load = cosine[m] * in_phase[k] + sine[m] * quadrature[k];
    const REAL x = decay * q[k] - stiffness * biharmonic + load;
    q[k] = x;
    u_next[k] = here + x;
    if (measured)
        squares[k] += x * x;
}
"""

SOURCE_OF_FOURTH_ORDER = r"""
__device__ REAL both_axes(const REAL *__restrict__ field, const REAL *__restrict__ taps, unsigned k, int i, int j)
{
    REAL sum = 0;
    for (int n = -2; n <= 2; ++n) {
        if (i + n >= 0 && i + n < NODES)
            sum += taps[5 * i + n + 2] * field[k + n];
        if (j + n >= 0 && j + n < NODES)
            sum += taps[5 * j + n + 2] * field[k + n * NODES];
    }
    return sum;
}

extern "C" __global__ void bend(
    const REAL *__restrict__ u, REAL *__restrict__ curvature, const REAL *__restrict__ taps, const unsigned int count)
{
    const unsigned int k = blockIdx.x * blockDim.x + threadIdx.x;
    if (k < count)
        curvature[k] = both_axes(u, taps, k, k % NODES, k / NODES % NODES);
}

extern "C" __global__ void move(
    const REAL *__restrict__ curvature, REAL *__restrict__ u, REAL *__restrict__ q, REAL *__restrict__ squares,
    const REAL *__restrict__ in_phase, const REAL *__restrict__ quadrature,
    const REAL *__restrict__ cosine, const REAL *__restrict__ sine,
    const REAL decay, const REAL stiffness, const int m, const int measured, const unsigned int count,
    const REAL *__restrict__ taps)
{
    const unsigned int k = blockIdx.x * blockDim.x + threadIdx.x;
    if (k >= count)
        return;
    const int i = k % NODES, j = k / NODES % NODES;
    if (i == 0 || i == NODES - 1 || j == 0 || j == NODES - 1)
        return;
    const REAL load = cosine[m] * in_phase[k] + sine[m] * quadrature[k];
    const REAL x = decay * q[k] - stiffness * both_axes(curvature, taps, k, i, j) + load;
    q[k] = x;
    u[k] += x;
    if (measured)
        squares[k] += x * x;
}
"""


def make(problem: Problem, threads: int) -> Run:
    """Run on the GPU; raise PeerMissing if there is none, or if 32 bits cannot number the nodes."""
    if not cupy.is_available():
        raise PeerMissing("CuPy finds no GPU")
    count = problem.in_phase.size
    if count >= 2**32 - THREADS_A_BLOCK:
        raise PeerMissing("more nodes than 32 bits can number")
    real = "float" if problem.precision == "float32" else "double"
    options = (f"-DNODES={problem.nodes}" + "u" * (problem.order == 2), f"-DREAL={real}")
    loads = (cupy.asarray(problem.in_phase), cupy.asarray(problem.quadrature))
    drive = (cupy.asarray(problem.cosine), cupy.asarray(problem.sine))
    weights = cupy.asarray(problem.weights)
    numbers = (problem.dtype.type(problem.decay), problem.dtype.type(problem.stiffness))
    blocks = (-(-count // THREADS_A_BLOCK),)

    def second_order(u, other, q, squares, *run_time):
        step(blocks, (THREADS_A_BLOCK,), (u, other, q, squares, *loads, *drive, *numbers, *run_time))
        return other, u

    def fourth_order(u, other, q, squares, *run_time):
        bend(blocks, (THREADS_A_BLOCK,), (u, other, taps[0], run_time[-1]))
        move(blocks, (THREADS_A_BLOCK,), (other, u, q, squares, *loads, *drive, *numbers, *run_time, taps[1]))
        return u, other

    if problem.order == 4:
        taps = [cupy.asarray(tap.astype(problem.dtype)) for tap in problem.taps]
        bend, move = (cupy.RawKernel(SOURCE_OF_FOURTH_ORDER, name, options=options) for name in ("bend", "move"))
        advance = fourth_order
    else:
        step = cupy.RawKernel(SOURCE, "step", options=options)
        advance = second_order

    def run() -> NDArray[np.float64]:
        u, other, q, squares = (cupy.zeros_like(loads[0]) for _ in range(4))
        for m in range(problem.steps):
            u, other = advance(u, other, q, squares, np.int32(m), np.int32(m >= problem.first), np.uint32(count))
        energy = cupy.stack([(region * squares).sum(axis=(1, 2)) for region in weights], axis=1)
        return cupy.asnumpy(energy).astype(np.float64)  # waits for the result

    return run

"""JAX: all steps in two jitted fori_loops, one before the window of the energy and one in it."""

from __future__ import annotations

import os

# JAX would otherwise take three quarters of the GPU's memory from the peers that run beside it
os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from peer_codes.problem import PeerMissing, Problem, Run


def make(problem: Problem, threads: int) -> Run:
    """Run on problem.device; raise PeerMissing if JAX has no such device. XLA chooses its threads."""
    try:
        device = jax.devices(problem.device)[0]
    except RuntimeError as error:
        raise PeerMissing(f"JAX has no {problem.device} device") from error
    jax.config.update("jax_enable_x64", problem.precision == "float64")
    inside = (..., slice(1, -1), slice(1, -1))
    arrays = (problem.in_phase[inside], problem.quadrature[inside], problem.cosine, problem.sine)
    constants = (20 + problem.edges_touched, problem.weights[inside])
    inputs = [jax.device_put(np.ascontiguousarray(array), device) for array in (*arrays, *constants)]
    taps = [jax.device_put(tap.astype(problem.dtype), device) for tap in problem.taps] if problem.order == 4 else []

    @jax.jit
    def solve(in_phase, quadrature, cosine, sine, diagonal, weights):
        def update(m, u, q):
            load = cosine[m] * in_phase + sine[m] * quadrature
            bent = two_passes(u, *taps) if taps else biharmonic(u, diagonal)
            q = problem.decay * q - problem.stiffness * bent + load
            return u + q, q

        def before(m, state):
            return update(m, *state)

        def measured(m, state):
            u, q, squares = state
            u, q = update(m, u, q)
            return u, q, squares + q * q

        still = jnp.zeros_like(in_phase)
        u, q = jax.lax.fori_loop(0, problem.first, before, (still, still))
        _, _, squares = jax.lax.fori_loop(problem.first, problem.steps, measured, (u, q, still))
        # sums, not a matrix product: on some GPUs a float32 product drops to ten bits of mantissa
        return jnp.stack([jnp.sum(region * squares, axis=(1, 2)) for region in weights], axis=1)

    def run() -> NDArray[np.float64]:
        return np.asarray(solve(*inputs)).astype(np.float64)  # waits for the result

    return run


def biharmonic(u, diagonal):
    """The clamped 13-point sum at interior nodes (plates, n, n): zeros outside, the edges in the diagonal."""
    rows, columns = u.shape[1:]
    padded = jnp.pad(u, ((0, 0), (2, 2), (2, 2)))

    def at(down, right):
        return padded[:, 2 + down : 2 + down + rows, 2 + right : 2 + right + columns]

    return (
        diagonal * u
        - 8 * (at(-1, 0) + at(1, 0) + at(0, -1) + at(0, 1))
        + 2 * (at(-1, -1) + at(-1, 1) + at(1, -1) + at(1, 1))
        + (at(-2, 0) + at(2, 0) + at(0, -2) + at(0, 2))
    )


def two_passes(u, bend, move):
    """The fourth-order biharmonic of u (plates, n, n) at interior nodes: taps (n + 2, 5) along each axis, twice."""
    curvature = one_pass(jnp.pad(u, ((0, 0), (1, 1), (1, 1))), bend)
    return one_pass(curvature, move)[:, 1:-1, 1:-1]


def one_pass(field, taps):
    """The sum of taps (nodes, 5) of a field (plates, nodes, nodes) along both axes."""
    nodes = len(taps)
    padded = jnp.pad(field, ((0, 0), (2, 2), (2, 2)))
    along_x = [taps[:, k] * padded[:, 2:-2, k : k + nodes] for k in range(5)]
    along_y = [taps[:, k, None] * padded[:, k : k + nodes, 2:-2] for k in range(5)]
    return sum(along_x + along_y)

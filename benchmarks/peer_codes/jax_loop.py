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
    """On problem.device; raises PeerMissing where JAX has no such device. XLA chooses its own threads."""
    try:
        device = jax.devices(problem.device)[0]
    except RuntimeError as error:
        raise PeerMissing(f"JAX has no {problem.device} device") from error
    jax.config.update("jax_enable_x64", problem.precision == "float64")
    inside = (..., slice(1, -1), slice(1, -1))
    arrays = (problem.in_phase[inside], problem.quadrature[inside], problem.cosine, problem.sine)
    constants = (20 + problem.edges_touched, problem.weights[inside])
    inputs = [jax.device_put(np.ascontiguousarray(array), device) for array in (*arrays, *constants)]

    @jax.jit
    def solve(in_phase, quadrature, cosine, sine, diagonal, weights):
        def update(m, u, q):
            load = cosine[m] * in_phase + sine[m] * quadrature
            q = problem.decay * q - problem.stiffness * biharmonic(u, diagonal) + load
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

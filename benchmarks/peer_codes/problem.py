"""The work that every peer does, its inputs, and a plain float64 answer to check against.

Everything is dimensionless. On every plate, for step m = 0 .. steps - 1, at the interior nodes

    q  <-  decay q - stiffness B u + cos(omega m) in_phase + sin(omega m) quadrature
    u  <-  u + q
    squares  <-  squares + q^2         only when m >= first

where B is the 13-point biharmonic with unit spacing (20, -8, 2, 1). The edge nodes stay at zero; the edges
are clamped, so the ghost node outside an edge mirrors the first node inside it. Fourth order: B is two passes of
five taps along each axis, curvature from u and force from curvature, which `Problem.taps` holds. The answer is

    energy[plate, region] = sum over nodes of weights[region] squares

Region 0 is the whole plate, region 1 the quadrant at the first corner. The loads are those of four actuators where the
paper has them, each with random numbers of its own at its nodes: most nodes carry none, as in every scene. warp-plate
knows from the scene which rows those are; the other programs here treat all nodes alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from warp_plate.plate.operator import make_taps

Run = Callable[[], NDArray[np.float64]]
"""Does the whole work from zero state; returns energies, shape (plates, 2), float64, on the host."""


class PeerMissing(Exception):
    """A peer cannot run here, for instance because no compiler or no GPU is there; the message says why."""


@dataclass(frozen=True)
class Problem:
    """A batch of clamped square plates; the same fields and seed give the same arrays."""

    plates: int
    nodes: int  # along a side, edges included
    steps: int
    precision: str = "float32"  # or "float64"
    seed: int = 0
    device: str = "cpu"  # or "cuda"
    order: int = 2  # or 4

    decay = 0.98  # of the velocity in one step
    omega = 2 * math.pi * 290 * 8e-5  # drive phase in one step, rad

    def __post_init__(self) -> None:
        """Refuse sizes for which the scheme has no meaning."""
        if self.plates < 1 or self.nodes < 5 or self.steps < 2:
            raise ValueError(f"need plates >= 1, nodes >= 5 and steps >= 2, got {self}")
        if self.order not in (2, 4) or (self.order == 4 and self.nodes < 9):
            raise ValueError(f"order must be 2, or 4 on at least 9 nodes, got {self}")
        if self.precision not in ("float32", "float64"):
            raise ValueError(f"precision must be float32 or float64, not {self.precision!r}")

    @property
    def stiffness(self) -> float:
        """(kappa dt / h^2)^2; the stability limit is 1/16 at second and 9/256 at fourth order."""
        return 0.24**2 if self.order == 2 else 0.18**2

    @cached_property
    def taps(self) -> tuple[NDArray, NDArray]:
        """Weights at fourth order of each node's neighbours from -2 to 2 in both passes, shape (nodes, 5) each."""
        taps = make_taps(self.nodes, "clamped", "clamped", 4)
        return taps.bend / 12, taps.move / 12

    @property
    def first(self) -> int:
        """The first step that counts in the energy."""
        return self.steps // 2

    @property
    def dtype(self) -> np.dtype:
        """The NumPy type of the state and of the inputs."""
        return np.dtype(self.precision)

    @property
    def node_steps(self) -> int:
        """Interior nodes of all plates times steps: the unit in which times are given."""
        return self.plates * (self.nodes - 2) ** 2 * self.steps

    @property
    def in_phase(self) -> NDArray:
        """Load that goes with the cosine, shape (plates, nodes, nodes), zero on the edges; read-only."""
        return _loads(self.plates, self.nodes, self.precision, self.seed)[0]

    @property
    def quadrature(self) -> NDArray:
        """Load that goes with the sine, shape (plates, nodes, nodes), zero on the edges; read-only."""
        return _loads(self.plates, self.nodes, self.precision, self.seed)[1]

    @cached_property
    def cosine(self) -> NDArray:
        """cos(omega m), shape (steps,)."""
        return np.cos(self.omega * np.arange(self.steps)).astype(self.dtype)

    @cached_property
    def sine(self) -> NDArray:
        """sin(omega m), shape (steps,)."""
        return np.sin(self.omega * np.arange(self.steps)).astype(self.dtype)

    @cached_property
    def weights(self) -> NDArray:
        """Share of each node's cell that lies in each region, shape (2, nodes, nodes)."""
        centre = np.arange(self.nodes)
        shares = []
        for end in (self.nodes - 1, (self.nodes - 1) / 2):
            along = np.minimum(centre + 0.5, end) - np.maximum(centre - 0.5, 0)
            shares.append(np.outer(along.clip(0), along.clip(0)))
        return np.stack(shares).astype(self.dtype)

    @cached_property
    def edges_touched(self) -> NDArray:
        """Return the number of edges next to each interior node (0, 1 or 2), shape (nodes - 2, nodes - 2).

        The ghost outside a clamped edge equals the node next to that edge, so with zeros outside the interior
        the clamped biharmonic is the 13-point sum plus this count times the node's own displacement.
        """
        beside = np.zeros(self.nodes - 2)
        beside[0] += 1
        beside[-1] += 1
        return (beside[:, None] + beside[None, :]).astype(self.dtype)


def loaded_nodes(nodes: int) -> NDArray[np.int64]:
    """Row and column of the nodes under the four actuators, shape (count, 2): 0.15 to 0.21 of a side from each edge."""
    place = np.arange(nodes) / (nodes - 1)
    along = ((place > 0.14) & (place < 0.22)) | ((place > 0.78) & (place < 0.86))
    along[[nodes // 5, -1 - nodes // 5]] = True  # on the smallest grids too
    along[[0, -1]] = False
    return np.argwhere(np.outer(along, along))


@lru_cache(maxsize=1)
def _loads(plates: int, nodes: int, precision: str, seed: int) -> NDArray:
    """Random loads, shape (2, plates, nodes, nodes); plate p of a seed is the same in a smaller batch."""
    loads = np.zeros((2, plates, nodes, nodes), precision)
    covered = loaded_nodes(nodes)
    for plate in range(plates):
        generator = np.random.default_rng((seed, plate))
        numbers = generator.standard_normal((2, len(covered)), dtype=np.dtype(precision).type)
        loads[:, plate, covered[:, 0], covered[:, 1]] = numbers
    loads.flags.writeable = False
    return loads


def reference(problem: Problem, plates: Sequence[int]) -> NDArray[np.float64]:
    """Energies of some of the plates in float64, shape (len(plates), 2): the work above, term by term."""
    chosen = np.asarray(plates)
    in_phase = problem.in_phase[chosen, 1:-1, 1:-1].astype(np.float64)
    quadrature = problem.quadrature[chosen, 1:-1, 1:-1].astype(np.float64)
    u = np.zeros((len(chosen), problem.nodes, problem.nodes))
    q = np.zeros_like(in_phase)
    squares = np.zeros_like(in_phase)
    biharmonic = clamped_biharmonic if problem.order == 2 else partial(two_passes, taps=problem.taps)
    for m in range(problem.steps):
        load = math.cos(problem.omega * m) * in_phase + math.sin(problem.omega * m) * quadrature
        q = problem.decay * q - problem.stiffness * biharmonic(u) + load
        u[:, 1:-1, 1:-1] += q
        if m >= problem.first:
            squares += q * q
    return np.einsum("pji,rji->pr", squares, problem.weights[:, 1:-1, 1:-1].astype(np.float64))


def clamped_biharmonic(u: NDArray) -> NDArray:
    """The 13-point sum at the inner nodes of u (plates, nodes, nodes), with mirror nodes outside the edges."""
    u = np.pad(u, ((0, 0), (1, 1), (1, 1)))
    u[:, 0], u[:, -1] = u[:, 2], u[:, -3]
    u[:, :, 0], u[:, :, -1] = u[:, :, 2], u[:, :, -3]

    def at(down: int, right: int) -> NDArray:
        rows, columns = u.shape[1:]
        return u[:, 2 + down : rows - 2 + down, 2 + right : columns - 2 + right]

    return (
        20 * at(0, 0)
        - 8 * (at(-1, 0) + at(1, 0) + at(0, -1) + at(0, 1))
        + 2 * (at(-1, -1) + at(-1, 1) + at(1, -1) + at(1, 1))
        + (at(-2, 0) + at(2, 0) + at(0, -2) + at(0, 2))
    )


def two_passes(u: NDArray, taps: tuple[NDArray, NDArray]) -> NDArray:
    """The fourth-order biharmonic at the inner nodes of u (plates, nodes, nodes)."""
    bend, move = (sum(np.diag(tap[max(0, -k) : len(tap) - max(0, k), k + 2], k) for k in range(-2, 3)) for tap in taps)
    curvature = u @ bend.T + bend @ u
    return (curvature @ move.T + move @ curvature)[:, 1:-1, 1:-1]

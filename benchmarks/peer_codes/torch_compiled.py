"""PyTorch: torch.compile of a few steps, each made a kernel by Inductor, called in a loop from Python."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from peer_codes.problem import PeerMissing, Problem, Run

STEPS_A_CALL = 5  # shares the cost of a call from Python; more of them take longer to compile


def make(problem: Problem, threads: int) -> Run:
    """Run on problem.device; raise PeerMissing if PyTorch has no GPU. PyTorch chooses its threads."""
    if problem.device == "cuda" and not torch.cuda.is_available():
        raise PeerMissing("PyTorch has no cuda device")
    inside = (..., slice(1, -1), slice(1, -1))

    def upload(array: NDArray) -> torch.Tensor:
        return torch.tensor(np.ascontiguousarray(array), device=problem.device)

    in_phase, quadrature = upload(problem.in_phase[inside]), upload(problem.quadrature[inside])
    diagonal, weights = upload(20 + problem.edges_touched), upload(problem.weights[inside])
    calls = split_steps(problem.first, problem.steps)
    # a tensor of its own for each call: Inductor copies inputs that start inside another tensor
    drives = [(upload(problem.cosine[call]), upload(problem.sine[call])) for call in calls]

    # forget what was compiled for other sizes: after a few of them PyTorch would stop compiling
    torch.compiler.reset()
    advance_compiled = torch.compile(advance, dynamic=False, fullgraph=True)

    @torch.no_grad()
    def run() -> NDArray[np.float64]:
        u, q, squares = (torch.zeros_like(in_phase) for _ in range(3))
        for call, (cosine, sine) in zip(calls, drives, strict=True):
            fixed = (in_phase, quadrature, cosine, sine, diagonal, problem.decay, problem.stiffness)
            if call.start < problem.first:
                u, q = advance_compiled(u, q, None, *fixed)
            else:
                u, q, squares = advance_compiled(u, q, squares, *fixed)
        energy = torch.stack([(region * squares).sum(dim=(1, 2)) for region in weights], dim=1)
        return energy.cpu().numpy().astype(np.float64)  # waits for the result

    return run


def split_steps(first: int, steps: int) -> list[slice]:
    """Slices of at most STEPS_A_CALL steps, none of them across `first`."""
    calls = []
    for start, stop in ((0, first), (first, steps)):
        calls += [slice(m, min(m + STEPS_A_CALL, stop)) for m in range(start, stop, STEPS_A_CALL)]
    return calls


def advance(u, q, squares, in_phase, quadrature, cosine, sine, diagonal, decay: float, stiffness: float):
    """Take a step for each number of cosine; return u, q and, unless it is None, squares."""
    for step in range(cosine.shape[0]):
        load = cosine[step] * in_phase + sine[step] * quadrature
        q = decay * q - stiffness * biharmonic(u, diagonal) + load
        u = u + q
        if squares is not None:
            squares = squares + q * q
    return (u, q) if squares is None else (u, q, squares)


def biharmonic(u, diagonal):
    """The clamped 13-point sum at interior nodes (plates, n, n): zeros outside, the edges in the diagonal."""
    rows, columns = u.shape[1:]
    padded = torch.nn.functional.pad(u, (2, 2, 2, 2))

    def at(down, right):
        return padded[:, 2 + down : 2 + down + rows, 2 + right : 2 + right + columns]

    return (
        diagonal * u
        - 8 * (at(-1, 0) + at(1, 0) + at(0, -1) + at(0, 1))
        + 2 * (at(-1, -1) + at(-1, 1) + at(1, -1) + at(1, 1))
        + (at(-2, 0) + at(2, 0) + at(0, -2) + at(0, 2))
    )

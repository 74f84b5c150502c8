"""warp-plate on the path that it chooses for the size of plate, driven just below its scenes by the work's numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import warp as wp
from numpy.typing import NDArray

from peer_codes.problem import PeerMissing, Problem, Run, loaded_nodes
from warp_plate import Scene
from warp_plate.plate.operator import DIVISOR
from warp_plate.plate.scheme import discretize
from warp_plate.solve.compiled_scene import CompiledScene
from warp_plate.solve.devices import find_device
from warp_plate.solve.specialize import Specialized
from warp_plate.solve.state import State
from warp_plate.solve.streaming import repeat


def make(problem: Problem, threads: int) -> Run:
    """Run on the CPU with a number of threads, or on the GPU; raise PeerMissing if there is none."""
    find_device("cpu")  # starts Warp without its greeting
    if problem.device == "cuda" and not wp.is_cuda_available():
        raise PeerMissing("Warp finds no GPU")
    specialized = specialize_as(problem, threads)
    inner = np.s_[:, 1:-1, : problem.nodes]
    compiled = CompiledScene(specialized)
    state = State(specialized, problem.plates)
    for field, load in ((state.in_phase, problem.in_phase), (state.quadrature, problem.quadrature)):
        padded = np.zeros(field.shape, dtype=problem.dtype)
        padded[inner] = load
        field.assign(padded)

    def whole(_launch: object, state: State, plates: int) -> None:
        state.clear(plates)
        compiled.advance(state, plates, 0, problem.steps)
        compiled.sums_to_host(state, plates)

    whole(None, state, problem.plates)  # kernels are compiled by the first run, and cannot be while a run is recorded

    def run() -> NDArray[np.float64]:
        if problem.device == "cuda" and compiled.path == "resident":
            repeat(specialized.device, whole, state, problem.plates)
        else:
            whole(None, state, problem.plates)
        return compiled.wait_for_sums(state, problem.plates)().copy()

    return run


def specialize_as(problem: Problem, threads: int) -> Specialized:
    """A clamped, damped scene of the problem's size, with the problem's numbers put in their places."""
    scene = Scene.load("paper").model_dump()
    scene["grid"] |= {"nodes": (problem.nodes,) * 2, "precision": problem.precision, "time_step": None}
    scene["grid"] |= {"load": "overlap", "order": problem.order}
    device = find_device(problem.device)
    made = Specialized(discretize(Scene.model_validate(scene)), device, threads)
    made.parameters.stiffness = problem.stiffness / DIVISOR[problem.order] ** 2
    made.parameters.decay = problem.decay
    covered = loaded_nodes(problem.nodes) + [1, 0]
    weights = np.zeros(made.weights.shape)
    weights[:, 1:-1, : problem.nodes] = problem.weights
    made.scheme = replace(made.scheme, steps=problem.steps, window=(problem.first, problem.steps))
    made.support = wp.array(covered.astype(np.int32), dtype=int, device=device)
    made.weights = wp.array(weights, dtype=wp.float64, device=device)
    made.wave = made.to_device(np.stack([problem.cosine, problem.sine], axis=1))
    return made

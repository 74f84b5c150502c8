"""Hand-written C: plate.c, compiled on the spot for one grid and precision, called through ctypes."""

from __future__ import annotations

import ctypes
import platform
import shutil
import subprocess
import tempfile
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from peer_codes.problem import PeerMissing, Problem, Run

FLAGS = ("-O3", "-march=native", "-pthread", "-shared", "-fPIC")


@lru_cache
def library(nodes: int, precision: str) -> ctypes.CDLL:
    """plate.c for one grid and precision; raises PeerMissing when it cannot be built."""
    if shutil.which("gcc") is None:
        raise PeerMissing("gcc is not installed")
    # where 512-bit vectors exist GCC still prefers 256-bit ones; the full width is faster for this work
    wide = ["-mprefer-vector-width=512"] if platform.machine() in ("x86_64", "AMD64") else []
    real = "float" if precision == "float32" else "double"
    with tempfile.TemporaryDirectory() as folder:
        built = Path(folder, "plate.so")
        source = Path(__file__).with_name("plate.c")
        command = ["gcc", *FLAGS, *wide, f"-DNODES={nodes}", f"-DREAL={real}", str(source), "-o", str(built)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise PeerMissing(f"gcc failed: {done.stderr.strip().splitlines()[0]}")
        return ctypes.CDLL(str(built))  # stays loaded after the folder is gone


def make(problem: Problem, threads: int) -> Run:
    """The C code on `threads` threads, in whichever layout suits the batch."""
    run_c = library(problem.nodes, problem.precision).run
    run_c.restype = None
    lanes = 64 // problem.dtype.itemsize
    innermost = innermost_is_faster(problem, lanes, threads)
    pack = in_groups if innermost else in_rows
    loads = [pack(load, lanes) for load in (problem.in_phase, problem.quadrature)]
    groups = len(loads[0]) if innermost else 0
    inputs = (problem.cosine, problem.sine, *loads, problem.weights)  # each contiguous
    counts = [ctypes.c_int(n) for n in (problem.plates, groups, problem.steps, problem.first, threads)]
    parts = 1 if groups or problem.plates >= threads else threads

    def run() -> NDArray[np.float64]:
        energy = np.zeros((parts, groups * lanes or problem.plates, 2))
        arrays = [array.ctypes.data_as(ctypes.c_void_p) for array in (*inputs, energy)]
        run_c(*counts, *arrays)
        return energy.sum(axis=0)[: problem.plates]

    return run


def innermost_is_faster(problem: Problem, lanes: int, threads: int) -> bool:
    """Return whether `lanes` plates side by side beat one at a time (both measured at 27 to 105 nodes a side).

    The five arrays of a group must stay in the second-level cache (1 MiB is safe), and hardly any lane may
    idle, neither in a last group that is not full nor in a thread with one group fewer than the others.
    """
    group_bytes = 5 * problem.nodes**2 * lanes * problem.dtype.itemsize
    plates_a_round = lanes * threads
    paid_for = -(-problem.plates // plates_a_round) * plates_a_round
    return group_bytes <= 2**20 and paid_for <= 1.1 * problem.plates


def in_rows(load: NDArray, lanes: int) -> NDArray:
    """(plates, nodes, nodes) with rows padded by zeros to whole vectors, aligned to 64 bytes."""
    nodes = load.shape[-1]
    padded = aligned_zeros((*load.shape[:2], -(-nodes // lanes) * lanes), load.dtype)
    padded[..., :nodes] = load
    return padded


def in_groups(load: NDArray, lanes: int) -> NDArray:
    """(groups, nodes, nodes, lanes), the last group filled up with idle plates; aligned to 64 bytes."""
    plates, nodes = load.shape[:2]
    groups = -(-plates // lanes)
    padded = np.zeros((groups * lanes, nodes, nodes), load.dtype)
    padded[:plates] = load
    side_by_side = aligned_zeros((groups, nodes, nodes, lanes), load.dtype)
    side_by_side[...] = np.moveaxis(padded.reshape(groups, lanes, nodes, nodes), 1, -1)
    return side_by_side


def aligned_zeros(shape: tuple[int, ...], dtype: np.dtype) -> NDArray:
    """Zeros that start on a 64-byte boundary."""
    size = int(np.prod(shape)) * dtype.itemsize
    memory = np.zeros(size + 64, np.uint8)
    start = -memory.ctypes.data % 64
    return memory[start : start + size].view(dtype).reshape(shape)

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


def version() -> str:
    """The compiler's own first line, for the record."""
    if shutil.which("gcc") is None:
        return "not installed"
    return subprocess.run(["gcc", "--version"], capture_output=True, text=True, check=True).stdout.splitlines()[0]


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
    """The C code on `threads` threads; plates innermost where the batch fills the vectors several times over."""
    run_c = library(problem.nodes, problem.precision).run
    run_c.restype = None
    lanes = 64 // problem.dtype.itemsize
    groups = problem.plates // lanes if innermost_is_faster(problem, lanes, threads) else 0
    loads = [in_groups(load, lanes) if groups else in_rows(load, lanes) for load in (problem.in_phase, problem.quadrature)]
    inputs = [np.ascontiguousarray(array) for array in (problem.cosine, problem.sine, *loads, problem.weights)]
    addresses = [array.ctypes.data_as(ctypes.c_void_p) for array in inputs]
    groups = loads[0].shape[0] if groups else 0

    counts = [ctypes.c_int(n) for n in (problem.plates, groups, problem.steps, problem.first, threads)]
    parts = 1 if groups or problem.plates >= threads else threads

    def run() -> NDArray[np.float64]:
        energy = np.zeros((parts, groups * lanes or problem.plates, 2))
        run_c(*counts, *addresses, energy.ctypes.data_as(ctypes.c_void_p))
        return energy.sum(axis=0)[: problem.plates]

    # ctypes keeps no reference to the arrays behind the addresses
    run.inputs = inputs  # type: ignore[attr-defined]
    return run


def innermost_is_faster(problem: Problem, lanes: int, threads: int) -> bool:
    import os
    v=os.environ.get("INNER")
    return v=="1"


def in_rows(load: NDArray, lanes: int) -> NDArray:
    """(plates, nodes, nodes) with rows padded by zeros to whole vectors, aligned to 64 bytes."""
    nodes = load.shape[-1]
    padded = aligned_zeros((*load.shape[:2], -(-nodes // lanes) * lanes), load.dtype)
    padded[..., :nodes] = load
    return padded


def in_groups(load: NDArray, lanes: int) -> NDArray:
    """(groups, nodes, nodes, lanes): `lanes` plates side by side, the last group filled up with idle plates."""
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

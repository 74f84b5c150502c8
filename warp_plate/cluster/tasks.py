"""Tasks of workers: the plates of a block, by a solver built from plain data."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from uuid import uuid4

import numpy as np
import warp as wp

from warp_plate._version import __version__
from warp_plate.plate.designs import Designs
from warp_plate.plate.weights import NO_AREAS, REGIONS, RegionLike, region_weights
from warp_plate.scene.errors import SceneError
from warp_plate.scene.load import read_beside
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import processor_of
from warp_plate.solve.solver import PlateSolver

# Environment variable with the device of a worker; it takes precedence over the command's option.
DEVICE_VARIABLE = "WARP_PLATE_DEVICE"
# Number of solvers that a worker caches: each scenario of a robust search has one.
MAX_SOLVERS = 128
# Beginning of the message of the RuntimeError that Warp raises when an allocation fails.
WARP_OUT_OF_MEMORY = "Failed to allocate"


@dataclass(frozen=True)
class SceneSpec:
    """A scene in plain data."""

    text: str  # as TOML
    files: Mapping[str, bytes]  # contents of the files that it names, by their names

    @staticmethod
    def of(scene: Scene) -> SceneSpec:
        """Return a scene in plain data, or raise a SceneError if a file that it names cannot be read."""
        files = {name: read_beside(key, name, scene.folder) for key, name in scene.named_files.items()}
        return SceneSpec(scene.to_toml(), files)

    def scene_in(self, folder: str) -> Scene:
        """Write the files to a folder and return the scene, which reads them there."""
        for name, content in self.files.items():
            (Path(folder) / Path(name).name).write_bytes(content)
        return Scene.parse(self.text, "on a worker").in_folder(Path(folder))


@dataclass(frozen=True)
class SolverSpec:
    """The arguments of a :class:`PlateSolver` in plain data."""

    scene: SceneSpec = field(compare=False)  # with a grid
    device: str = field(compare=False)  # unless the worker's environment names another one
    path: str = field(compare=False)
    options: Mapping[str, Any] = field(compare=False)
    key: str = field(default_factory=lambda: uuid4().hex)  # identifies a solver that a worker has built

    @staticmethod
    def of(
        scene: Scene, device: str, path: str, areas: Mapping[str, RegionLike] = NO_AREAS, **options: Any
    ) -> SolverSpec:
        """Return the spec of ``PlateSolver(scene, device, path, ...)``, with areas as weights."""
        weights = region_weights(scene, areas)[len(REGIONS) :]
        options["areas"] = dict(zip(areas, weights, strict=True))
        return SolverSpec(SceneSpec.of(scene), device, path, options)


@dataclass(frozen=True)
class Evaluation:
    """Energies of a batch."""

    energy: np.ndarray  # (plates, regions) as in ``Run``; NaN for a plate that failed
    node_steps: int  # nodes updated × steps × plates
    # Reason and time of detection [s] (NaN if unknown) of each plate that failed, by its number
    faults: Mapping[int, tuple[str, float]]


def run_task(function: Callable[[Any], Any], argument: Any) -> Any:
    """Call a function on a worker; raise MemoryError if it has too little memory, on the host or on its device."""
    try:
        return function(argument)
    except (MemoryError, RuntimeError) as error:
        if isinstance(error, MemoryError) or str(error).startswith(WARP_OUT_OF_MEMORY):
            make_solver.cache_clear()  # frees the memory of other solvers
            raise MemoryError(f"out of memory ({' '.join(str(error).split())})") from None
        raise


def run_block(block: tuple[SolverSpec, Designs]) -> tuple[Evaluation, dict[str, str]]:
    """Run the plates of a block; return their energies and the worker's identity with the "kind" of its device."""
    spec, designs = block
    solver = make_solver(spec)
    run = solver.run(designs)
    kind = "cuda" if solver.device.is_cuda else "cpu"
    return Evaluation(run.energy, run.node_steps, dict(run.faults)), {"kind": kind, **worker_identity(solver.device)}


@lru_cache(MAX_SOLVERS)
def make_solver(spec: SolverSpec) -> PlateSolver:
    """Return the solver of a spec, with one thread on a CPU unless WARP_PLATE_THREADS says another number."""
    with TemporaryDirectory() as folder:
        scene, device = spec.scene.scene_in(folder), worker_device(spec.device)
        threads = None if os.environ.get("WARP_PLATE_THREADS") else 1
        return PlateSolver(scene, device, spec.path, threads=threads, **spec.options)


def worker_device(device: str) -> str:
    """Return the device of this worker for a command that asks for ``device``."""
    return os.environ.get(DEVICE_VARIABLE) or device


def worker_identity(device: wp.Device) -> dict[str, str]:
    """Return the versions and the processor of this process, on which the last bits of a result depend."""
    return {
        "warp_plate": __version__,
        "warp": wp.config.version,
        "processor": processor_of(device),
    }


def refuse_unlike(expected: Mapping[str, str], worker: Mapping[str, str]) -> None:
    """Raise a SceneError if a worker's identity differs in an entry of ``expected`` from this process or others."""
    for name, value in expected.items():
        if worker[name] != value:
            raise SceneError(
                f"workers: {name} is {worker[name]} on one and {value} on another or here, which rounds in another "
                "way; make them alike, or name one device for all by --device"
            )

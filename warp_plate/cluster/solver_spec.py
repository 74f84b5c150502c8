"""Everything that a worker needs to make a solver, or a scene with the files that it names."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from uuid import uuid4

import numpy as np

from warp_plate.plate.designs import NO_PER_PLATE, PerPlate
from warp_plate.plate.files import named_files, read_beside
from warp_plate.plate.weights import NO_AREAS, REGIONS, Region, region_weights
from warp_plate.scene.dump import dump_scene
from warp_plate.scene.model import Scene
from warp_plate.solve.solver import PlateSolver
from warp_plate.solve.specialize import Quantity

# Environment variable with the device of a worker; it takes precedence over what the command says.
DEVICE_VARIABLE = "WARP_PLATE_DEVICE"
# Solvers that a worker keeps: each scenario of a robust search has one.
MAX_SOLVERS = 128


@dataclass(frozen=True)
class SceneSpec:
    """A scene in plain data.

    Attributes:
        text: The scene as TOML.
        files: Contents of the files that it names, by their names.
    """

    text: str
    files: Mapping[str, bytes]

    def scene_in(self, folder: str) -> Scene:
        """Return the scene, with its files written to a folder.

        Raises:
            SceneError: See ``Scene.parse``.
        """
        for name, content in self.files.items():
            (Path(folder) / Path(name).name).write_bytes(content)
        return Scene.parse(self.text, "on a worker").in_folder(Path(folder))


@dataclass(frozen=True)
class SolverSpec:
    """The arguments of a :class:`PlateSolver`; specs are equal if their keys are.

    Attributes:
        scene: The scene, which has a grid.
        device: Device of the worker unless WARP_PLATE_DEVICE names one.
        path: See :class:`PlateSolver`, also for the others.
        areas: Weights (ny, nx) by name.
        key: By which workers know the solvers that they have made.
    """

    scene: SceneSpec = field(compare=False)
    device: str = field(compare=False)
    path: str = field(compare=False)
    areas: Mapping[str, np.ndarray] = field(compare=False)
    per_plate: PerPlate = field(compare=False)
    quantity: Quantity = field(compare=False)
    memory_share: float = field(compare=False)
    key: str = field(default_factory=lambda: uuid4().hex)


def scene_spec(scene: Scene) -> SceneSpec:
    """Return a scene in plain data.

    Raises:
        SceneError: A file that it names cannot be read.
    """
    files = {name: read_beside(key, name, scene.folder) for key, name in named_files(scene).items()}
    return SceneSpec(dump_scene(scene), files)


def solver_spec(
    scene: Scene,
    device: str = "auto",
    path: str = "auto",
    areas: Mapping[str, Region] = NO_AREAS,
    per_plate: PerPlate = NO_PER_PLATE,
    quantity: Quantity = "velocity",
    memory_share: float = 1.0,
) -> SolverSpec:
    """Return the spec of ``PlateSolver(scene, ...)``; for the arguments and errors see there."""
    weights = region_weights(scene, areas)[len(REGIONS) :]
    named = dict(zip(areas, weights, strict=True))
    return SolverSpec(scene_spec(scene), device, path, named, per_plate, quantity, memory_share)


@lru_cache(MAX_SOLVERS)
def make_solver(spec: SolverSpec) -> PlateSolver:
    """Return the solver, with one thread on a CPU unless WARP_PLATE_THREADS says another number.

    Raises:
        SceneError: See :class:`PlateSolver`.
    """
    with TemporaryDirectory() as folder:
        return PlateSolver(
            spec.scene.scene_in(folder),
            worker_device(spec.device),
            spec.path,
            threads=None if os.environ.get("WARP_PLATE_THREADS") else 1,
            areas=spec.areas,
            per_plate=spec.per_plate,
            quantity=spec.quantity,
            memory_share=spec.memory_share,
        )


def worker_device(device: str) -> str:
    """Return the device on which this worker runs plates, of a command that asks for ``device``."""
    return os.environ.get(DEVICE_VARIABLE) or device

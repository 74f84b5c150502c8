"""All that a worker needs to make a solver: the scene as TOML, the files that it names, and how it is to be made."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from warp_plate.cluster.frames import encode
from warp_plate.plate.designs import NO_PER_PLATE, PerPlate
from warp_plate.plate.files import named_files, read_beside
from warp_plate.plate.weights import NO_AREAS, REGIONS, Region, region_weights
from warp_plate.scene.dump import dump_scene
from warp_plate.scene.model import Scene
from warp_plate.solve.solver import PlateSolver
from warp_plate.solve.specialize import Quantity

# The device of a worker, whatever the recipe says: who starts workers knows which is whose.
DEVICE = "WARP_PLATE_DEVICE"


@dataclass(frozen=True)
class Recipe:
    """A :class:`PlateSolver` in plain data; files: contents by name; areas: weights (ny, nx) by name."""

    scene: str
    files: Mapping[str, bytes]
    device: str
    path: str
    areas: Mapping[str, np.ndarray]
    per_plate: PerPlate
    quantity: Quantity
    share: float

    @property
    def plain(self) -> dict[str, Any]:
        """For a task's payload."""
        return {one.name: getattr(self, one.name) for one in fields(self)} | {"per_plate": asdict(self.per_plate)}

    @staticmethod
    def from_plain(table: Mapping[str, Any]) -> Recipe:
        """What ``plain`` gave."""
        per_plate = dict(table["per_plate"])
        if per_plate["areas"] is not None:
            per_plate["areas"] = tuple(map(tuple, per_plate["areas"]))
        return Recipe(**{**table, "per_plate": PerPlate(**per_plate)})

    @cached_property
    def digest(self) -> str:
        """By which a worker knows it again."""
        return hashlib.sha256(b"".join(encode(self.plain))).hexdigest()


def recipe_of(
    scene: Scene,
    device: str = "auto",
    path: str = "auto",
    areas: Mapping[str, Region] = NO_AREAS,
    per_plate: PerPlate = NO_PER_PLATE,
    quantity: Quantity = "velocity",
    memory_share: float = 1.0,
) -> Recipe:
    """The recipe of ``PlateSolver(scene, ...)``; for the arguments and errors see there."""
    weights = region_weights(scene, areas)[len(REGIONS) :]
    named = dict(zip(areas, weights, strict=True))
    return Recipe(dump_scene(scene), contents_of(scene), device, path, named, per_plate, quantity, memory_share)


def contents_of(scene: Scene) -> dict[str, bytes]:
    """The files that a scene names, by their names.

    Raises:
        SceneError: see ``read_beside``.
    """
    return {name: read_beside(key, name, scene.folder) for key, name in named_files(scene).items()}


def scene_in(folder: str, text: str, files: Mapping[str, bytes]) -> Scene:
    """The scene of a TOML text, with the files that it names in a folder of its own.

    Raises:
        SceneError: see ``Scene.parse``.
    """
    for name, content in files.items():
        (Path(folder) / Path(name).name).write_bytes(content)
    return Scene.parse(text, "on a worker").in_folder(Path(folder))


def make_solver(recipe: Recipe) -> PlateSolver:
    """The solver, of one thread on a CPU, unless WARP_PLATE_THREADS says another number.

    Raises:
        SceneError: see :class:`PlateSolver`.
    """
    with TemporaryDirectory() as folder:
        return PlateSolver(
            scene_in(folder, recipe.scene, recipe.files),
            os.environ.get(DEVICE) or recipe.device,
            recipe.path,
            threads=None if os.environ.get("WARP_PLATE_THREADS") else 1,
            areas=recipe.areas,
            per_plate=recipe.per_plate,
            quantity=recipe.quantity,
            memory_share=recipe.share,
        )

"""One HDF5 file that holds a search between two of its iterations, so that it can go on as if it had never stopped.

    /swarm/positions, velocities, personal_positions, personal_losses, history
    /matrices                            energies of all drives of a linear scene (see warp_plate.solve.response)
    attributes of /: scene (with its grid) and asked (as written), both TOML, seed, evaluator, path, device, ...
    attributes of /swarm: format, random (JSON; the state of NumPy's bit generator), asked, improved_loss, improved_at

Behind the HDF5 content stands a seal, see ``warp_plate.result.whole``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from warp_plate.plate.weights import REGIONS
from warp_plate.result.plain import count, names_in, numbers, opened, put, save_hdf5, table, text
from warp_plate.result.whole import intact
from warp_plate.scene.errors import SceneError
from warp_plate.scene.load import dump_scene, parse_scene
from warp_plate.scene.model import Scene

FORMAT = "warp-plate checkpoint 1"
ENDING = ".checkpoint.h5"
PREVIOUS_ENDING = ".checkpoint.previous.h5"
# Arrays of the swarm: rows and columns, P particles, D numbers of a position.
ARRAYS = {
    "positions": ("P D", "1, rad", "magnitudes and phases of all actuators but the first"),
    "velocities": ("P D", "1, rad", "what a position moved by in the last iteration"),
    "personal_positions": ("P D", "1, rad", "best position of each particle"),
    "personal_losses": ("P", "1", "1 - localization factor there"),
    "history": ("any 4", "1", "after each iteration: best, mean and worst loss, and how many were not finite"),
}


@dataclass(frozen=True)
class Checkpoint:
    """A search between two iterations. With the device it fixes all that is still to come, to the last bit.

    asked: the scene as written; scene: the same with the grid that was chosen, where it asked for an accuracy.
    source: the scene's name. files: SHA-256 of the files that it names, by their keys. device: Warp's name;
    processor: its model; earlier: others that it ran on before, for people. path: as asked for.
    accuracy, seconds, versions: as in :class:`Result`, until here. node_steps: nodes updated × steps × plates.
    single: index of the best single actuator.
    matrices: (regions, 2 actuators, 2 actuators) of the response; None where the scene is not linear in its drives.
    swarm: the state of the swarm, see ``Swarm.state``, without its settings; None where one actuator leaves no choice.
    """

    asked: Scene
    scene: Scene
    source: str
    files: Mapping[str, str]
    device: str
    processor: str
    earlier: str
    path: str
    evaluator: str
    seed: int
    accuracy: Mapping[str, Any]
    seconds: Mapping[str, float]
    versions: Mapping[str, str]
    node_steps: int
    single: int
    matrices: np.ndarray | None
    swarm: Mapping[str, Any] | None

    @property
    def iterations(self) -> int:
        """How many are done."""
        return len(self.swarm["history"]) if self.swarm is not None else 0

    @property
    def progress(self) -> str:
        """For people."""
        return f"{self.iterations} of {self.scene.search.iterations} iterations"


def previous_of(path: Path) -> Path:
    """Where the checkpoint goes that stood at ``path`` before."""
    return path.parent / (path.name.removesuffix(".h5").removesuffix(".checkpoint") + PREVIOUS_ENDING)


def save_checkpoint(checkpoint: Checkpoint, path: Path, keep_previous: bool = False) -> None:
    """Write the file whole or not at all; ``keep_previous``: what was there goes to ``previous_of(path)``.

    Raises:
        SceneError: it cannot be written; what was there stays.
    """
    save_hdf5(lambda file: _write(file, checkpoint), path, previous_of(path) if keep_previous else None)


def load_checkpoint(path: str | Path) -> Checkpoint:
    """Read what :func:`save_checkpoint` wrote.

    Raises:
        SceneError: no such file, no checkpoint of this program, or damaged.
    """
    path = Path(path)
    with opened(path, FORMAT, "checkpoint") as file:
        return _read(file, str(path))


def load_newest(path: Path) -> tuple[Checkpoint, str | None]:
    """The checkpoint; or the one before it and a sentence that says so, where the file is damaged or missing.

    A whole file of another kind is neither: whoever names a result means the checkpoint, not the one before it.

    Raises:
        SceneError: neither can be read; says what is wrong with the first.
    """
    try:
        return load_checkpoint(path), None
    except SceneError as error:
        previous = previous_of(path)
        if previous == path or not previous.exists() or intact(path):
            raise
        try:
            checkpoint = load_checkpoint(previous)
        except SceneError:
            raise error from None
        return checkpoint, f"{error}; going on from {previous}, {checkpoint.progress}"


def _write(file: h5py.File, checkpoint: Checkpoint) -> None:
    for name in ("source", "device", "processor", "earlier", "path", "evaluator", "seed", "node_steps", "single"):
        file.attrs[name] = getattr(checkpoint, name)
    for name in ("asked", "scene"):
        file.attrs[name] = dump_scene(getattr(checkpoint, name))
    for name in ("accuracy", "files", "seconds", "versions"):
        file.attrs[name] = json.dumps(dict(getattr(checkpoint, name)))
    file.attrs["format"] = FORMAT
    if checkpoint.matrices is not None:
        put(file, "matrices", checkpoint.matrices, "J/(N/m^2)^2", "energy of each region by the drives' real parts")
    swarm = checkpoint.swarm
    if swarm is None:
        return
    arrays = {**swarm, "history": np.reshape(swarm["history"], (-1, 4))}  # which may be empty
    for name, (_, units, meaning) in ARRAYS.items():
        put(file, f"swarm/{name}", arrays[name], units, meaning)
    file["swarm"].attrs["format"] = swarm["format"]
    file["swarm"].attrs["random"] = json.dumps(swarm["random"])
    for name, kind in (("asked", int), ("improved_loss", float), ("improved_at", int)):
        file["swarm"].attrs[name] = kind(swarm[name])


def _read(file: h5py.File, name: str) -> Checkpoint:
    asked, scene = (
        parse_scene(text(file, key), f"{name}: its scene").in_folder(Path(name).parent) for key in ("asked", "scene")
    )
    if scene.grid.accuracy is not None:
        raise SceneError("attribute scene has no grid")
    actuators, single = len(scene.actuators), count(file, "single")
    if single >= actuators:
        raise SceneError(f"attribute single is {single}, of {actuators} actuators")
    if text(file, "evaluator") not in ("direct", "response") or scene.linear != ("matrices" in file):
        raise SceneError("evaluator and matrices do not fit the scene")
    return Checkpoint(
        asked=asked,
        scene=scene,
        source=text(file, "source"),
        files=table(file, "files"),
        device=text(file, "device"),
        processor=text(file, "processor"),
        earlier=text(file, "earlier"),
        path=text(file, "path"),
        evaluator=text(file, "evaluator"),
        seed=count(file, "seed"),
        accuracy=table(file, "accuracy"),
        seconds=table(file, "seconds"),
        versions=table(file, "versions"),
        node_steps=count(file, "node_steps"),
        single=single,
        matrices=numbers(file, "matrices", (len(REGIONS), *2 * (2 * actuators,))) if "matrices" in file else None,
        swarm=_read_swarm(file, scene) if names_in(file, "swarm") else None,
    )


def _read_swarm(file: h5py.File, scene: Scene) -> dict[str, Any]:
    lengths = {"P": scene.search.particles, "D": 2 * (len(scene.actuators) - 1), "any": None, "4": 4}
    arrays = {
        name: numbers(file, f"swarm/{name}", tuple(lengths[letter] for letter in shape.split()))
        for name, (shape, _, _) in ARRAYS.items()
    }
    group = file["swarm"]
    return {
        **arrays,
        "format": text(group, "format"),
        "random": table(group, "random"),
        "asked": bool(count(group, "asked")),
        "improved_loss": float(group.attrs["improved_loss"]),
        "improved_at": count(group, "improved_at"),
    }

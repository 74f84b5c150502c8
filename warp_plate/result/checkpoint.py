"""One HDF5 file that holds a search between two of its iterations, so that it can go on as if it had never stopped.

    /swarm/positions, history, ...       arrays of the search's state; see warp_plate.result.search_state
    /searches/0, ...                     of several targets, what was found for those before
    /matrices                            energies of all drives of a linear scene (see warp_plate.solve.response)
    attributes of /: scene (with its grid) and asked (as written), both TOML, seed, evaluator, path, device, ...
    attributes of /swarm: shapes, numbers  JSON of the arrays' shapes, and of the rest of the state

Behind the HDF5 content stands a seal, see ``warp_plate.result.atomic_io``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from warp_plate.result.atomic_io import is_intact
from warp_plate.result.model import TargetSearch
from warp_plate.result.safe_hdf5 import count, lost_of, numbers, opened, put, save_hdf5, table, text
from warp_plate.result.search_state import put_state, read_state
from warp_plate.result.several import put_several, read_several
from warp_plate.scene.dump import dump_scene
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

FORMAT = "warp-plate checkpoint 2"
ENDING = ".checkpoint.h5"
PREVIOUS_ENDING = ".checkpoint.previous.h5"


@dataclass(frozen=True)
class Checkpoint:
    """A search between two iterations. With the device it fixes all that is still to come, to the last bit.

    asked: the scene as written; scene: the same with the grid that was chosen, where it asked for an accuracy.
    source: the scene's name. files: SHA-256 of the files that it names, by their keys. device: Warp's name;
    processor: its model; earlier: others that it ran on before, for people. path: as asked for.
    accuracy, seconds, versions, lost: as in :class:`Result`, until here. node_steps: nodes updated × steps × plates.
    single: index of the best single actuator.
    matrices: (regions, 2 actuators, 2 actuators) of the response; None where energies are no quadratic forms of what is
        searched.
    swarm: the state of the search, see ``Swarm.state``; None where one actuator leaves no choice.
    several: of several targets, those that were searched before; ``scene`` is aimed at the one that is searched.
    """

    scene_as_written: Scene
    scene: Scene
    source: str
    files: Mapping[str, str]
    device: str
    processor: str
    earlier_devices: str
    path: str
    evaluator: str
    seed: int
    accuracy: Mapping[str, Any]
    seconds: Mapping[str, float]
    versions: Mapping[str, str]
    node_steps: int
    single_actuator: int
    matrices: np.ndarray | None
    search_state: Mapping[str, Any] | None
    finished_searches: tuple[TargetSearch, ...] = ()
    lost_plates: Mapping[str, int] = field(default_factory=dict)

    @property
    def iterations(self) -> int:
        """How many are done."""
        return len(self.search_state["history"]) if self.search_state is not None else 0

    @property
    def progress(self) -> str:
        """For people."""
        done = f"{self.iterations} of {self.scene.search.iterations} iterations"
        targets = self.scene.targets
        if not targets:
            return done
        index = len(self.finished_searches)
        return f"{done} of target {index + 1} of {len(targets)} ({targets[index].name!r})"


def previous_path(path: Path) -> Path:
    """Where the checkpoint goes that stood at ``path`` before."""
    return path.parent / (path.name.removesuffix(".h5").removesuffix(".checkpoint") + PREVIOUS_ENDING)


def save_checkpoint(checkpoint: Checkpoint, path: Path, keep_previous: bool = False) -> None:
    """Write the file whole or not at all; ``keep_previous``: what was there goes to ``previous_path(path)``.

    Raises:
        SceneError: it cannot be written; what was there stays.
    """
    save_hdf5(lambda file: _write(file, checkpoint), path, previous_path(path) if keep_previous else None)


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
        previous = previous_path(path)
        if previous == path or not previous.exists() or is_intact(path):
            raise
        try:
            checkpoint = load_checkpoint(previous)
        except SceneError:
            raise error from None
        return checkpoint, f"{error}; going on from {previous}, {checkpoint.progress}"


def _write(file: h5py.File, checkpoint: Checkpoint) -> None:
    for name in ("source", "device", "processor", "path", "evaluator", "seed", "node_steps"):
        file.attrs[name] = getattr(checkpoint, name)
    file.attrs.update({"earlier": checkpoint.earlier_devices, "single": checkpoint.single_actuator})
    file.attrs["asked"] = dump_scene(checkpoint.scene_as_written)
    file.attrs["scene"] = dump_scene(checkpoint.scene)
    file.attrs["lost"] = json.dumps(dict(checkpoint.lost_plates))
    for name in ("accuracy", "files", "seconds", "versions"):
        file.attrs[name] = json.dumps(dict(getattr(checkpoint, name)))
    file.attrs["format"] = FORMAT
    if checkpoint.matrices is not None:
        put(file, "matrices", checkpoint.matrices, "J/(N/m^2)^2", "energy of each region by the drives' real parts")
    if checkpoint.search_state is not None:
        put_state(file, "swarm", checkpoint.search_state)
    put_several(file, checkpoint.finished_searches)


def _read(file: h5py.File, name: str) -> Checkpoint:
    asked, scene = (
        Scene.parse(text(file, key), f"{name}: its scene").in_folder(Path(name).parent) for key in ("asked", "scene")
    )
    if scene.grid.accuracy is not None:
        raise SceneError("attribute scene has no grid")
    actuators, single = len(scene.actuators), count(file, "single")
    if single >= actuators:
        raise SceneError(f"attribute single is {single}, of {actuators} actuators")
    if text(file, "evaluator") not in ("direct", "response") or (not scene.linear and "matrices" in file):
        raise SceneError("evaluator and matrices do not fit the scene")
    several = read_several(file)
    if several and (
        len(several) >= len(scene.targets) or scene.target != scene.targets[len(several)].unnamed
    ):
        raise SceneError(f"{len(several)} searches do not fit the scene's targets")
    return Checkpoint(
        scene_as_written=asked,
        scene=scene,
        source=text(file, "source"),
        files=table(file, "files"),
        device=text(file, "device"),
        processor=text(file, "processor"),
        earlier_devices=text(file, "earlier"),
        path=text(file, "path"),
        evaluator=text(file, "evaluator"),
        seed=count(file, "seed"),
        accuracy=table(file, "accuracy"),
        seconds=table(file, "seconds"),
        versions=table(file, "versions"),
        node_steps=count(file, "node_steps"),
        single_actuator=single,
        matrices=numbers(file, "matrices", (None, *2 * (2 * actuators,))) if "matrices" in file else None,
        search_state=read_state(file, "swarm") if "swarm" in file else None,
        finished_searches=several,
        lost_plates=lost_of(file),
    )

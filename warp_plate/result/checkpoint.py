"""Checkpoint files: HDF5 files of a search between two iterations, from which it continues bit for bit.

The state of the optimizer is the group ``swarm`` whatever the method; finished searches for earlier targets are
``searches/0``, ``searches/1``, ...
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from warp_plate.result.hdf5 import FileFormat
from warp_plate.result.layouts import Attribute, Counts, Dataset, SearchState, read_fields, write_fields
from warp_plate.result.model import TargetSearch
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

FORMAT = FileFormat("checkpoint", 3)
ENDING = ".checkpoint.h5"


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """A search between two iterations. Together with the device it determines the rest of the search to the last bit.

    Attributes without a comment are those of :class:`Result`, so far.
    """

    scene_as_written: Annotated[Scene, "asked"]
    scene: Scene  # with its grid, aimed at the target that is being searched
    source: str
    files: Mapping[str, str]  # SHA-256 digests of the files that the scene names, by their keys
    device: str
    processor: str
    earlier_devices: Annotated[str, "earlier"]  # other devices that the search ran on before, for people
    path: str  # kernels that were asked for
    evaluator: Annotated[str, Attribute(Literal["direct", "response", "modal"])]
    seed: int
    accuracy: Mapping[str, Any]
    seconds: Mapping[str, float]
    versions: Mapping[str, str]
    node_steps: int
    single_actuator: Annotated[int, "single"]
    # (regions, 2 actuators, 2 actuators) Gram matrices of the response; None for other evaluators
    matrices: Annotated[
        np.ndarray | None,
        Dataset("J/(N/m^2)^2", "energy of each region by the drives' real parts", (None, "parts", "parts")),
    ]
    # State of the optimizer; None if a single actuator leaves nothing to search
    search_state: Annotated[Mapping[str, Any] | None, SearchState(), "swarm"]
    finished_searches: Annotated[tuple[TargetSearch, ...], "searches"] = ()  # for earlier targets
    lost_plates: Annotated[Counts, "lost"] = field(default_factory=dict)

    @property
    def iterations(self) -> int:
        return len(self.search_state["history"]) if self.search_state is not None else 0

    @property
    def progress(self) -> str:
        """Description of the progress, for people."""
        done = f"{self.iterations} of {self.scene.search.iterations} iterations"
        targets, index = self.scene.targets, len(self.finished_searches)
        return f"{done} of target {index + 1} of {len(targets)} ({targets[index].name!r})" if targets else done


def save_checkpoint(checkpoint: Checkpoint, path: Path) -> None:
    """Write a checkpoint file atomically, or raise a SceneError."""
    with FORMAT.create(path) as file:
        write_fields(file, checkpoint)


def load_checkpoint(path: str | Path) -> Checkpoint:
    """Read a checkpoint, or raise a SceneError if the file is missing, damaged or not a checkpoint."""
    with FORMAT.open(path) as file:
        checkpoint = read_fields(Checkpoint, file)
        _check_numbers(checkpoint)
    return checkpoint


def _check_numbers(checkpoint: Checkpoint) -> None:
    """Raise a SceneError if numbers that a search goes on from are not finite, or no index of an actuator."""
    finished = checkpoint.finished_searches
    arrays = {"matrices": checkpoint.matrices, **{f"searches/{i}/position": s.position for i, s in enumerate(finished)}}
    for name, values in arrays.items():
        if values is not None and not np.isfinite(values).all():
            raise SceneError(f"{name} must be finite")
    count = len(checkpoint.scene.actuators)
    for single in (checkpoint.single_actuator, *(search.single_actuator for search in finished)):
        if single >= count:
            raise SceneError(f"single = {single}: must be the index of one of {count} actuators")

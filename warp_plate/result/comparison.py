"""Comparison files: HDF5 files of trials of several methods on one scene.

Trials are the groups ``trials/METHOD/SEED`` with a dataset for each column.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np

from warp_plate.result.hdf5 import FileFormat, member
from warp_plate.result.layouts import ELSEWHERE, Attribute, Counts, Dataset, read_fields, write_fields
from warp_plate.scene.model import Scene

FORMAT = FileFormat("comparison", 1)
METHODS = Attribute(tuple[str, ...])


@dataclass(frozen=True, eq=False)
class Trial:
    """A run of one method from one seed."""

    method: Annotated[str, ELSEWHERE]
    seed: Annotated[int, ELSEWHERE]
    evaluations: Annotated[np.ndarray, Dataset("1", "positions tried so far, after each iteration", ("iteration",))]
    seconds: Annotated[np.ndarray, Dataset("s", "time of the method and its evaluations so far", ("iteration",))]
    loss: Annotated[np.ndarray, Dataset("1", "smallest loss so far, after each iteration", ("iteration",))]

    @property
    def best_loss(self) -> float:
        return float(self.loss[-1])


@dataclass(frozen=True)
class MethodComparison:
    """Trials of several methods on one scene.

    Attributes:
        scene: The scene, with the grid that was used.
        budget: Number of evaluations that each trial may make.
        seconds: Wall time before any trial [s]: "prepare", which the Gram matrices took.
        localization: True if the loss is 1 − localization factor.
        bound: Lower bound of the loss over all drives; None if unknown.
        bound_kind: "attained", "bound only", or "".
        skipped: Reasons why methods were not tried, by method.

    Other attributes are those of :class:`Result`.
    """

    source: str
    scene: Scene
    device: str
    evaluator: str
    budget: int
    seconds: Mapping[str, float]
    localization: bool
    trials: Annotated[tuple[Trial, ...], ELSEWHERE]
    bound: Annotated[float | None, Dataset("1", "lower bound of the loss")] = None
    bound_kind: str = ""
    bound_sentence: str = ""
    skipped: Mapping[str, str] = field(default_factory=dict)
    interrupted: bool = False
    versions: Mapping[str, str] = field(default_factory=dict)
    lost_plates: Annotated[Counts, "lost"] = field(default_factory=dict)

    @property
    def methods(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(trial.method for trial in self.trials))

    def trials_of(self, method: str) -> list[Trial]:
        return [trial for trial in self.trials if trial.method == method]


def save_comparison(comparison: MethodComparison, path: str | Path) -> Path:
    """Write a comparison file atomically and return its path, or raise a SceneError."""
    with FORMAT.create(path) as file:
        write_fields(file, comparison)
        METHODS.write(file, "methods", comparison.methods)
        for trial in comparison.trials:
            write_fields(file.create_group(f"trials/{trial.method}/{trial.seed}"), trial)
    return Path(path)


def load_comparison(path: str | Path) -> MethodComparison:
    """Read a comparison, or raise a SceneError if the file is missing, damaged or not a comparison."""
    with FORMAT.open(path) as file:
        trials = []
        for method in METHODS.read(file, "methods", {}):
            group = member(file, f"trials/{method}")
            for seed in sorted(map(int, group)):
                trials.append(read_fields(Trial, member(group, str(seed)), method=method, seed=seed))
        return read_fields(MethodComparison, file, trials=tuple(trials))

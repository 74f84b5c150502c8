"""What several methods found in one scene, in one HDF5 file.

    /trials/METHOD/SEED/evaluations, seconds, loss     after each iteration
    attributes of /: source, scene (TOML), device, evaluator, budget, bound, skipped, versions, ...
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np

from warp_plate.result.safe_hdf5 import count, lost_of, names_in, numbers, opened, put, save_hdf5, table, text
from warp_plate.scene.dump import dump_scene
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

FORMAT = "warp-plate comparison 1"
COLUMNS = {
    "evaluations": ("1", "positions tried so far"),
    "seconds": ("s", "time of the method and of its evaluations so far"),
    "loss": ("1", "smallest loss so far"),
}


@dataclass(frozen=True)
class Trial:
    """One method from one seed; arrays have an entry for each iteration, see COLUMNS."""

    method: str
    seed: int
    evaluations: np.ndarray
    seconds: np.ndarray
    loss: np.ndarray

    @property
    def best_loss(self) -> float:
        """The smallest loss."""
        return float(self.loss[-1])


@dataclass(frozen=True)
class Comparison:
    """evaluator: "response" or "direct"; budget: evaluations that each trial may make; prepared: seconds that the Gram
    matrices took, before any trial; localization: whether a loss is 1 − LF; bound: loss that no drive can have less of,
    None where none is claimed, with its kind ("attained" or "bound only") and sentence; skipped: by method, why it was
    not tried; lost: plates whose workers failed for good, by what went wrong.
    """

    source: str
    scene: Scene
    device: str
    evaluator: str
    budget: int
    seconds: Mapping[str, float]
    localization: bool
    trials: tuple[Trial, ...]
    bound: float | None = None
    bound_kind: str = ""
    bound_sentence: str = ""
    skipped: Mapping[str, str] = field(default_factory=dict)
    interrupted: bool = False
    versions: Mapping[str, str] = field(default_factory=dict)
    lost_plates: Mapping[str, int] = field(default_factory=dict)

    @property
    def methods(self) -> tuple[str, ...]:
        """Those that were tried, in their order."""
        return tuple(dict.fromkeys(trial.method for trial in self.trials))

    def trials_of(self, method: str) -> list[Trial]:
        """The trials of a method."""
        return [trial for trial in self.trials if trial.method == method]


def save_comparison(comparison: Comparison, path: str | Path) -> Path:
    """Write the file whole or not at all.

    Raises:
        SceneError: the folder is missing or cannot be written to, or the disk is full.
    """
    path = Path(path)
    save_hdf5(lambda file: _write(file, comparison), path)
    return path


def load_comparison(path: str | Path) -> Comparison:
    """Read what :func:`save_comparison` wrote.

    Raises:
        SceneError: no such file, not a comparison of this program, or damaged.
    """
    path = Path(path)
    with opened(path, FORMAT, "comparison") as file:
        scene = Scene.parse(text(file, "scene"), f"{path}: its scene").in_folder(path.parent)
        return _read(file, scene)


def _write(file: h5py.File, comparison: Comparison) -> None:
    file.attrs.update(
        {
            "format": FORMAT,
            "source": comparison.source,
            "scene": dump_scene(comparison.scene),
            "device": comparison.device,
            "evaluator": comparison.evaluator,
            "budget": comparison.budget,
            "seconds": json.dumps(dict(comparison.seconds)),
            "localization": int(comparison.localization),
            "bound_kind": comparison.bound_kind,
            "bound_sentence": comparison.bound_sentence,
            "methods": json.dumps(list(comparison.methods)),
            "skipped": json.dumps(dict(comparison.skipped)),
            "interrupted": int(comparison.interrupted),
            "versions": json.dumps(dict(comparison.versions)),
            "lost": json.dumps(dict(comparison.lost_plates)),
        }
    )
    if comparison.bound is not None:
        put(file, "bound", comparison.bound, "1", "loss that no drive can have less of")
    for trial in comparison.trials:
        for name, (unit, long_name) in COLUMNS.items():
            at = f"trials/{trial.method}/{trial.seed}/{name}"
            put(file, at, getattr(trial, name), unit, f"{long_name}, after each iteration")


def _read(file: h5py.File, scene: Scene) -> Comparison:
    trials = []
    for method in map(str, table(file, "methods", list)):
        seeds = names_in(file, f"trials/{method}")
        if not seeds or not all(seed.isdecimal() for seed in seeds):
            raise SceneError(f"trials/{method} is missing, empty, or its members are no seeds")
        for seed in sorted(map(int, seeds)):
            columns = [numbers(file, f"trials/{method}/{seed}/{name}", (None,)) for name in COLUMNS]
            if len({len(values) for values in columns}) > 1 or not len(columns[0]):
                raise SceneError(f"trials/{method}/{seed} has columns of different length, or empty ones")
            trials.append(Trial(method, seed, *columns))
    return Comparison(
        source=text(file, "source"),
        scene=scene,
        device=text(file, "device"),
        evaluator=text(file, "evaluator"),
        budget=count(file, "budget"),
        seconds=table(file, "seconds"),
        localization=bool(count(file, "localization")),
        trials=tuple(trials),
        bound=float(numbers(file, "bound", ())) if "bound" in file else None,
        bound_kind=text(file, "bound_kind"),
        bound_sentence=text(file, "bound_sentence"),
        skipped=table(file, "skipped"),
        interrupted=bool(count(file, "interrupted")),
        versions=table(file, "versions"),
        lost_plates=lost_of(file),
    )

"""Files that hold a study while it runs, and the devices and versions that a study which continues depends on."""

from __future__ import annotations

import platform
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from glob import escape
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import warp as wp

from warp_plate._version import __version__
from warp_plate.modal.solver import ModalSolver
from warp_plate.problem.problem import Problem
from warp_plate.result.atomic_io import is_intact
from warp_plate.result.checkpoint import Checkpoint, previous_path, save_checkpoint
from warp_plate.result.sweep import Sweep, save_sweep
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import device_aliases, find_device, processor_of
from warp_plate.solve.run import Run
from warp_plate.solve.solver import PlateSolver

# Default interval between two checkpoints [s].
EVERY = 30.0
Study = TypeVar("Study", Checkpoint, Sweep)


class StudyFile(Generic[Study]):
    """A file that holds a study while it runs.

    Args:
        every: least seconds between two saves; 0 saves whenever possible, infinity only when the study is interrupted.
        resumes: True if the study continues from the file. If not, the file is not kept as the previous one.
        warn: called with one line if the file cannot be written. The study then continues, and the last file stays.

    Attributes:
        saved: study that was written last, or None.

    Raises:
        SceneError: ``every`` is negative or NaN.
    """

    def __init__(
        self, path: Path, every: float = EVERY, resumes: bool = False, warn: Callable[[str], object] = warnings.warn
    ) -> None:
        if not every >= 0:
            raise SceneError(f"checkpoint-every = {every:g}: must be a number of seconds, 0 or more")
        self.path, self.every = path, every
        self.saved: Study | None = None
        self._resumes, self._warn = resumes, warn
        self._keep_previous = resumes and is_intact(path)
        self._signature = _signature(path)
        self._taken = self._warned = False
        self._last = time.monotonic()

    def due(self) -> bool:
        """Return whether ``every`` seconds have passed since the last save."""
        return time.monotonic() - self._last >= self.every

    def save(self, study: Study) -> None:
        """Write the study atomically; on failure warn once and keep the last file.

        A file that another process has written since is no longer touched.
        """
        self._last = time.monotonic()
        if self._taken_by_another():
            return
        try:
            if isinstance(study, Checkpoint):
                save_checkpoint(study, self.path, self._keep_previous)
            else:
                save_sweep(study, self.path)
            if self.saved is None and not self._resumes:
                previous_path(self.path).unlink(missing_ok=True)  # left by another study
        except (SceneError, OSError) as error:
            if not self._warned:
                self._warn(f"{error}; continuing without")
            self._warned = True
            return
        self.saved, self._keep_previous, self._warned = study, True, False
        self._signature = _signature(self.path)

    def remove(self) -> None:
        """Delete the file, the previous one, and temporary files that killed processes left."""
        if self._taken_by_another():
            return
        left: Iterable[Path] = self.path.parent.glob(f".{escape(self.path.name)}.*.part.h5")
        for path in (self.path, previous_path(self.path), *left):
            path.unlink(missing_ok=True)

    def _taken_by_another(self) -> bool:
        """Return whether another process has written the file since; warn once if it has."""
        if not self._taken and _signature(self.path) not in (None, self._signature):
            self._taken, self.saved = True, None
            self._warn(
                f"{self.path} was written by another process; continuing without checkpoints: give each run a result "
                "file of its own"
            )
        return self._taken


class CheckpointFile(StudyFile[Checkpoint]):
    """File from which a search can be resumed; the previous one is kept as ``previous_path(path)``."""


class SweepFile(StudyFile[Sweep]):
    """The file that holds the finished points of a sweep until all are done."""


def _signature(path: Path) -> tuple[int, ...] | None:
    """Return numbers that change when the file is replaced; None if there is no file."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_ino, status.st_mtime_ns, status.st_size


def device_name(device: wp.Device) -> str:
    """Return the alias of a device with the name of the GPU or the processor's architecture."""
    return f"{device.alias} ({device.name or platform.machine()})"


def run_fields(solver: PlateSolver | ModalSolver, run: Run) -> dict[str, Any]:
    """Return the fields of a result about how a run was computed and when."""
    path = solver.describe_path(bool(solver.scene.record.points))
    return {"effects": solver.effects, "path": path, "times": run.times, "trace_times": run.trace_times}


def devices_text(problem: Problem) -> str:
    """Return the device of a problem, and the workers that ran the plates of its search."""
    text = device_name(problem.drive_solver.device)
    if problem.pool is None:
        return text
    if problem.evaluator_name == "response":
        return f"{text}; {problem.pool.description}: unused, since Gram matrices need no plates for the search"
    return f"{text}, plates of the search on {problem.pool.description}"


def versions() -> dict[str, str]:
    """Return the versions of everything that results depend on."""
    return {
        "warp_plate": __version__,
        "warp": wp.config.version,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }


def merged_versions(earlier: Mapping[str, str]) -> dict[str, str]:
    """Return the current versions, each after the earlier ones that differ from it."""
    return {
        name: earlier[name] if earlier.get(name, now).split(", then ")[-1] == now else f"{earlier[name]}, then {now}"
        for name, now in versions().items()
        if name in earlier
    }


def same_device(device: str, processor: str, study: str) -> str:
    """Return the alias of a device on this machine with the same kind of processor; ``study``: "search" or "sweep"."""
    for alias in (device, *(alias for alias in device_aliases() if alias != device)):
        if alias in device_aliases() and processor_of(find_device(alias)) == processor:
            return alias
    raise SceneError(
        f"the {study} began on {device} ({processor}), which this machine does not have; another device rounds "
        f"differently, so the result would not be bit-identical: to continue anyway, name one, such as "
        f"--device {find_device('auto').alias}"
    )


def check_files(files: Mapping[str, str], study: Checkpoint | Sweep, what: str) -> None:
    """Check that files, given by their digests, are still those that a study began with."""
    for key, digest in files.items():
        if study.files.get(key) != digest:
            raise SceneError(f"{key}: the file has changed since the {what} began")


def check_unchanged(
    study: object, name: str, options: Mapping[str, object], scenes: tuple[Scene | None, Scene], advice: str
) -> None:
    """Check that options and a scene given to resume a study are those that it began with.

    Args:
        name: kind and file of the study, for errors.
        options: values by the names of the study's attributes; None for those not given.
        scenes: the scene that is given, or None, and the original one.
        advice: what else the user can do, for errors.
    """
    changed = {
        f"--{option} {value}": getattr(study, option)
        for option, value in options.items()
        if value not in (None, getattr(study, option))
    }
    if scenes[0] is not None:
        given, original = (dict(_leaves(scene.model_dump())) for scene in scenes if scene is not None)
        keys = [key for key in {"grid.accuracy": None, **original, **given} if given.get(key) != original.get(key)]
        changed |= {f"{key} = {given.get(key)}": original.get(key) for key in keys}
    for difference, before in changed.items():
        raise SceneError(
            f"{difference}: the {name} began with {before} and continues with nothing else; leave it out, or {advice}"
        )


def changes(study: Checkpoint | Sweep, device: str | None) -> list[str]:
    """Return a line for each change since a study began, also of the device (None: unknown or the same), that may
    change the last digits of its result."""
    lines = []
    if device is not None and (processor := processor_of(find_device(device))) != study.processor:
        lines.append(
            f"began on {study.device} ({study.processor}) and continues on {device} ({processor}), which rounds "
            "differently: the result may differ"
        )
    for name, now in versions().items():
        before = study.versions.get(name, "another version")
        if before != now:
            lines.append(f"began with {name} {before}, this is {now}: the result may differ in its last digits")
    return lines


def _leaves(table: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, object]]:
    """Yield (dotted key, value) for all values in nested tables and lists of tables."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{prefix}{key}.")
        elif isinstance(value, tuple) and value and all(isinstance(entry, dict) for entry in value):
            for index, entry in enumerate(value):
                yield from _leaves(entry, f"{prefix}{key}[{index}].")
        else:
            yield f"{prefix}{key}", value

"""Files that hold a study while it runs, and the devices and versions that a study which continues depends on."""

import logging
import platform
import time
from collections.abc import Mapping
from glob import escape
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from warp_plate._version import __version__
from warp_plate.modal.solver import ModalSolver
from warp_plate.problem.problem import Problem
from warp_plate.result.checkpoint import Checkpoint, save_checkpoint
from warp_plate.result.sweep import Sweep, save_sweep
from warp_plate.scene.errors import SceneError
from warp_plate.solve.devices import device_aliases, find_device, processor_of
from warp_plate.solve.run import Run
from warp_plate.solve.solver import PlateSolver

# Default interval between two checkpoints [s].
EVERY = 30.0


class CheckpointFile:
    """The file that holds an unfinished search or sweep.

    If it cannot be written, the logger "warp_plate" gets a line, the study continues, and the last file stays.

    Args:
        every: least seconds between two saves; 0 saves whenever possible, infinity only when the study is interrupted.

    Attributes:
        saved: study that was written last, or None.

    Raises:
        SceneError: ``every`` is negative or NaN.
    """

    def __init__(self, path: Path, every: float = EVERY) -> None:
        if not every >= 0:
            raise SceneError(f"checkpoint-every = {every:g}: must be a number of seconds, 0 or more")
        self.path, self.every = path, every
        self.saved: Checkpoint | Sweep | None = None
        self._warned = False
        self._last = time.monotonic()

    def due(self) -> bool:
        """Return whether ``every`` seconds have passed since the last save."""
        return time.monotonic() - self._last >= self.every

    def save(self, study: Checkpoint | Sweep) -> None:
        """Write the study atomically; on failure warn once and keep the last file."""
        self._last = time.monotonic()
        try:
            if isinstance(study, Checkpoint):
                save_checkpoint(study, self.path)
            else:
                save_sweep(study, self.path)
        except (SceneError, OSError) as error:
            if not self._warned:
                logging.getLogger("warp_plate").warning("%s; continuing without", error)
            self._warned = True
            return
        self.saved, self._warned = study, False

    def remove(self) -> None:
        """Delete the file, and temporary files that killed processes left."""
        for path in (self.path, *self.path.parent.glob(f".{escape(self.path.name)}.*.part.h5")):
            path.unlink(missing_ok=True)


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


def device_like(study: Checkpoint | Sweep) -> str:
    """Return the alias of a device with the kind of processor that a study ran on, or "auto" if there is none."""
    aliases = sorted(device_aliases(), key=lambda alias: alias != study.device)
    return next((alias for alias in aliases if processor_of(find_device(alias)) == study.processor), "auto")


def changes(study: Checkpoint | Sweep, device: str | None) -> list[str]:
    """Return a line for each change since a study began, also of the device (None: unknown), that may change the last
    digits of its result."""
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

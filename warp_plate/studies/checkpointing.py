"""Files that hold a search or a sweep while it runs."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable
from glob import escape
from pathlib import Path
from typing import Generic, TypeVar

from warp_plate.result.atomic_io import is_intact
from warp_plate.result.checkpoint import Checkpoint, previous_path, save_checkpoint
from warp_plate.result.sweep import Sweep, save_sweep
from warp_plate.scene.errors import SceneError

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
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns, found.st_size

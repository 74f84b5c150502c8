"""When a search leaves a checkpoint, and where."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from glob import escape
from pathlib import Path

from warp_plate.result.atomic_io import is_intact
from warp_plate.result.checkpoint import Checkpoint, previous_path, save_checkpoint
from warp_plate.scene.errors import SceneError

# Seconds between two checkpoints.
EVERY = 30.0


class CheckpointFile:
    """The file that a search can go on from.

    Args:
        path: of the file; the one before it is kept as ``previous_path(path)``.
        every: seconds between two, at least; 0: one after each iteration; infinite: only when Ctrl-C ends the search.
        resumes: whether the search goes on from what is there. If not, that is replaced, not kept as the previous one.
        warn: called with one line when a file cannot be written. The search then goes on, and the last one stays.

    Raises:
        SceneError: ``every`` is no number of seconds.
    """

    def __init__(
        self,
        path: Path,
        every: float = EVERY,
        resumes: bool = False,
        warn: Callable[[str], object] = warnings.warn,
    ) -> None:
        if not every >= 0:
            raise SceneError(f"checkpoint-every = {every:g}: must be a number of seconds, 0 or more")
        self.path = path
        self.every = every
        self.saved: Checkpoint | None = None  # the last one that was written
        self._goes_on = resumes
        self._keep = resumes and is_intact(path)
        self._seen = _mark(path)
        self._lost = False
        self._warn = warn
        self._warned = False
        self._last = time.monotonic()

    def due(self) -> bool:
        """Whether it is time for the next."""
        return time.monotonic() - self._last >= self.every

    def save(self, checkpoint: Checkpoint) -> None:
        """Write it whole, and keep the one before; where that fails, say so once and keep both.

        A file that another search has written since is left alone: its name is that search's from then on.
        """
        self._last = time.monotonic()
        if self._another_writes():
            return
        try:
            save_checkpoint(checkpoint, self.path, self._keep)
            if self.saved is None and not self._goes_on:
                previous_path(self.path).unlink(missing_ok=True)  # of another search
        except (SceneError, OSError) as error:
            if not self._warned:
                self._warn(f"{error}; the search goes on")
            self._warned = True
            return
        self.saved, self._keep, self._warned = checkpoint, True, False
        self._seen = _mark(self.path)

    def remove(self) -> None:
        """Away with the file, the one before it, and what a killed process left of one: the search is done."""
        if self._another_writes():
            return
        left = self.path.parent.glob(f".{escape(self.path.name)}.*.part.h5")
        for path in (self.path, previous_path(self.path), *left):
            path.unlink(missing_ok=True)

    def _another_writes(self) -> bool:
        """Whether the file is another search's by now, which is said once."""
        found = _mark(self.path)
        if not self._lost and found not in (None, self._seen):
            self._lost, self.saved = True, None
            self._warn(
                f"{self.path} is written by another search; this one goes on without checkpoints: give each search a "
                "result file of its own"
            )
        return self._lost


def _mark(path: Path) -> tuple[int, ...] | None:
    """What changes when a file is written anew; None where there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns, found.st_size

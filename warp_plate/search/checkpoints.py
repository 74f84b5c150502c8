"""When a search leaves a checkpoint, and where."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from glob import escape
from pathlib import Path

from warp_plate.result.checkpoint import Checkpoint, previous_of, save_checkpoint
from warp_plate.result.whole import check_seal
from warp_plate.scene.errors import SceneError

# Seconds between two checkpoints.
EVERY = 30.0


class CheckpointFile:
    """The file that a search can go on from.

    Args:
        path: of the file; the one before it is kept as ``previous_of(path)``.
        every: seconds between two, at least; 0: one after each iteration; infinite: only when Ctrl-C ends the search.
        goes_on: whether the search goes on from what is there. If not, that is replaced, not kept as the previous one.
        warn: told in one line when a file cannot be written. The search then goes on, and the last one stays.

    Raises:
        SceneError: ``every`` is no number of seconds.
    """

    def __init__(
        self,
        path: Path,
        every: float = EVERY,
        goes_on: bool = False,
        warn: Callable[[str], object] = warnings.warn,
    ) -> None:
        if not every >= 0:
            raise SceneError(f"checkpoint-every = {every:g}: must be a number of seconds, 0 or more")
        self.path = path
        self.every = every
        self.saved: Checkpoint | None = None  # the last one that was written
        self._goes_on = goes_on
        self._keep = goes_on and _intact(path)
        self._warn = warn
        self._warned = False
        self._last = time.monotonic()

    def due(self) -> bool:
        """Whether it is time for the next."""
        return time.monotonic() - self._last >= self.every

    def save(self, checkpoint: Checkpoint) -> None:
        """Write it whole, and keep the one before; where that fails, say so once and keep both."""
        self._last = time.monotonic()
        try:
            save_checkpoint(checkpoint, self.path, self._keep)
            if self.saved is None and not self._goes_on:
                previous_of(self.path).unlink(missing_ok=True)  # of another search
        except (SceneError, OSError) as error:
            if not self._warned:
                self._warn(f"{error}; the search goes on")
            self._warned = True
            return
        self.saved, self._keep, self._warned = checkpoint, True, False

    def remove(self) -> None:
        """Away with the file, the one before it, and what a killed process left of one: the search is done."""
        left = self.path.parent.glob(f".{escape(self.path.name)}.*.part.h5")
        for path in (self.path, previous_of(self.path), *left):
            path.unlink(missing_ok=True)


def _intact(path: Path) -> bool:
    try:
        check_seal(path)
    except (OSError, SceneError):
        return False
    return True

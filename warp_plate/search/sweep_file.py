"""The file that a sweep is kept in while it runs, and from which it goes on."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from warp_plate.plate.files import digests
from warp_plate.result.sweep import Sweep, load_sweep, save_sweep
from warp_plate.scene.errors import SceneError
from warp_plate.search.checkpoints import EVERY
from warp_plate.search.localize import same_device, with_earlier
from warp_plate.solve.devices import find_device, processor_of


class SweepFile:
    """What ``run_sweep`` keeps its points in: the result file itself, written whole each time.

    Args:
        path: of the file.
        every: seconds between two writings, at least; 0: after each point; infinite: at the end, and after Ctrl-C.
        warn: told in one line when the file cannot be written. The sweep then goes on.

    Raises:
        SceneError: ``every`` is no number of seconds.
    """

    def __init__(self, path: Path, every: float = EVERY, warn: Callable[[str], object] = warnings.warn) -> None:
        if not every >= 0:
            raise SceneError(f"checkpoint-every = {every:g}: must be a number of seconds, 0 or more")
        self.path = path
        self.every = every
        self.saved: Sweep | None = None  # the last one that was written
        self._warn = warn
        self._warned = False
        self._last = time.monotonic()

    def __call__(self, sweep: Sweep, last: bool) -> None:
        """Write it where it is time, or ``last``; nothing while no point is run."""
        if len(sweep.left) == len(sweep.plan) or not (last or time.monotonic() - self._last >= self.every):
            return
        self._last = time.monotonic()
        try:
            save_sweep(sweep, self.path)
        except SceneError as error:
            if not self._warned:
                self._warn(f"{error}; the sweep goes on")
            self._warned = True
            return
        self.saved, self._warned = sweep, False


def unfinished_sweep(path: Path) -> Sweep | None:
    """The sweep in a file, where it has points that are not run; None where the file is another, or there is none."""
    try:
        found = load_sweep(path) if path.is_file() else None
    except SceneError:
        return None
    return None if found is None or found.finished else found


def continued(begun: Sweep, device: str | None = None, there: bool = False) -> Sweep:
    """A sweep as it goes on.

    Args:
        device: of this process, another than it began on: its rounding may be another; left out: one of the same kind.
        there: the points that are left run on a pool's workers instead, who say on what (see ``run_sweep``).

    Raises:
        SceneError: there is no such device any more, or a file that the scene names is missing or another.
    """
    for key, digest in digests(begun.scene).items():
        if begun.files.get(key) != digest:
            raise SceneError(f"{key}: the file holds something else than when the sweep began")
    if begun.finished:
        return begun
    begun = replace(begun, versions=with_earlier(begun.versions))
    if there:
        return begun
    if device is None:
        device = same_device(begun.device, begun.processor, "sweep") if begun.processor else "auto"
    found = find_device(device)
    return begun.gone_on(found.alias, processor_of(found))

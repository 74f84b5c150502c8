"""The file that a sweep is kept in while it runs, and from which it goes on."""

from __future__ import annotations

import itertools
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from glob import escape
from pathlib import Path

from warp_plate.plate.files import digests
from warp_plate.result.checkpoint import ENDING
from warp_plate.result.sweep import Sweep, load_sweep, save_sweep
from warp_plate.scene.errors import SceneError
from warp_plate.solve.devices import find_device, processor_of
from warp_plate.studies.checkpointing import EVERY
from warp_plate.studies.localize import same_device, with_earlier


class SweepFile:
    """What ``run_sweep`` keeps its points in until all are done: a file of its own, laid out as the result and written
    whole each time.

    Args:
        path: of the file; where another process has made one there since, a free name beside it is taken.
        every: seconds between two writings, at least; 0: after each point; infinite: at the end, and after Ctrl-C.
        warn: called with one line when the file cannot be written, or has another name. The sweep then goes on.
        resumes: whether the sweep goes on from what is there.

    Raises:
        SceneError: ``every`` is no number of seconds.
    """

    def __init__(
        self, path: Path, every: float = EVERY, warn: Callable[[str], object] = warnings.warn, resumes: bool = False
    ) -> None:
        if not every >= 0:
            raise SceneError(f"checkpoint-every = {every:g}: must be a number of seconds, 0 or more")
        self.path = path
        self.every = every
        self.saved: Sweep | None = None  # the last one that was written
        self._warn = warn
        self._own = resumes
        self._warned = False
        self._last = time.monotonic()

    def __call__(self, sweep: Sweep, last: bool) -> None:
        """Write it where it is time, or ``last``; nothing while no point is run."""
        if len(sweep.pending) == len(sweep.plan) or not (last or time.monotonic() - self._last >= self.every):
            return
        self._last = time.monotonic()
        if not self._own and self.path.exists():
            taken, self.path = self.path, free_name(self.path)
            self._warn(f"{taken} is of another sweep by now; this one is kept in {self.path}")
        try:
            save_sweep(sweep, self.path)
        except SceneError as error:
            if not self._warned:
                self._warn(f"{error}; the sweep goes on")
            self._warned = True
            return
        self.saved, self._own, self._warned = sweep, True, False

    def remove(self) -> None:
        """Away with the file, and with what a killed process left of one: the result is written."""
        if self._own:
            for path in (self.path, *self.path.parent.glob(f".{escape(self.path.name)}.*.part.h5")):
                path.unlink(missing_ok=True)


def refuse_to_replace(path: Path, sweep: Sweep) -> None:
    """Nothing, where there is no file, or one of the same scene, figures and points.

    Raises:
        SceneError: what is there would be lost.
    """
    if not path.exists():
        return
    way = f"name another file by --out, or delete {path}"
    try:
        there = load_sweep(path)
    except SceneError as error:
        raise SceneError(f"{error}; {way}") from None
    same_scene = there.scene.model_dump() == sweep.scene.model_dump() and there.files == sweep.files
    for what, same in (
        ("another scene", same_scene),
        (f"--what {there.what}", there.what == sweep.what),
        (f"--count {there.count}", there.count == sweep.count),
        (f"other points ({there.plan.description})", there.plan.same(sweep.plan)),
    ):
        if not same:
            raise SceneError(f"{path}: holds a sweep of {what}; {way}")


def free_name(path: Path) -> Path:
    """NAME-2.h5 for NAME.h5, NAME-2.checkpoint.h5 for NAME.checkpoint.h5; or the first such that no file has."""
    ending = ENDING if path.name.endswith(ENDING) else path.suffix
    stem = path.name.removesuffix(ending)
    names = (path.with_name(f"{stem}-{number}{ending}") for number in itertools.count(2))
    return next(name for name in names if not name.exists())


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
    return begun.moved_to(found.alias, processor_of(found))

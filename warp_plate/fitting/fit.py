"""Fit a scene to files of measurements, as the command ``fit`` does."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from warp_plate.fitting.fit_modes import ModeFit, fit_modes
from warp_plate.fitting.fit_responses import ResponseFit, fit_responses
from warp_plate.fitting.measured_modes import read_modes
from warp_plate.fitting.measured_responses import read_responses
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene, SceneSource


def fit(scene: SceneSource, data: str | Path | Sequence[str | Path]) -> ModeFit | ResponseFit:
    """Fit the keys under ``[fit.free]`` of a scene to measurements, with 95 % intervals.

    Args:
        scene: Scene with ``[fit.free]``, the ranges of the fitted values; for responses also ``[[measurement]]``.
        data: File of natural frequencies, or one or several files of frequency responses if the scene has tables
            ``[[measurement]]``; see :func:`read_modes` and :func:`read_responses`.

    Raises:
        SceneError: A file cannot be read, or does not fit the scene; or see :func:`fit_panel`.
    """
    loaded = Scene.load(scene)
    paths = [Path(data)] if isinstance(data, str | Path) else [Path(path) for path in data]
    if loaded.measurement:
        return fit_responses(loaded, read_responses(paths, len(loaded.measurement), loaded.fit))
    if len(paths) != 1:
        named = f"data = {paths[1]}" if paths else "data"
        raise SceneError(f"{named}: must be one file, for the scene has no tables [[measurement]]")
    return fit_modes(loaded, read_modes(paths[0]))

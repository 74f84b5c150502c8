"""The drive of a designed panel in time steps on ever finer grids, which share nothing with the modes of the search."""

from __future__ import annotations

import numpy as np

from warp_plate.accuracy.reference_solution import refine_until
from warp_plate.accuracy.richardson import extrapolate_drives
from warp_plate.designing.panel import gridded
from warp_plate.effects.effect import attachments
from warp_plate.modal.solver import ModalSolver
from warp_plate.plate.designs import scene_phasors
from warp_plate.result.designed import StepCheck
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fit import Design
from warp_plate.scene.model import Scene

# Relative error at which grids are fine enough, the nominal time of all of them [s], and the number of attachments that
# take as long as the rest of a step.
WANTED, SECONDS, ATTACHED = 2e-3, 10.0, 10


def check_by_steps(scene: Scene, design: Design, device: str = "cpu") -> StepCheck:
    """Return the localization factor, by modes and by time steps, of a scene's best drive, or of its own.

    With a design's objective "bound" the best drive is taken, which no drive exceeds.
    """
    response = ModalSolver(gridded(scene), "cpu").response
    phasors = response.best_drive() if design.objective == "bound" else scene_phasors(scene)
    drives = np.asarray(phasors)[None]
    by_modes = float(response.localization_factors(drives)[0])
    try:
        if scene.steady or design.steady:
            raise SceneError("time steps end at window.end, and this motion is steady")
        seconds = SECONDS / (1 + len(attachments(scene.terms)) / ATTACHED)
        found = refine_until(extrapolate_drives(scene, drives, device), lambda _: WANTED, seconds)
    except SceneError as error:
        return StepCheck(by_modes, reason=str(error))
    steps = float(found.values[0])
    return StepCheck(by_modes, steps, abs(steps) * found.uncertainty)

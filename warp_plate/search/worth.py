"""What drives are worth by the objectives of a search that they were not found by."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from warp_plate.result.model import Case
from warp_plate.scene.model import Scene
from warp_plate.search.judge import make_judge
from warp_plate.search.problem import areas_of
from warp_plate.solve.solver import PlateSolver


def worth_of(scene: Scene, cases: Mapping[str, Case], device: str, path: str) -> dict[str, dict[str, float]]:
    """For each case at the scene's own frequency and places, by its name: ``Judge.worth`` of its drive.

    Nothing where the localization factor is all that is sought, which a case has, or where each of several targets has
    objectives of its own.

    Raises:
        SceneError: see :class:`PlateSolver`.
    """
    judge = make_judge(scene)
    if judge.only_localization or scene.targets or not cases:
        return {}
    drives, areas = np.array([case.drive for case in cases.values()]), areas_of(scene, judge)
    energy = PlateSolver(scene, device, path, areas=areas).run(drives).energy
    moved = None
    if judge.needs_displacement:
        moved = PlateSolver(scene, device, path, areas=areas, quantity="displacement").run(drives).energy
    worth = judge.worth(energy, moved)
    return {name: {kind: float(values[index]) for kind, values in worth.items()} for index, name in enumerate(cases)}

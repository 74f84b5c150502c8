"""What drives are worth by the objectives of a search that they were not found by."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from warp_plate.problem.objectives import make_judge
from warp_plate.problem.problem import areas_of
from warp_plate.result.model import Case
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.solver import PlateSolver

Worth = dict[str, dict[str, float]]


def worth_of(scene: Scene, cases: Mapping[str, Case], device: str, path: str) -> tuple[Worth, int]:
    """For each case at the scene's own frequency and places, by its name: ``Judge.worth`` of its drive; and node-steps.
    Their energies are those of a solver of ``areas_of``.

    Nothing where the localization factor is all that is sought, which a case has, where each of several targets has
    objectives of its own, or where Ctrl-C came first.
    """
    try:
        judge = make_judge(scene)
        if judge.only_localization or scene.targets:
            return {}, 0
        moved, node_steps = None, 0
        if judge.needs_displacement:
            solver = PlateSolver(scene, device, path, areas=areas_of(scene, judge), quantity="displacement")
            run = solver.run(np.array([case.drive for case in cases.values()]))
            moved, node_steps = run.energy, run.node_steps
    except (KeyboardInterrupt, SceneError):  # a result is not lost for want of what it is compared with
        return {}, 0
    worth = judge.worth(np.array([list(case.energy.values()) for case in cases.values()]), moved)
    each = {name: {kind: float(values[index]) for kind, values in worth.items()} for index, name in enumerate(cases)}
    return each, node_steps

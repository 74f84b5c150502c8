"""A few plates on one grid, held against the right answer: what ``choose`` and ``estimate`` try candidates with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warp_plate.accuracy.configurations import Configuration, node_steps, scene_with
from warp_plate.plate.weights import localization_factor
from warp_plate.scene.model import Scene
from warp_plate.solve.devices import find_device
from warp_plate.solve.solver import PlateSolver

# Time of a node-step against that of second order in float32, by (order, precision): a little more than arithmetic and
# memory say, because fourth order walks two passes of five taps. Measured with ``warp-plate accuracy``.
RELATIVE_COST = {(2, "float32"): 1.0, (2, "float64"): 1.4, (4, "float32"): 2.0, (4, "float64"): 2.8}
# Up to so many node-steps a few plates are tried on the streaming path, which needs no kernel of its own for each grid.
STREAMED_NODE_STEPS = {"cpu": 4e7, "cuda": 1e10}
# How larger ones are stepped.
PATH = "auto"


@dataclass(frozen=True)
class TrialRun:
    """configuration; error: the largest relative error of the localization factors; cost: see :func:`cost_of_run`."""

    configuration: Configuration
    error: float
    cost: float


def cost_of_run(scene: Scene, configuration: Configuration) -> float:
    """A plate's time in units of one node-step of second order in float32."""
    return node_steps(scene, configuration) * RELATIVE_COST[configuration.order, configuration.precision]


def try_out(
    scene: Scene, configuration: Configuration, drives: np.ndarray, factors: np.ndarray, device: str = "auto"
) -> TrialRun:
    """Run the drives (drives, actuators), the right localization factors (drives,) of which are known.

    A plate whose numbers leave the finite ones has an infinite error.

    Raises:
        SceneError: see ``PlateSolver``.
    """
    work = len(drives) * node_steps(scene, configuration)
    solver = PlateSolver(scene_with(scene, configuration), device, path_for(work, device))
    found = localization_factor(solver.run(drives).energy)
    error = float(np.abs(found / factors - 1).max())
    return TrialRun(configuration, error if np.isfinite(error) else np.inf, cost_of_run(scene, configuration))


def path_for(work: float, device: str) -> str:
    """The path for so many node-steps of all plates together."""
    kind = "cuda" if find_device(device).is_cuda else "cpu"
    return "streaming" if work < STREAMED_NODE_STEPS[kind] else PATH

"""A particle swarm that runs in a separate thread and can be observed while it searches."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from warp_plate.optimize.optimizer import minimize
from warp_plate.optimize.pso import Swarm
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.design_variables import with_paper_search
from warp_plate.problem.methods import swarm_settings
from warp_plate.problem.parametrization import paper_phasors, parametrization_of
from warp_plate.result.motion import SwarmSnapshot
from warp_plate.scene.model import Scene


class WatchedSearch(threading.Thread):
    """A thread that searches for the drive with the largest localization factor; it starts when it is made.

    The design variables are always the drives, regardless of the scene's ``[search]``.

    Args:
        scene: The scene, at the current frequency and damping.
        energies: Function from phasors (plates, actuators) to energies (plates, regions) [J].
        scale: Magnitude of the first actuator [N/m²]; only ratios count where the plate is linear.
        seconds: Least duration of an iteration [s], so that it can be seen.

    Attributes:
        snapshot: The last iteration; None before the end of the first.
        ended: Event that ends the search after the current iteration; the last snapshot stays.
    """

    def __init__(
        self, scene: Scene, energies: Callable[[np.ndarray], np.ndarray], scale: float, seconds: float
    ) -> None:
        super().__init__(name="swarm", daemon=True)
        self._energies, self._scale, self._seconds = energies, scale, seconds
        self._factors, self._best = np.empty(0), list[float]()
        self.snapshot: SwarmSnapshot | None = None
        self.ended = threading.Event()
        space = parametrization_of(with_paper_search(scene)).space
        self._swarm = Swarm(space, swarm_settings(scene.search, scene.search.seed))
        self.start()

    def run(self) -> None:
        """Search, in the thread."""
        minimize(self._swarm, self._losses, self._after_iteration)
        if self.snapshot is not None:
            self.snapshot = replace(self.snapshot, running=False)

    def _losses(self, positions: np.ndarray) -> np.ndarray:
        self._factors = localization_factor(self._energies(self._scale * paper_phasors(positions)))
        return np.asarray(1 - self._factors)

    def _after_iteration(self, swarm: Swarm) -> bool:
        self._best.append(1 - swarm.result.fbest)
        best, drive = np.array(self._best), swarm.result.xbest
        self.snapshot = SwarmSnapshot(
            phasors=paper_phasors(swarm.positions),
            factors=self._factors,
            best=np.where(np.isfinite(best), best, np.nan),
            best_phasors=None if drive is None else paper_phasors(drive[None])[0],
            iterations=swarm.settings.iterations,
            running=True,
        )
        return self.ended.wait(self._seconds)

"""A particle swarm at work in a thread of its own, to be looked at while it searches."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable

import numpy as np

from warp_plate.optimize.optimizer import minimize
from warp_plate.optimize.pso import Swarm
from warp_plate.plate.weights import localization_factor
from warp_plate.problem.design_variables import with_paper_search
from warp_plate.problem.methods import swarm_settings
from warp_plate.problem.parametrization import paper_phasors, parametrization_of
from warp_plate.result.live import SwarmSnapshot
from warp_plate.scene.model import Scene

# Told the best drive (actuators,) after each iteration that found a better one.
Found = Callable[[np.ndarray], object]


class WatchedSearch:
    """The scene's swarm over ``energies``, (plates, actuators) drives → (plates, regions) energies.

    Args:
        scale: magnitude of the first actuator [N/m²]; where the plate is linear only ratios count.
        seconds: an iteration takes at least this long, so that it can be seen.
        found: called in the search's thread.
    """

    def __init__(
        self,
        scene: Scene,
        energies: Callable[[np.ndarray], np.ndarray],
        scale: float,
        seconds: float,
        found: Found,
    ) -> None:
        self._energies = energies
        self._scale = scale
        self._seconds = seconds
        self._found = found
        self._factors = np.empty(0)
        self._best: list[float] = []
        self._ended = threading.Event()
        self._reading: SwarmSnapshot | None = None
        # What is free in the scene's own search is for ``localize``: here it is always the drives.
        space = parametrization_of(with_paper_search(scene)).space
        swarm = Swarm(space, swarm_settings(scene.search, scene.search.seed))
        self._thread = threading.Thread(target=self._run, args=(swarm,), name="swarm", daemon=True)
        self._thread.start()

    def read(self) -> SwarmSnapshot | None:
        """The last iteration; None before the first one's end."""
        return self._reading

    def end(self) -> None:
        """Search no further; the last reading stays."""
        self._ended.set()

    def join(self) -> None:
        """Wait until the thread has ended."""
        self._thread.join()

    def _run(self, swarm: Swarm) -> None:
        minimize(swarm, self._losses, self._after)
        if self._reading is not None:
            self._publish(swarm, running=False)

    def _losses(self, positions: np.ndarray) -> np.ndarray:
        self._factors = localization_factor(self._energies(self._scale * paper_phasors(positions)))
        losses: np.ndarray = 1 - self._factors
        return losses

    def _after(self, swarm: Swarm) -> bool:
        better = not self._best or 1 - swarm.result.fbest > self._best[-1]
        self._best.append(1 - swarm.result.fbest)
        self._publish(swarm, running=True)
        if better and self._reading is not None and self._reading.best_phasors is not None and not self._ended.is_set():
            self._found(self._scale * self._reading.best_phasors)
        return self._ended.wait(self._seconds)

    def _publish(self, swarm: Swarm, running: bool) -> None:
        best = swarm.result.xbest
        self._reading = SwarmSnapshot(
            phasors=paper_phasors(swarm.positions),
            factors=self._factors,
            best=np.array([value if math.isfinite(value) else math.nan for value in self._best]),
            best_phasors=None if best is None else paper_phasors(best[None])[0],
            iterations=swarm.settings.iterations,
            running=running,
        )

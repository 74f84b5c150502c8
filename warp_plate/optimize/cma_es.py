"""CMA-ES: a cloud of Gaussian numbers that learns the shape of the loss around its mean, by pycma.

Sources: N. Hansen, The CMA Evolution Strategy: A Tutorial, arXiv:1604.00772; restarts with a population that doubles:
Auger and Hansen, IEEE CEC 2005 (IPOP). The cloud moves in numbers that are 0 at the lower end of the space's initial
range and 1 at its upper end. It knows no numbers that wrap: it moves along the whole line, and what is evaluated is
wrapped into one period. pycma needs two numbers or more: a single one gets an idle one beside it.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from warp_plate.optimize.optimizer import MethodError, Optimizer, SearchSettings, SearchSpace, as_shape, tolerance_scale

# Standard deviation of the first cloud, in initial ranges.
INITIAL_SIZE = 0.3
# pycma's own limits of progress, for losses of order one; here they are parts of the loss's size.
TOLERANCES = {"tolfun": 1e-11, "tolfunhist": 1e-12}


class CovarianceSearch(Optimizer):
    """The search of ``cma.CMAEvolutionStrategy``, with restarts, a budget, and a state without pickle.

    A restart follows when pycma sees no more progress, or after ``stall`` iterations without any.
    """

    FORMAT = "cma 2"

    def __init__(self, space: SearchSpace, settings: SearchSettings, start: np.ndarray | None = None) -> None:
        """Draw the first cloud, around ``start`` (dimension,) and with it; MethodError: pycma is not installed."""
        super().__init__(space, settings)
        try:
            import cma
        except ImportError:
            raise MethodError("needs pycma; pip install 'warp-plate[cma]'") from None
        self._cma = cma
        self._random = np.random.RandomState(np.random.MT19937(settings.seed))
        self._losses: list[np.ndarray] = []  # from which the whole search follows again
        self._restarts = self._began_at = 0
        self._start = start
        self._cloud = self._begin(None if start is None else space.to_unit(start))

    def stop(self) -> dict[str, Any]:
        """Return {"evaluations": number} at the budget's end, pycma's own reasons, or nothing to go on."""
        ended = self._ended()
        restarting = bool(ended) and self._restarts < self.settings.restarts
        reasons = {} if restarting else ended
        following = self.evaluations + self._population(self._restarts + restarting)
        if following > self.settings.evaluations and self.iterations:
            return {"evaluations": self.evaluations} | reasons
        return reasons

    def _propose(self) -> np.ndarray:
        if self._ended() and self._restarts < self.settings.restarts:
            self._restarts, self._began_at = self._restarts + 1, self.iterations
            self._cloud = self._begin()
        self._points = self._cloud.ask()
        positions = self.space.from_unit(np.array(self._points)[:, : self.space.dimension])
        if self._start is not None and not self.iterations:
            positions[0] = self._start  # pycma moves points near a limit a little
        return positions

    def _learn(self, losses: np.ndarray) -> None:
        finite, worst = losses[np.isfinite(losses)], 0.0
        if finite.size:
            size = tolerance_scale(float(finite.min()), self.settings.loss_scale)
            self._cloud.opts.set({name: part * size for name, part in TOLERANCES.items()})
            worst = tolerance_scale(float(finite.max()), self.settings.loss_scale) + float(finite.max())
        # CMA-ES uses only ranks, but does not accept infinity.
        self._cloud.tell(self._points, np.where(np.isfinite(losses), losses, worst))
        self._losses.append(losses)

    def state(self) -> dict[str, Any]:
        """Return the losses of all positions, with which the same search can be gone through again."""
        losses = np.concatenate([np.empty(0), *self._losses])
        return {**super().state(), "version": self._cma.__version__, "losses": losses}

    def _restore(self, state: Mapping[str, Any]) -> None:
        """Go through the same search again by its losses; nothing is evaluated."""
        losses, last = as_shape(state, "losses", (-1,)), as_shape(state, "positions", (-1, self.space.dimension))
        while losses.size:
            positions = self.ask()
            self.tell(positions, losses[: len(positions)])
            losses = losses[len(positions) :]
        if state["asked"]:
            self.ask()
        if not np.array_equal(self.positions, last):
            raise ValueError(
                f"search state: pycma {self._cma.__version__} goes another way than {state.get('version')} did; "
                "install that one to go on"
            )

    def _population(self, restarts: int) -> int:
        fewest = 4 + int(3 * math.log(self.space.dimension))  # pycma's default
        return max(self.settings.particles, fewest) * 2**restarts

    def _ended(self) -> dict[str, Any]:
        """Return why the present cloud should go no further."""
        reasons = dict(self._cloud.stop()) if self.iterations > self._began_at else {}
        return reasons | ({"stall": self.settings.stall} if self.stalled(self._began_at) else {})

    def _begin(self, start: np.ndarray | None = None) -> Any:
        """Return a cloud around a point (dimension,), which it contains, or one drawn from the initial ranges."""
        space = self.space
        idle = max(2 - space.dimension, 0)
        middle = np.append(self._random.random_sample(space.dimension) if start is None else start, [0.5] * idle)
        lower, upper = space.to_unit(space.lower), space.to_unit(space.upper)
        limits = np.append(lower, [0.0] * idle), np.append(upper, [1.0] * idle)
        options = {
            "popsize": self._population(self._restarts),
            "bounds": [[value if np.isfinite(value) else None for value in limit.tolist()] for limit in limits],
            "randn": self._random.randn,  # NumPy's global generator stays untouched
            **{"seed": np.nan, "verbose": -9, "verb_log": 0, "maxiter": np.inf},
        }
        middle = np.clip(middle, *limits)
        cloud = self._cma.CMAEvolutionStrategy(middle, INITIAL_SIZE, options)
        if start is not None:
            cloud.inject([middle], force=True)
        return cloud

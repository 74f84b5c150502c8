"""CMA-ES: a cloud of Gaussian numbers that learns the shape of the loss around its mean, by pycma.

Sources: N. Hansen, The CMA Evolution Strategy: A Tutorial, arXiv:1604.00772; restarts with a population that doubles:
Auger and Hansen, IEEE CEC 2005 (IPOP). The cloud moves in numbers that are 0 at the lower end of the space's first
range and 1 at its upper end. It knows no numbers that wrap: it moves along the whole line, and what is evaluated is
wrapped into one period. pycma asks for two numbers or more: one alone gets an idle one beside it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warp_plate.optimize.record import Record, Recorded, check_format, plain, shaped, tolerance_scale
from warp_plate.optimize.space import Space
from warp_plate.scene.errors import SceneError

STATE_FORMAT = "cma 1"
# Size of the first cloud, in first ranges.
FIRST_SIZE = 0.3
GROWTH = 2
FEWEST_NUMBERS = 2
# What pycma takes for no progress, which is its own default for losses of order one; here parts of the loss's size.
TOLERANCES = {"tolfun": 1e-11, "tolfunhist": 1e-12}


@dataclass(frozen=True)
class CovarianceSettings:
    """population: positions asked for at once, until a restart doubles it; evaluations: in all, never passed;
    restarts: how many at most, each when pycma sees no more progress or after ``stall`` iterations without one;
    loss_scale: see ``record.tolerance_scale``."""

    population: int
    evaluations: int
    restarts: int = 0
    stall: int | None = None
    seed: int = 0
    loss_scale: float = 1.0


class CovarianceSearch(Recorded):
    """The search of ``cma.CMAEvolutionStrategy`` in a space, with restarts, a budget, and a state without pickle.

    Raises:
        SceneError: pycma is not installed.
    """

    def __init__(self, space: Space, settings: CovarianceSettings) -> None:
        self.space, self.settings = space, settings
        self._cma = _pycma()
        self._random = np.random.RandomState(np.random.MT19937(settings.seed))
        self._span = np.where(space.initial_upper > space.initial_lower, space.initial_upper - space.initial_lower, 1.0)
        self._record = Record(space.dimension, settings.loss_scale)
        self._told: list[np.ndarray] = []  # all losses, from which the whole search follows again
        self._restarts = self._began_at = 0
        self._cloud = self._begin()
        self._points: list[np.ndarray] = []  # of the cloud; positions are what is evaluated
        self.positions = np.empty((0, space.dimension))
        self._asked = False

    def ask(self) -> np.ndarray:
        """Positions to evaluate, (population, dimension); the same ones until their losses are told."""
        if not self._asked:
            if self._ended() and self._restarts < self.settings.restarts:
                self._restarts, self._began_at = self._restarts + 1, self.iterations
                self._cloud = self._begin()
            self._points = self._cloud.ask()
            self.positions = self._positions(np.array(self._points))
            self._asked = True
        return self.positions.copy()

    def tell(self, solutions: ArrayLike, losses: ArrayLike) -> None:
        """Take the losses of the positions that ``ask`` gave. Not finite counts as worst.

        Raises ValueError if `solutions` are not those positions or `losses` has another shape.
        """
        told = self._record.tell(self.positions if self._asked else None, solutions, losses)
        finite, worst = told[np.isfinite(told)], 0.0
        if finite.size:
            size, worst = (
                tolerance_scale(float(end), self.settings.loss_scale) for end in (finite.min(), finite.max())
            )
            self._cloud.opts.set({name: part * size for name, part in TOLERANCES.items()})
            worst += float(finite.max())
        # The cloud goes by ranks alone, but knows no infinity.
        self._cloud.tell(self._points, np.where(np.isfinite(told), told, worst))
        self._told.append(told)
        self._asked = False

    def stop(self) -> dict[str, Any]:
        """Why to stop, by name: the budget's end, or what pycma says; empty to go on."""
        restarting = bool(self._ended()) and self._restarts < self.settings.restarts
        population = self._population(self._restarts + restarting)
        reasons: dict[str, Any] = {}
        if self._record.evaluations + population > self.settings.evaluations and self.iterations:
            reasons["evaluations"] = self._record.evaluations
        return reasons if restarting else reasons | self._ended()

    def state(self, plain_numbers: bool = True) -> dict[str, Any]:
        """All losses, which lead through the same search again; strict JSON types, or with False arrays as arrays."""
        state = {
            "format": STATE_FORMAT,
            "version": self._cma.__version__,
            "losses": np.concatenate([np.empty(0), *self._told]),
            "history": self._record.state()["history"],
            "positions": self.positions.copy(),
            "asked": self._asked,
        }
        return plain(state) if plain_numbers else state

    @classmethod
    def from_state(cls, space: Space, settings: CovarianceSettings, state: dict[str, Any]) -> CovarianceSearch:
        """The search that ``state()`` was taken from, bit for bit: it is told all losses again, nothing is evaluated.

        Raises ValueError for anything else, and where another version of pycma goes another way.
        """
        search = cls(space, settings)
        try:
            check_format(state, STATE_FORMAT)
            losses, last = shaped(state, "losses", (-1,)), shaped(state, "positions", (-1, space.dimension))
            while losses.size:
                asked = search.ask()
                search.tell(asked, losses[: len(asked)])
                losses = losses[len(asked) :]
            if state["asked"]:
                search.ask()
        except (KeyError, TypeError) as error:
            raise ValueError(f"search state: {error} is missing or of a wrong kind") from None
        if not np.array_equal(search.positions, last):
            raise ValueError(
                f"search state: pycma {search._cma.__version__} goes another way than {state.get('version')} did; "
                "install that one to go on"
            )
        return search

    def _population(self, restarts: int) -> int:
        return self.settings.population * GROWTH**restarts

    def _ended(self) -> dict[str, Any]:
        """Why the cloud of now should go no further."""
        reasons = dict(self._cloud.stop()) if self.iterations > self._began_at else {}
        if self._record.stalled(self.settings.stall, self._began_at):
            reasons["stall"] = self.settings.stall
        return reasons

    def _begin(self) -> Any:
        """A cloud around a place drawn from the first ranges."""
        space = self.space
        idle = max(FEWEST_NUMBERS - space.dimension, 0)
        limits = [
            np.append((end - space.initial_lower) / self._span, np.full(idle, limit))
            for end, limit in ((space.lower, 0.0), (space.upper, 1.0))
        ]
        middle = np.append(self._random.random_sample(space.dimension), np.full(idle, 0.5))
        options = {
            "popsize": self._population(self._restarts),
            "bounds": [[value if np.isfinite(value) else None for value in limit.tolist()] for limit in limits],
            "randn": self._random.randn,  # nothing of NumPy's one generator for all is touched
            "seed": np.nan,
            "verbose": -9,
            "verb_log": 0,
            "maxiter": np.inf,
        }
        return self._cma.CMAEvolutionStrategy(np.clip(middle, *limits), FIRST_SIZE, options)

    def _positions(self, points: np.ndarray) -> np.ndarray:
        space = self.space
        positions = space.initial_lower + self._span * points[:, : space.dimension]
        wraps = np.isfinite(space.period)
        period, lowest = space.period[wraps], space.initial_lower[wraps]
        positions[:, wraps] -= period * np.floor((positions[:, wraps] - lowest) / period)
        clipped: np.ndarray = np.clip(positions, space.lower, space.upper)
        return clipped


def _pycma() -> Any:
    try:
        import cma
    except ImportError:
        raise SceneError("search.method = 'cma': needs pycma; pip install 'warp-plate[cma]'") from None
    return cma

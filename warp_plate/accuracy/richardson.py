"""Richardson's extrapolation from grids that share no nodes, for scenes without a reference by modes.

Errors fall as h² or, where the scene allows it, as h⁴; loads and regions are weighed by moments, whose errors do not
depend on where within a cell an area ends. Time steps fall as h², so that their errors fall as h⁴. Of three consecutive
grids no two numbers of cells along a side have a common factor: they share no line of nodes inside the plate.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from warp_plate.accuracy.configurations import (
    Configuration,
    aligned,
    bending_wavelength,
    configuration_of,
    highest_order,
    node_steps,
    regrid,
    spacing_of,
    stability_limit,
)
from warp_plate.plate.operator import FEWEST_NODES
from warp_plate.plate.scheme import SAFETY, STEPS_A_PERIOD
from warp_plate.plate.signals import highest_frequency
from warp_plate.plate.weights import localization_factor
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.solve.solver import PlateSolver

# Cells along the sides of a square plate on the coarsest grid, those of each grid relative to the one before, and the
# number of grids.
FIRST_CELLS, FINER, GRIDS = 12, math.sqrt(2), 8
# Numbers of finest grids, of one before them all, and of terms of the extrapolations from four grids.
EXTRAPOLATIONS = ((0, 2), (1, 2), (0, 3), (1, 3))
# Error of an extrapolated value: this many times the largest difference of these extrapolations, and at least this
# fraction of what extrapolation added.
CHANGE_FACTOR, GAIN_FACTOR = 3.0, 0.2
# Nominal time of a node-step in float64 [s], as on two cores.
STEPPED_SECONDS = 2e-9
# Cells in a bending wave without which no extrapolation is near, and the longest nominal time of such a grid [s].
FEWEST_CELLS_A_WAVE, MOST_SECONDS = 4.0, 30.0


@dataclass(frozen=True)
class Extrapolation:
    """Values in the limit of vanishing cells."""

    values: np.ndarray  # extrapolated values
    uncertainty: float  # largest relative error of what is observed; inf for fewer than four grids
    seconds: float  # nominal time of the last grid [s]
    next_seconds: float  # nominal time of the next one [s]
    kind = "richardson"


def extrapolate(
    scene: Scene,
    plates: int,
    measure: Callable[[Scene], np.ndarray],
    allowed: Callable[[np.ndarray], bool],
    change: Callable[[np.ndarray, Sequence[np.ndarray]], float],
) -> Iterator[Extrapolation]:
    """Yield extrapolations of what ``measure`` returns by runs of ``plates`` plates on ever more grids.

    Grids that it refuses, or where it is not finite, are left out. Where extrapolated values are not ``allowed``, those
    of the finest grid are taken. ``change`` is the largest relative difference of what is observed from other values.
    """
    _refuse_short_waves(scene, plates)
    scenes: list[Scene] = []
    values: list[np.ndarray] = []
    refusal, uncertainty = None, math.inf

    def limit_of(last: int, terms: int) -> np.ndarray:
        """Return the extrapolation from the ``terms`` grids before the ``last`` ones."""
        selected = slice(len(values) - last - terms, len(values) - last)
        limit: np.ndarray = np.tensordot(weights_of_grids(scenes[selected]), np.array(values[selected]), 1)
        return limit if allowed(limit) else values[selected][-1]

    for gridded in _scenes(scene):
        try:
            measured = measure(gridded)
            if not np.isfinite(measured).all():
                raise SceneError(f"grid.nodes = {list(gridded.grid.nodes)}: the plate grows without bound")
        except SceneError as error:
            refusal = error
            continue
        scenes.append(gridded)
        values.append(measured)
        possible = [(last, terms) for last, terms in EXTRAPOLATIONS if last + terms <= len(values)]
        limits = [limit_of(last, terms) for last, terms in possible]
        limit, *others = limits or values
        if len(limits) == len(EXTRAPOLATIONS):
            uncertainty = max(CHANGE_FACTOR * change(limit, others), GAIN_FACTOR * change(limit, values[-1:]))
        seconds = STEPPED_SECONDS * plates * node_steps(scene, configuration_of(gridded))
        # The next grid has twice the nodes and twice the steps.
        yield Extrapolation(limit, uncertainty, seconds, FINER**4 * seconds)
    if refusal is not None and uncertainty == math.inf:
        raise refusal


def extrapolate_drives(scene: Scene, phasors: np.ndarray, device: str) -> Iterator[Extrapolation]:
    """Yield extrapolated localization factors (drives,) of phasors (drives, actuators), of any scene."""

    def measure(gridded: Scene) -> np.ndarray:
        return localization_factor(PlateSolver(gridded, device).run(phasors).energy)

    def change(factors: np.ndarray, others: Sequence[np.ndarray]) -> float:
        return max(float(np.abs(other / factors - 1).max()) for other in others)

    return extrapolate(scene, len(phasors), measure, lambda factors: bool((factors > 0).all()), change)


def weights_of_grids(scenes: Sequence[Scene]) -> np.ndarray:
    """Return weights (grids,) of values v + a h^p + b h^(p + 2) ..., p the order, whose sum is v."""
    order = scenes[-1].grid.order
    spacings = np.array([spacing_of(scene.plate.size, scene.grid.nodes) for scene in scenes])
    powers = np.array([0, *range(order, order + 2 * len(scenes) - 2, 2)])
    weights: np.ndarray = np.linalg.inv((spacings[:, None] / spacings[-1]) ** powers)[0]
    return weights


def coprime_grids(size: tuple[float, float], order: int) -> list[tuple[int, int]]:
    """Return nodes (nx, ny) of ever finer grids of nearly square cells."""
    short, ratio, fewest = int(size[1] < size[0]), max(size) / min(size), FEWEST_NODES[order] - 1
    cells: list[list[int]] = [[], []]
    for index in range(GRIDS):
        wanted = max(FIRST_CELLS / math.sqrt(ratio), fewest) * FINER**index
        for along in (cells[short], cells[1 - short]):
            candidates = range(max(fewest, round(0.8 * wanted)), round(1.3 * wanted) + 3)
            coprime = [n for n in candidates if all(math.gcd(n, other) == 1 for other in along[-2:])]
            along.append(coprime[int(np.argmin(np.abs(np.array(coprime) - wanted)))])
            wanted = along[-1] * ratio
    return [(nx + 1, ny + 1) for nx, ny in zip(*cells, strict=True)]


def _scenes(scene: Scene) -> Iterator[Scene]:
    """Yield the scene on ever finer grids."""
    order, fraction = highest_order(scene), 0.0
    for nodes in coprime_grids(scene.plate.size, order):
        limit = stability_limit(scene, order, nodes)
        # The drive limits the first.
        fraction = fraction or min(SAFETY, 1 / (STEPS_A_PERIOD * highest_frequency(scene)) / limit)
        yield regrid(scene, Configuration(order, "moments", nodes, aligned(scene.window, fraction * limit), "float64"))


def _refuse_short_waves(scene: Scene, plates: int) -> None:
    """Refuse a scene with a SceneError if no grid within MOST_SECONDS resolves its bending waves."""
    length = bending_wavelength(scene)
    for gridded in _scenes(scene):
        if STEPPED_SECONDS * plates * node_steps(scene, configuration_of(gridded)) > MOST_SECONDS:
            break
        if spacing_of(scene.plate.size, gridded.grid.nodes) <= length / FEWEST_CELLS_A_WAVE:
            return
    wave = f"bending waves of {length:.2g} m on a plate of {list(scene.plate.size)} m until {scene.window.end:g} s"
    raise SceneError(f"drive.frequency: {wave} take too long on {plates} plates for a known accuracy; write a [grid]")

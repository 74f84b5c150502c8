"""What a drive is worth: from the energies of the plate's regions to values, and to the loss that a search lowers.

With E, A and M a region's energy [J], area [m²] and mass [kg], t the target and r the rest of the plate:

    localization   E_t / (E_t + E_r)
    contrast       10 log10 (E_t/A_t) / (E_r/A_r)  [dB], within ± MOST_DECIBELS
    velocity       √(2 E_t / M_t)  [m/s], the root of the mean square over the region's mass and the window
    displacement   √(2 U_t / M_t)  [m], the same of U = ½ ∫ ρH u² dA, averaged over the window
    uniformity     (Σ E_i)² / (Σ A_i · Σ E_i²/A_i), over cells i of the target; 1 where all E_i/A_i are the same

The loss is −Σ weight · value; of one localization with weight 1 alone, 1 − LF as in the source paper. Beyond a
``rest_limit`` it is the largest loss that any drive within all limits can have, plus the sum of the parts by which
limits are passed: such a drive is worse than any that keeps them, the more so the farther it is beyond.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from warp_plate.plate.section import make_section
from warp_plate.plate.shapes import bounds, shape_weights
from warp_plate.plate.weights import REGIONS, localization_factor, region_weights
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene
from warp_plate.scene.search import Objective

# Beyond these a contrast is rounding.
MOST_DECIBELS = 120.0
# Cells of the target along x and along y, for its uniformity: at most, and nodes of each along an axis at least.
MOST_CELLS, CELL_NODES = 6, 2
# Part of the plate's area from which on there is a rest.
LEAST_REST = 1e-9
# Part of a limit that rounding in float32 may pass.
ROUNDING = 1e-5
OF_THE_REST = " of the rest"
_PLATE, _TARGET = REGIONS.index("plate"), REGIONS.index("target")


@dataclass(frozen=True)
class Objectives:
    """The objectives of a scene, ready for energies on its grid.

    regions: weights (ny, nx) by name, which a solver must sum beside the plate and the target
    (``PlateSolver(areas=judge.regions)``). areas, masses: (2,) of target and rest [m², kg]; cells: (cells,) areas of
    ``regions`` [m²].
    """

    terms: tuple[Objective, ...]
    regions: Mapping[str, np.ndarray]
    areas: np.ndarray
    masses: np.ndarray
    cells: np.ndarray

    @property
    def needs_displacement(self) -> bool:
        """Whether :meth:`losses` needs the run of a solver for displacements too."""
        return any(one.kind == "displacement" for one in self.terms)

    @property
    def limits(self) -> dict[str, float]:
        """The largest values on the rest that are allowed, by their names in ``values``."""
        return {one.kind + OF_THE_REST: one.rest_limit for one in self.terms if one.rest_limit is not None}

    @property
    def only_localization(self) -> bool:
        """Whether the loss is 1 − LF, for which alone a bound is known."""
        return [(one.kind, one.weight) for one in self.terms] == [("localization", 1)]

    def losses(self, energy: np.ndarray, displacement_energy: np.ndarray | None = None) -> np.ndarray:
        """(plates,) what is to be made small; not finite where a plate has no energies, and NaN for one at rest whose
        localization, contrast or uniformity is sought.

        Args:
            energy: (plates, regions) [J]: plate, target, and then ``regions`` in their order.
            displacement_energy: the same of ½ ∫ ρH u² dA [J s²], where displacements are judged.
        """
        if self.only_localization:
            return localization_loss(energy)
        worth, limits = self.values(energy, displacement_energy), self.limits
        total = -worth["sum"]
        if not limits:
            return np.asarray(total)
        worst = MOST_DECIBELS * sum(one.weight for one in self.terms if one.kind == "contrast")
        excess = sum(np.maximum(worth[name] / limit - 1, 0) for name, limit in limits.items())
        return np.where(excess > 0, worst + excess, total)

    def values(self, energy: np.ndarray, displacement_energy: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """(plates,) by the objectives' kinds, in OBJECTIVE_UNITS; of velocity and displacement also that "of the rest".

        Args: see :meth:`losses`.
        """
        found: dict[str, np.ndarray] = {}
        for one in self.terms:
            if one.kind == "localization":
                found[one.kind] = localization_factor(energy)
            elif one.kind == "contrast":
                found[one.kind] = _decibels(_target_and_rest(energy) / self.areas)
            elif one.kind == "uniformity":
                found[one.kind] = _uniformity(energy[:, len(REGIONS) : len(REGIONS) + self.cells.size], self.cells)
            else:
                moved = energy if one.kind == "velocity" else displacement_energy
                if moved is None:
                    raise ValueError("displacements are judged: their energies are needed")
                with np.errstate(invalid="ignore", divide="ignore"):  # a target that is all of the plate has no rest
                    target, rest = np.sqrt(2 * np.maximum(_target_and_rest(moved), 0) / self.masses).T
                found |= {one.kind: target, one.kind + OF_THE_REST: rest}
        return {**found, "sum": np.asarray(sum(one.weight * found[one.kind] for one in self.terms))}

    def within_limits(self, values: Mapping[str, float]) -> bool:
        """Whether one drive's values are within all limits on the rest."""
        return all(keeps_limit(values[name], limit) for name, limit in self.limits.items())


def keeps_limit(value: float, limit: float) -> bool:
    """Whether a value keeps its limit, but for rounding in float32."""
    return value <= limit * (1 + ROUNDING)


def make_objectives(scene: Scene) -> Objectives:
    """The judge of a scene with a grid.

    Raises:
        SceneError: a target that covers no node, all of the plate where the rest counts, or too few nodes for a
            uniformity; a mask that cannot be read.
    """
    weights, density = region_weights(scene), make_section(scene).mass
    node = math.prod(side / (count - 1) for side, count in zip(scene.plate.size, scene.grid.nodes, strict=True))
    areas, masses = (
        (node * factor * weights).sum(axis=(1, 2)) @ [[0, 1], [1, -1]] for factor in (np.ones_like(density), density)
    )
    objectives = scene.search.objectives
    for index, one in enumerate(objectives):
        key = f"search.objectives[{index}].kind = {one.kind!r}"
        if areas[1] <= LEAST_REST * areas.sum() and (one.kind == "contrast" or one.rest_limit is not None):
            raise SceneError(f"{key}: the target covers the whole plate, so there is no rest; make it smaller")
    regions: dict[str, np.ndarray] = {}
    if any(one.kind == "uniformity" for one in objectives):
        regions = _cells_of_target(scene, node)
        if len(regions) < 2:
            raise SceneError(
                f"target.{scene.target.description}: has fewer than {2 * CELL_NODES} nodes along x and y, too few for "
                "search.objectives with kind = 'uniformity'; enlarge it, or use more nodes"
            )
    return Objectives(
        terms=objectives,
        regions=regions,
        areas=areas,
        masses=masses,
        cells=np.array([node * field.sum() for field in regions.values()]),
    )


def _cells_of_target(scene: Scene, node: float) -> dict[str, np.ndarray]:
    """Weights (ny, nx) of the parts of the target in a raster over its bounding box, of those that have an inside.

    node: area of a node's cell [m²].
    """
    key = next(iter(scene.targets_by_key))
    x0, x1, y0, y1 = bounds(scene, key, scene.target)
    sides = []
    for low, high, side, nodes in zip((x0, y0), (x1, y1), scene.plate.size, scene.grid.nodes, strict=True):
        count = int((high - low) / (side / (nodes - 1)) / CELL_NODES + 1e-6)
        sides.append(np.linspace(low, high, min(max(count, 1), MOST_CELLS) + 1))
    along_x, along_y = sides
    least = 1e-6 * (along_x[1] - along_x[0]) * (along_y[1] - along_y[0])
    found = {}
    for row, (bottom, top) in enumerate(zip(along_y[:-1].tolist(), along_y[1:].tolist(), strict=True)):
        for column, (left, right) in enumerate(zip(along_x[:-1].tolist(), along_x[1:].tolist(), strict=True)):
            field = shape_weights(scene, key, scene.target, (left, right, bottom, top))
            if field.sum() * node > least:
                found[f"cell {row} {column}"] = field
    return found


def _target_and_rest(energy: np.ndarray) -> np.ndarray:
    """(plates, 2)"""
    return np.stack([energy[:, _TARGET], energy[:, _PLATE] - energy[:, _TARGET]], axis=1)


def _decibels(densities: np.ndarray) -> np.ndarray:
    """(plates,) of the first of (plates, 2) over the second; what rounding makes negative counts as nothing."""
    target, rest = np.maximum(densities, 0).T
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = 10 * (np.log10(target) - np.log10(rest))
    return np.clip(np.where((target == 0) & (rest == 0), math.nan, ratio), -MOST_DECIBELS, MOST_DECIBELS)


def _uniformity(energy: np.ndarray, areas: np.ndarray) -> np.ndarray:
    """(plates,) of energies (plates, cells) in cells of these areas (cells,); NaN for a plate at rest."""
    with np.errstate(invalid="ignore", divide="ignore"):
        largest = np.abs(energy).max(axis=1, keepdims=True)  # squares of small energies would be lost
        share = energy / largest
        found: np.ndarray = share.sum(axis=1) ** 2 / (areas.sum() * (share**2 / areas).sum(axis=1))
    return found


def localization_loss(energy: np.ndarray) -> np.ndarray:
    """(plates,) Λ = 1 − LF, Problem 2 of the source paper."""
    return 1 - localization_factor(energy)


def loss_scale(objectives: Iterable[Objective]) -> float:
    """What tolerances of a loss are parts of where the loss itself is smaller (``record.size_of``); 1 of 1 − LF.

    Localization, contrast and uniformity are numbers of order one, whose sum with others may pass zero. A velocity or a
    displacement is as small as its unit makes it: its own size is all that there is to go by.
    """
    return float(sum(one.weight for one in objectives if one.kind not in ("velocity", "displacement")))

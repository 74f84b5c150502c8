"""The objectives of a search: from energies of regions to values, and to the loss that is minimised.

Values are those of :mod:`warp_plate.quantities.region_quantities`. The loss is −Σ weight · value; for a single
localization with weight 1 it is 1 − LF, as in the source paper. A drive that exceeds a ``rest_limit`` gets the worst
possible loss plus its relative excesses, so it ranks below every drive that keeps the limits.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np

from warp_plate.modal.solver import ModalGrid
from warp_plate.plate.scheme import Discretization
from warp_plate.plate.shapes import bounds, shape_weights
from warp_plate.plate.weights import RegionLike, localization_factor
from warp_plate.quantities.region_quantities import LEAST_REST, MOST_DECIBELS, REGION_QUANTITIES, RegionSizes
from warp_plate.scene.errors import SceneError
from warp_plate.scene.search import Objective

# Largest number of cells, along each axis, into which the target is cut for its uniformity.
MOST_CELLS = 6
# Smallest number of nodes of such a cell along each axis.
CELL_NODES = 2
# Relative excess over a limit that counts as rounding in float32.
EXCESS = 1e-5
OF_THE_REST = " of the rest"


@dataclass(frozen=True)
class Objectives:
    """The objectives of a scene on its grid."""

    terms: tuple[Objective, ...]  # the scene's objectives
    # regions that a solver must sum beside the plate and the target, by name: the cells of the target, as weights (ny,
    # nx), then all targets of a scene with several
    regions: Mapping[str, RegionLike]
    sizes: RegionSizes  # areas and masses of target and rest, and areas of the target's cells

    @property
    def needs_displacement(self) -> bool:
        """True if :meth:`losses` needs energies of displacements too."""
        return any(REGION_QUANTITIES[term.kind].energy_of == "displacement" for term in self.terms)

    @property
    def limits(self) -> dict[str, float]:
        """Largest values of the rest that are allowed, by their names in :meth:`values`."""
        return {term.kind + OF_THE_REST: term.rest_limit for term in self.terms if term.rest_limit is not None}

    @property
    def only_localization(self) -> bool:
        """True if the loss is 1 − LF."""
        return [(term.kind, term.weight) for term in self.terms] == [("localization", 1)]

    def losses(self, energy: np.ndarray, displacement_energy: np.ndarray | None = None) -> np.ndarray:
        """Return losses (plates,) of energies (plates, regions) [J] of plate, target, and ``regions`` in their order.

        ``displacement_energy`` is the same of ½ ∫ ρH u² dA [J s²], for objectives that need displacements. Losses are
        not finite for a plate without energies, and NaN for one at rest whose localization, contrast or uniformity
        counts.
        """
        if self.only_localization:
            return 1 - localization_factor(energy)
        values = self.values(energy, displacement_energy)
        worst = MOST_DECIBELS * sum(term.weight for term in self.terms if term.kind == "contrast")
        excess = sum(np.maximum(values[name] / limit - 1, 0) for name, limit in self.limits.items())
        return np.where(excess > 0, worst + excess, -values["sum"])

    def values(self, energy: np.ndarray, displacement_energy: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Return values (plates,) by the objectives' kinds, also "of the rest" where these have them, and their
        weighted "sum"; the arguments are those of :meth:`losses`."""
        values: dict[str, np.ndarray] = {}
        for term in self.terms:
            quantity = REGION_QUANTITIES[term.kind]
            energies = energy if quantity.energy_of == "velocity" else displacement_energy
            if energies is None:
                raise ValueError(f"an objective of {term.kind} needs energies of displacement")
            values[term.kind] = quantity.evaluate(energies, self.sizes)
            if quantity.of_rest is not None:
                values[term.kind + OF_THE_REST] = quantity.of_rest(energies, self.sizes)
        return {**values, "sum": np.asarray(sum(term.weight * values[term.kind] for term in self.terms))}


def keeps_limit(value: float, limit: float) -> bool:
    """Return whether a value keeps its limit, but for rounding in float32."""
    return value <= limit * (1 + EXCESS)


def loss_scale(objectives: Iterable[Objective]) -> float:
    """Return the least size of a loss to which tolerances refer: the sum of the weights of ratios, because a loss of
    ratios may be near zero; 0 without ratios."""
    return float(sum(term.weight for term in objectives if REGION_QUANTITIES[term.kind].is_ratio))


def make_objectives(discretization: Discretization | ModalGrid) -> Objectives:
    """Return the objectives of a scene on its grid; SceneError: a target or mask that they do not fit."""
    scene, weights = discretization.scene, discretization.region_weights
    density, cell = discretization.surface_density, discretization.cell
    areas, masses = (
        (cell * factor * weights).sum(axis=(1, 2)) @ [[0, 1], [1, -1]] for factor in (np.ones_like(density), density)
    )
    terms, cells = scene.search.objectives, dict[str, np.ndarray]()
    for index, term in enumerate(terms):
        if areas[1] <= LEAST_REST * areas.sum() and (term.kind == "contrast" or term.rest_limit is not None):
            raise SceneError(
                f"search.objectives[{index}].kind = {term.kind!r}: the target covers the whole plate, so there is no "
                "rest; make it smaller"
            )
        if term.kind == "uniformity":
            cells = _target_cells(discretization)
    cell_areas = np.array([cell * field.sum() for field in cells.values()])
    return Objectives(terms, {**cells, **scene.target_regions}, RegionSizes(areas, masses, cell_areas))


def _target_cells(discretization: Discretization | ModalGrid) -> dict[str, np.ndarray]:
    """Return weights (ny, nx) of the target's parts in a raster over its bounding box, without the empty ones."""
    scene = discretization.scene
    key = next(iter(scene.targets_by_key))
    box, sides = np.reshape(bounds(scene, key, scene.target), (2, 2)), []
    for (low, high), side, nodes in zip(box.tolist(), scene.plate.size, scene.grid.nodes, strict=True):
        count = int((high - low) / (side / (nodes - 1)) / CELL_NODES + 1e-6)
        sides.append(np.linspace(low, high, min(max(count, 1), MOST_CELLS) + 1))
    along_x, along_y = sides
    least, cells = 1e-6 * (along_x[1] - along_x[0]) * (along_y[1] - along_y[0]), {}
    rows, columns = (enumerate(pairwise(side.tolist())) for side in (along_y, along_x))
    for (row, y_ends), (column, x_ends) in product(rows, columns):
        field = shape_weights(scene, key, scene.target, (*x_ends, *y_ends))
        if field.sum() * discretization.cell > least:
            cells[f"cell {row} {column}"] = field
    if len(cells) < 2:
        raise SceneError(
            f"target.{scene.target.description}: has fewer than {2 * CELL_NODES} nodes along x and y, too few for "
            "search.objectives with kind = 'uniformity'; enlarge it, or use more nodes"
        )
    return cells

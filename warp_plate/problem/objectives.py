"""The objectives of a search: from energies of regions to values, and to the loss that is minimised.

Values are those of :mod:`warp_plate.quantities.region_quantities`. The loss is −Σ weight · value; for a single
localization with weight 1 it is 1 − LF, as in the source paper. A drive that passes a limit on motion or sound gets the
worst possible loss plus its relative excesses, so it ranks below every drive that keeps the limits.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, product

import numpy as np

from warp_plate.modal.solver import ModalGrid
from warp_plate.plate.scheme import Discretization
from warp_plate.plate.shapes import bounds, shape_weights
from warp_plate.plate.weights import REGIONS, CoilRegion, RegionLike, SoundRegion, localization_factor
from warp_plate.quantities.region_quantities import (
    LEAST_REST,
    MOST_DECIBELS,
    REGION_QUANTITIES,
    TARGET,
    RegionSizes,
    decibels,
    mean_square,
)
from warp_plate.quantities.sound_levels import POWER_REFERENCE, PRESSURE_REFERENCE
from warp_plate.scene.errors import SceneError
from warp_plate.scene.search import SOUNDS, Limits, Objective

# Largest number of cells, along each axis, into which the target is cut for its uniformity.
MOST_CELLS = 6
# Smallest number of nodes of such a cell along each axis.
CELL_NODES = 2
# Relative excess over a limit that counts as rounding in float32, and of a level [dB].
EXCESS, LEVEL_EXCESS = 1e-5, 5e-5
OF_THE_REST = " of the rest"


@dataclass(frozen=True)
class RegionLimit:
    """A limit on the energy of a region, or on what stands for one."""

    name: str  # its name in :meth:`Objectives.values`
    region: int  # index of the region
    energy: float  # largest energy [J], power [W] or square of an amplitude; or the least
    level: Callable[[np.ndarray], np.ndarray]  # function from energies (plates,) to values for people
    least: bool = False  # True if the energy must not be less

    def excess(self, energy: np.ndarray) -> np.ndarray:
        """Return by what part (plates,) energies (plates, regions) pass the limit; 0 where they keep it."""
        with np.errstate(divide="ignore"):
            ratio = energy[:, self.region] / self.energy
            return np.maximum((1 / np.maximum(ratio, 0) if self.least else ratio) - 1, 0)


@dataclass(frozen=True)
class Objectives:
    """The objectives of a scene on its grid."""

    terms: tuple[Objective, ...]  # the scene's objectives
    # regions that a solver must sum beside the plate and the target, by name: the cells of the target, as weights (ny,
    # nx), all targets of a scene with several, sounds, and quantities of coils
    regions: Mapping[str, RegionLike]
    sizes: RegionSizes  # areas and masses of target and rest, and areas of the target's cells
    region_limits: tuple[RegionLimit, ...] = ()  # limits on motion, sound and coils

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

    @property
    def plain(self) -> bool:
        """True if the loss is 1 − LF and no motion or sound is limited."""
        return self.only_localization and not self.region_limits

    def losses(self, energy: np.ndarray, displacement_energy: np.ndarray | None = None) -> np.ndarray:
        """Return losses (plates,) of energies (plates, regions) [J] of plate, target, and ``regions`` in their order.

        ``displacement_energy`` is the same of ½ ∫ ρH u² dA [J s²], for objectives that need displacements. Losses are
        not finite for a plate without energies, and NaN for one at rest whose localization, contrast or uniformity
        counts.
        """
        if self.plain:
            return 1 - localization_factor(energy)
        values, levels = self.values(energy, displacement_energy), ("contrast", *SOUNDS)
        losses = 1 - localization_factor(energy) if self.only_localization else -values["sum"]
        worst = MOST_DECIBELS * sum(term.weight for term in self.terms if term.kind in levels) + self.only_localization
        excess = self.excess(energy, values)
        return np.where(excess > 0, worst + excess, losses)

    def excess(self, energy: np.ndarray, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the sum (plates,) of the parts by which limits are passed; ``values`` are those of the energies."""
        parts = [np.maximum(values[name] / limit - 1, 0) for name, limit in self.limits.items()]
        parts += [limit.excess(energy) for limit in self.region_limits]
        return np.asarray(sum(parts, np.zeros(len(energy))))

    def values(self, energy: np.ndarray, displacement_energy: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Return values (plates,) by the objectives' kinds, also "of the rest" where these have them, those that are
        limited by name, and the objectives' weighted "sum"; the arguments are those of :meth:`losses`."""
        values: dict[str, np.ndarray] = {}
        for term in self.terms:
            quantity = REGION_QUANTITIES[term.kind]
            energies = energy if quantity.energy_of == "velocity" else displacement_energy
            if energies is None:
                raise ValueError(f"an objective of {term.kind} needs energies of displacement")
            values[term.kind] = quantity.evaluate(energies, self.sizes)
            if quantity.of_rest is not None:
                values[term.kind + OF_THE_REST] = quantity.of_rest(energies, self.sizes)
        values |= {limit.name: limit.level(energy[:, limit.region]) for limit in self.region_limits}
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
    limits, sounds = scene.search.limits, dict[str, SoundRegion]()
    if limits.sound is not None or any(term.kind in SOUNDS for term in terms):
        sounds["sound"] = SoundRegion()
    sounds |= {row.name: SoundRegion(row.point) for row in limits.pressures}
    coils = {
        f"{key} of {label}": CoilRegion(number, key)
        for key in limits.of_coils
        for number, label in enumerate(scene.coil_labels)
    }
    regions: dict[str, RegionLike] = {**cells, **scene.target_regions, **sounds, **coils}
    places = {name: len(REGIONS) + number for number, name in enumerate(regions)}
    sizes = RegionSizes(areas, masses, cell_areas, places.get("sound", -1))
    return Objectives(terms, regions, sizes, tuple(_region_limits(limits, sizes, places, coils)))


def _region_limits(
    limits: Limits, sizes: RegionSizes, places: Mapping[str, int], coils: Mapping[str, CoilRegion]
) -> Iterator[RegionLimit]:
    """Yield the limits on motion, sound and coils; ``places``: indices of regions by name."""
    if limits.least_velocity is not None:
        mass = sizes.masses[0]
        energy = mass * limits.least_velocity**2 / 2
        yield RegionLimit("velocity", TARGET, energy, lambda one: np.sqrt(mean_square(np.maximum(one, 0), mass)), True)
    named = [("sound", limits.sound, POWER_REFERENCE)] if limits.sound is not None else []
    named += [(row.name, row.level, PRESSURE_REFERENCE**2) for row in limits.pressures]
    for name, level, unit in named:
        yield RegionLimit(name, places[name], unit * 10 ** (level / 10), partial(decibels, reference=np.array(unit)))
    for name, coil in coils.items():
        value = limits.of_coils[coil.quantity]
        if coil.quantity == "heat":
            yield RegionLimit(name, places[name], value, np.asarray)
        else:
            yield RegionLimit(name, places[name], value**2, lambda square: np.sqrt(np.maximum(square, 0)))


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

"""A designed panel as a function of free numbers from 0 to 1: what it can do, and the slopes of that.

The free numbers are those of the map of thickness, then those of ``[design.free]`` between their limits, then x and y
of the middles of ``[design.places]``. Slopes by the map are those of :mod:`warp_plate.modal.sensitivity`; those by any
other number are in :mod:`warp_plate.designing.numbers`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from warp_plate.designing.numbers import NumberSlopes, panel_mass
from warp_plate.designing.thickness import ThicknessMap
from warp_plate.modal.assemble import Galerkin, make_galerkin
from warp_plate.modal.sensitivity import EnergyAdjoint, PlateMatrices, check_differentiable, thickness_slopes
from warp_plate.modal.solver import ModalSolver
from warp_plate.modal.spaces.integrals import mean_wave_frequency
from warp_plate.modal.spaces.knots import intervals_for
from warp_plate.modal.spaces.splines import Splines
from warp_plate.modal.spaces.tensor_splines import TensorSplines
from warp_plate.optimize.quadratic import quadratic_forms
from warp_plate.plate.designs import scene_phasors
from warp_plate.plate.section import laminate_of
from warp_plate.plate.weights import localization_factor
from warp_plate.result.designed import PanelValues
from warp_plate.scene.errors import SceneError
from warp_plate.scene.fit import Design
from warp_plate.scene.grid import Grid
from warp_plate.scene.keys import ALTERNATIVES, linked_keys, put, resolved_key, scalar_keys, value_of
from warp_plate.scene.model import Scene
from warp_plate.solve.response import largest_ratio

# Functions along each side, relative to those of other commands.
DENSITY = 0.7
# Grid of scenes that have none, and the key of the frequency.
NODES, TONE = (21, 21), "drive.frequency"
# Key of the target in a case of a scene with several.
AIM = "targets"
# Parts by which limits are narrower for the fewer functions of the search, of energies the second. Half of the
# first may be passed.
MARGIN, ENERGY_MARGIN = 2e-3, 1e-2
# Natural frequencies on either side of the gap that count, steepness of their aggregate, and the part of the gap's ends
# up to which a motion is rigid.
NEAR, STEEPNESS, STILL = 6, 500.0, 1e-3
# Step of differences of terms and fields, as a part of the range of a number.
STEP = 1e-4
# Numbers of attachments with slopes of their own.
ATTACHED_NUMBERS = ("mass", "stiffness", "damping")
# Most free numbers under limits: a step takes their cube.
MOST_LIMITED = 1000
# Numbers of actuators that are no part of the panel.
NO_PANEL = (*ALTERNATIVES, "phase", "frequency", "delay")
# Cases within about 1/SHARPNESS of the worst one count in slopes of the least value.
SHARPNESS = 100.0


@dataclass(frozen=True)
class Value:
    """Value of a panel, its limits, and their slopes."""

    least: float  # what is maximised: the least value of all cases; of an energy its logarithm to the base 10
    smooth: float  # smooth lower estimate of it, whose slopes these are
    slopes: np.ndarray  # (numbers,) slopes of ``smooth`` by the free numbers
    excess: np.ndarray  # (limits,) parts by which the limits are passed; 0 or less where they are kept
    excess_slopes: np.ndarray  # (limits, numbers) their slopes


class FreePanel:
    """The panels of a scene's table ``[design]``.

    Raises:
        SceneError: There is no such table, or slopes of the scene are not known.
    """

    def __init__(self, scene: Scene) -> None:
        if scene.design is None:
            raise SceneError("design: is missing; write [design.thickness], [design.free] or [design.places]")
        self.scene, self.design, self.below = scene, scene.design, 0
        check_differentiable(scene)
        self.thickness = None if scene.design.thickness is None else ThicknessMap(scene)
        if scene.piezo and self.thickness is not None:
            raise SceneError("design.thickness: not with piezo patches, which take a uniform plate; delete it")
        kinds = scalar_keys(scene)
        self._keys = [resolved_key(scene, name, kinds) for name in self.design.free]
        self._check_keys()
        ends = [*self.design.free.values(), *self._travel.values()]
        self._low, self._high = np.array(ends, dtype=float).reshape(-1, 2).T
        if self.design.limits.given and self.count > MOST_LIMITED:
            least = f"at most {MOST_LIMITED}; write a larger design.thickness.length_scale"
            raise SceneError(f"design.limits: {self.count} free numbers; with limits {least}")
        if self.thickness is not None and self.thickness.mass is not None:
            self.thickness.factors(np.full(self.thickness.count, 0.5))

    def _check_keys(self) -> None:
        """Raise a SceneError, naming the key, unless slopes by all free numbers are known."""
        lossy = [
            key for key, row in self.scene.effects.rows if any(term.multiple_of for term in row.terms(self.scene.plate))
        ]
        for name, key in zip(self.design.free, self._keys, strict=True):
            for inner in linked_keys(self.scene, key):
                table, _, last = inner.rpartition(".")
                if table in lossy:
                    raise SceneError(
                        f"design.free: {name}: slopes by the losses of all bending are not known; delete it"
                    )
                if inner.startswith("plate.size"):
                    raise SceneError(f"design.free: {name}: slopes are known for a panel of one size; delete it")
                if inner.startswith("actuators[") and last in NO_PANEL:
                    raise SceneError(f"design.free: {name}: is a number of the drive, not of the panel; delete it")
                massless = table in self._tables and last == "mass"
                if massless and not self.design.free[name][0] > 0:
                    raise SceneError(f"design.free: {name}: a mass of 0 is fixed to the ground; begin above it")

    @cached_property
    def _travel(self) -> dict[tuple[str, int], tuple[float, float]]:
        """Least and largest middle along x (0) and y (1) [m] of each patch that moves."""
        travel, movable = {}, self.scene.movable
        for key, area in self.design.places.items():
            box = movable[key].box
            for axis in (0, 1):
                half, (low, high) = (box[2 * axis + 1] - box[2 * axis]) / 2, area[2 * axis : 2 * axis + 2]
                if high - low < 2 * half:
                    raise SceneError(f"design.places.{key}: {list(area)} is smaller than the patch; write a larger one")
                travel[key, axis] = low + half, high - half
        return {key: ends for key, ends in travel.items() if ends[0] < ends[1]}

    @property
    def _mapped(self) -> int:
        return 0 if self.thickness is None else self.thickness.count

    @property
    def count(self) -> int:
        """Number of free numbers."""
        return self._mapped + self._low.size

    @cached_property
    def cases(self) -> list[dict[str, float]]:
        """Factors on numbers of the scene by key, and the frequency, of each case."""
        factors: list[dict[str, float]] = [{}]
        for name, part in self.design.tolerance.items():
            key = resolved_key(self.scene, name)
            factors += [{key: 1 - part}, {key: 1 + part}]
        frequencies = self.design.frequencies or (self.scene.drive.frequency,)
        tones = [{TONE: tone} for tone in frequencies]
        aims: list[dict[str, float]] = [{AIM: index} for index in range(len(self.scene.targets))] or [{}]
        return [{**case, **tone, **aim} for case, tone, aim in itertools.product(factors, tones, aims)]

    def start(self) -> np.ndarray:
        """Return the free numbers (count,) of the scene itself, as nearly as the ranges allow."""
        present = [np.empty(0) if self.thickness is None else self.thickness.numbers()]
        values = [value_of(self.scene, key) for key in self._keys]
        movable = self.scene.movable
        boxes = {key: movable[key].box for key, _ in self._travel}
        values += [sum(boxes[key][2 * axis : 2 * axis + 2]) / 2 for key, axis in self._travel]
        numbers = np.array([np.nan if value is None else value for value in values], dtype=float)
        present.append(np.clip(np.nan_to_num((numbers - self._low) / (self._high - self._low), nan=0.5), 0, 1))
        return np.concatenate(present)

    def draw(self, random: np.random.Generator) -> np.ndarray:
        """Return random free numbers (count,)."""
        drawn = np.empty(0) if self.thickness is None else self.thickness.draw(random)
        return np.concatenate([drawn, random.random(self._low.size)])

    def scene_at(self, numbers: np.ndarray, case: Mapping[str, float] | None = None) -> Scene:
        """Return the scene at free numbers (count,), and in a case, without the table ``[design]``."""
        scene = self._with_numbers(numbers[self._mapped :], case or {})
        return self._with_map(scene, numbers)

    def _with_map(self, scene: Scene, numbers: np.ndarray) -> Scene:
        if self.thickness is None:
            return scene
        factors = self.thickness.factors(numbers[: self._mapped])
        return scene.model_copy(update={"effects": scene.effects.with_thickness(factors.tolist())})

    def _with_numbers(self, shares: np.ndarray, case: Mapping[str, float]) -> Scene:
        values = self._low + shares * (self._high - self._low)
        numbers = dict(zip(self._keys, values[: len(self._keys)].tolist(), strict=True))
        scene = _in_case(self.scene.model_copy(update={"design": None}), numbers, case)
        middles = dict(zip(self._travel, values[len(self._keys) :].tolist(), strict=True))
        if not middles:
            return scene
        tables, movable = scene.model_dump(mode="json", include={"actuators", "effects"}), scene.movable
        for key in dict.fromkeys(key for key, _ in middles):
            patch = movable[key]
            x0, x1, y0, y1 = patch.box
            middle = middles.get((key, 0), (x0 + x1) / 2), middles.get((key, 1), (y0 + y1) / 2)
            for name, value in patch.placed(*middle).items():
                put(tables, f"{key}.{name}", value, key)
        return scene.with_tables(**tables)

    def _galerkin(self, numbers: np.ndarray, case: Mapping[str, float]) -> Galerkin:
        """Return the matrices of a panel."""
        return self._over_splines(self._with_map(self._with_numbers(numbers[self._mapped :], case), numbers))

    def _over_splines(self, scene: Scene) -> Galerkin:
        """Return the matrices of a scene over the splines of all panels."""
        return make_galerkin(scene, TensorSplines(scene, self._intervals, self._along))

    @cached_property
    def _along(self) -> tuple[Splines, Splines]:
        """Splines of all panels, which follow neither the map nor patches, so that values are smooth."""
        scene = self.scene
        if self.thickness is not None:
            flat = np.ones(self.thickness.shape).tolist()
            scene = scene.model_copy(update={"effects": scene.effects.with_thickness(flat)})
        return TensorSplines(scene, self._intervals).along

    @cached_property
    def _intervals(self) -> tuple[int, int]:
        highest, finer = max(case[TONE] for case in self.cases), self.scene.grid.modal_density
        wave = mean_wave_frequency(laminate_of(self.scene))
        return intervals_for(self.scene.plate.size, self.scene.outline, finer * highest, wave, finer * DENSITY)

    def evaluate(self, numbers: np.ndarray) -> Value:
        """Return what the panel at free numbers (count,) can do, and by what it passes its limits, with slopes.

        As many natural frequencies are to stay below the gap as ``below``, see :meth:`follow`.
        """
        solved, limits = [], list[tuple[float, np.ndarray]]()
        for index, case in enumerate(self.cases):
            galerkin = self._galerkin(numbers, case)
            adjoint = EnergyAdjoint(galerkin)
            solved.append(self._solve(adjoint, numbers, case))
            for excess, slopes, by_mass in self._limits(adjoint, galerkin, first=index == 0):
                of = NumberSlopes(galerkin, slopes, self._over_splines, by_mass)
                limits.append((excess, self._by_numbers(of, numbers, case)))
        values = np.array([value for value, _ in solved])
        weights = np.exp(-SHARPNESS * (values - values.min()))
        smooth = values.min() - np.log(weights.mean()) / SHARPNESS
        slopes = (weights / weights.sum()) @ np.stack([slopes for _, slopes in solved])
        passed = np.array([excess for excess, _ in limits])
        by_limit = np.array([slopes for _, slopes in limits]).reshape(-1, self.count)
        return Value(float(values.min()), float(smooth), slopes, passed, by_limit)

    def follow(self, numbers: np.ndarray) -> None:
        """Let as many natural frequencies stay below the gap as are below its middle at free numbers (count,)."""
        if (gap := self.design.limits.gap) is not None:
            natural = EnergyAdjoint(self._galerkin(numbers, self.cases[0])).natural
            self.below = int(np.searchsorted(natural, sum(gap) / 2))

    def _solve(
        self, adjoint: EnergyAdjoint, numbers: np.ndarray, case: Mapping[str, float]
    ) -> tuple[float, np.ndarray]:
        galerkin = adjoint.plate.galerkin
        value, phasors = _best(self.design, galerkin.scene, adjoint.matrices)
        plate, target = quadratic_forms(adjoint.matrices, phasors[None])[0]
        weights = np.array([0.0, 1 / (target * math.log(10))])
        if self.design.objective != "energy_target":
            weights = np.array([-value, 1.0]) / plate
        slopes = adjoint.slopes(phasors, weights)
        return value, self._by_numbers(NumberSlopes(galerkin, slopes, self._over_splines), numbers, case)

    def _limits(
        self, adjoint: EnergyAdjoint, galerkin: Galerkin, first: bool
    ) -> Iterator[tuple[float, PlateMatrices, float]]:
        """Yield the parts by which limits are passed, with slopes by the matrices and by the mass of the panel; those
        that the search keeps are narrower, for it takes fewer functions. Frequencies count in the ``first`` case."""
        limits, nothing = self.design.limits, adjoint.without_slopes
        if limits.mass is not None and first:
            most = limits.mass * (1 - MARGIN)
            yield panel_mass(galerkin) / most - 1, nothing, 1 / most
        if limits.energy_target is not None:
            phasors = scene_phasors(galerkin.scene)
            energy = quadratic_forms(adjoint.matrices, phasors[None])[0, 1]
            least = limits.energy_target * (1 + ENERGY_MARGIN)
            yield 1 - energy / least, adjoint.slopes(phasors, np.array([0.0, -1 / least])), 0.0
        if limits.gap is not None and first:
            low, high = limits.gap[0] * (1 - MARGIN), limits.gap[1] * (1 + MARGIN)
            lower = np.arange(max(self.below - NEAR, 0), self.below)
            for sign, end, near in ((1, low, lower), (-1, high, self.below + np.arange(NEAR))):
                near = near[adjoint.natural[near] > STILL * end]
                if near.size:  # the aggregate of Kreisselmeier and Steinhauser, smooth where frequencies are equal
                    ratios = adjoint.natural[near] / end
                    passed = sign * (ratios - 1)
                    weights = np.exp(STEEPNESS * (passed - passed.max()))
                    excess = passed.max() + math.log(weights.sum()) / STEEPNESS
                    yield excess, adjoint.frequency_slopes(near, sign * ratios * weights / weights.sum()), 0.0

    def _by_numbers(self, of: NumberSlopes, numbers: np.ndarray, case: Mapping[str, float]) -> np.ndarray:
        """Return the slopes (count,) by free numbers (count,) in a case of what has slopes by its matrices."""
        slopes, rows, width = np.zeros(self.count), dict(of.scene.effects.rows), self._high - self._low
        if self.thickness is not None:
            slopes[: self._mapped] = self.thickness.slopes(numbers[: self._mapped], thickness_slopes(of.of_fields))
        shares = numbers[self._mapped :]
        moving = [None] * len(self._keys) + list(self._travel)
        for index, (share, place) in enumerate(zip(shares.tolist(), moving, strict=True)):
            if place is not None and place[0] in self._tables:
                slopes[self._mapped + index] = width[index] * of.by_places[place[0]][place[1]]
                continue
            ends = np.clip(share + np.array([STEP, -STEP]), 0, 1)
            if (places := self._attached[index]) and not case.keys() & {".".join(place) for place in places}:
                values = (self._low[index] + ends * width[index]).tolist()
                changes = [
                    of.of_row(row, *(rows[row].model_copy(update={name: value}) for value in values))
                    for row, name in places
                ]
            else:
                scenes = (np.where(np.arange(shares.size) == index, end, shares) for end in ends)
                changes = [of.between(*(self._with_map(self._with_numbers(one, case), numbers) for one in scenes))]
            slopes[self._mapped + index] = sum(changes) / np.ptp(ends)
        return slopes

    @cached_property
    def _tables(self) -> set[str]:
        """Keys of the tables of attachments."""
        return set(self.scene.effects.attachment_keys(self.scene.plate))

    @cached_property
    def _attached(self) -> list[list[tuple[str, str]]]:
        """Tables and names of the numbers of attachments that each free number but for the map is; none of others."""
        places = []
        for key in self._keys:
            parts = [linked.rpartition(".") for linked in linked_keys(self.scene, key)]
            known = all(table in self._tables and name in ATTACHED_NUMBERS for table, _, name in parts)
            places.append([(table, name) for table, _, name in parts] if known else [])
        return places + [[] for _ in self._travel]

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of the free numbers but for the map, and of the coordinates of places."""
        return (*self._keys, *(f"{key}.{'xy'[axis]}" for key, axis in self._travel))

    def values(self, numbers: np.ndarray) -> tuple[float, ...]:
        """Return the values at free numbers (count,) of ``keys``."""
        return tuple((self._low + numbers[self._mapped :] * (self._high - self._low)).tolist())

    def exact(self, scene: Scene) -> PanelValues:
        """Return what a scene can do, and by what it passes its limits, by all functions of other commands."""
        solver, limits, excess = ModalSolver(gridded(scene), "cpu"), self.design.limits, dict[str, float]()
        bound, values, energies = solver.response.bound(), [], []
        for case in self.cases:
            other = _in_case(scene, {}, case)
            matrices = (solver if other is scene else ModalSolver(gridded(other), "cpu")).response.matrices
            values.append(self.shown(_best(self.design, other, matrices)[0]))
            energies.append(quadratic_forms(matrices, scene_phasors(other)[None])[0, 1])
        if limits.mass is not None:
            excess["mass"] = panel_mass(solver.plate.galerkin) / limits.mass - 1
        if limits.energy_target is not None:
            excess["energy_target"] = float(1 - min(energies) / limits.energy_target)
        if limits.gap is not None:
            (low, high), natural = limits.gap, solver.plate.frequencies
            inside = np.minimum(natural / low - 1, 1 - natural / high)
            excess["gap"] = float(inside.max())
        return PanelValues(bound, min(values), excess)

    def shown(self, value: float) -> float:
        """Return what is maximised from a value: of an energy, which counts by its logarithm, the energy [J]."""
        return 10**value if self.design.objective == "energy_target" else value


def _in_case(scene: Scene, values: Mapping[str, float], case: Mapping[str, float]) -> Scene:
    """Return a scene with numbers by key, in a case of the tolerances and frequencies; SceneError: out of range."""
    changed: dict[str, Any] = dict(values)
    for key in case.keys() - {AIM}:
        changed[key] = case[key] if key == TONE else case[key] * changed.get(key, value_of(scene, key))
    changed = {key: value for key, value in changed.items() if value_of(scene, key) != value}
    try:
        scene = scene.with_values(changed) if changed else scene
    except SceneError as error:
        raise SceneError(f"design.free: a range reaches too far: {error}") from None
    return scene.aimed_at(int(case[AIM])) if AIM in case else scene


def gridded(scene: Scene) -> Scene:
    """Return a scene with some grid, which modes do not need."""
    if scene.grid.accuracy is None:
        return scene
    return scene.model_copy(update={"grid": Grid(nodes=NODES, modal_density=scene.grid.modal_density)})


def _best(design: Design, scene: Scene, matrices: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the value of Gram matrices of plate and target, and the phasors (M,) that have it."""
    if design.objective == "drive":
        phasors = scene_phasors(scene)
        return float(localization_factor(quadratic_forms(matrices, phasors[None]))[0]), phasors
    if design.objective == "energy_target":
        phasors = scene_phasors(scene)
        return math.log10(quadratic_forms(matrices, phasors[None])[0, 1]), phasors
    value, z = largest_ratio(matrices)
    if not np.isfinite(value):
        raise SceneError("actuators: no drive moves the plate; move them off the edges")
    cosine, sine = np.split(z, 2)
    return float(value), cosine - 1j * sine

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
from functools import cached_property, partial
from typing import Any

import numpy as np

from warp_plate.designing.functions import PanelFunctions, is_shape, shape_step
from warp_plate.designing.mode_names import NamedModes
from warp_plate.designing.numbers import SMOOTH_STEP, STEP, NumberSlopes, PanelSlopes, panel_mass
from warp_plate.designing.objectives import NEAR, check_gap, check_steady, judge, largest, limits, shown, uses_sound
from warp_plate.designing.thickness import ThicknessMap
from warp_plate.modal.assemble import make_galerkin
from warp_plate.modal.modes import solve_modes
from warp_plate.modal.sensitivity.adjoint import EnergyAdjoint, check_differentiable
from warp_plate.modal.sensitivity.forms import PlateForms, PlateMatrices
from warp_plate.modal.spaces.chords import Chords
from warp_plate.plate.signals import highest_frequency
from warp_plate.result.designed import PanelValues
from warp_plate.scene.errors import SceneError, under
from warp_plate.scene.keys import ALTERNATIVES, key_parts, linked_keys, put, resolved_key, scalar_keys, value_of
from warp_plate.scene.model import Scene

# Keys of the frequency in a case, and of the target in one of a scene with several.
TONE, AIM = "drive.frequency", "targets"
# Parts by which limits are narrower for the fewer functions of the search, of energies the second. Half of the
# first may be passed.
MARGIN, ENERGY_MARGIN = 2e-3, 1e-2
# Steepness of the aggregate of natural frequencies at the gap, and the part of its ends up to which a motion is rigid.
STEEPNESS, STILL = 500.0, 1e-3
# Numbers of attachments with slopes of their own.
ATTACHED_NUMBERS = ("mass", "stiffness", "damping")
# Numbers of actuators that are no part of the panel.
NO_PANEL = (*ALTERNATIVES, "phase", "frequency", "delay")
# Cases within about 1/SHARPNESS of the worst one count in slopes of the least value.
SHARPNESS = 100.0


@dataclass(frozen=True)
class Value:
    """Value of a panel, its limits, and their slopes."""

    least: float  # what is maximised: the least value of all cases, see :mod:`warp_plate.designing.objectives`
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
        check_steady(self.design, scene)
        check_differentiable(scene, self.design.steady)
        self.thickness = None if scene.design.thickness is None else ThicknessMap(scene, self._rule)
        if scene.piezo and self.thickness is not None:
            raise SceneError("design.thickness: not with piezo patches, which take a uniform plate; delete it")
        kinds = scalar_keys(scene)
        self._keys = [resolved_key(scene, name, kinds) for name in self.design.free]
        self._check_keys()
        ends = [*self.design.free.values(), *self._travel.values()]
        self._low, self._high = np.array(ends, dtype=float).reshape(-1, 2).T
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
                if is_shape(inner) and (self.thickness is not None or self._loaded):
                    other = "a map of thickness" if self.thickness is not None else "air or a sound"
                    raise SceneError(f"design.free: {name}: a shape is not free beside {other}; delete one")
                if inner.startswith("supports[") and value_of(self.scene, inner) is None:
                    raise SceneError(f"design.free: {name}: the support is rigid; write a stiffness for it")
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

    @cached_property
    def _functions(self) -> PanelFunctions:
        scene = self.scene
        if self.thickness is not None:
            flat = np.ones(self.thickness.shape).tolist()
            scene = scene.model_copy(update={"effects": scene.effects.with_thickness(flat)})
        keys = [*self._keys, *(resolved_key(scene, name) for name in self.design.tolerance)]
        shaped = any(is_shape(inner) for key in keys for inner in linked_keys(scene, key))
        return PanelFunctions(scene, max(case[TONE] for case in self.cases), shaped)

    @property
    def _loaded(self) -> bool:
        """Whether air beside the plate counts."""
        return uses_sound(self.design) or self.scene.effects.air is not None

    def _rule(self) -> tuple[np.ndarray, np.ndarray]:
        """Return points (n, 2) [m] and weights (n,) [m²] on a plate with an outline, cut at the lines of the map."""
        rule = self._functions.space.rule
        assert isinstance(rule, Chords)
        return np.stack([rule.x.ravel(), rule.y.ravel()], axis=1), rule.weights.ravel()

    def _adjoint(self, numbers: np.ndarray, case: Mapping[str, float]) -> EnergyAdjoint:
        """Return the motion of a panel, with its matrices."""
        scene = self.scene_at(numbers, case)
        galerkin = make_galerkin(scene, self._functions.of_scene(scene))
        air = self._functions.air(case[TONE]) if self._loaded else None
        return EnergyAdjoint(galerkin, steady=self.design.steady, air=air)

    def evaluate(self, numbers: np.ndarray, sloped: bool = True) -> Value:
        """Return what the panel at free numbers (count,) can do, and by what it passes its limits, with slopes or not.

        As many natural frequencies are to stay below the gap as ``below``, see :meth:`follow`.
        """
        solved, passed, slopes, by_limit = [], list[float](), [], []
        for index, case in enumerate(self.cases):
            adjoint = self._adjoint(numbers, case)
            judged = [judge(self.design, adjoint), *(one for _, one in limits(self.design, adjoint, ENERGY_MARGIN))]
            of_panel = list(self._panel_limits(adjoint)) if index == 0 else []
            solved.append(judged[0].value)
            passed += [*(one.value for one in judged[1:]), *(excess for excess, *_ in of_panel)]
            if not sloped:
                continue
            by = [PanelSlopes(adjoint.slopes(one.phasors, one.weights), by_target=one.by_target) for one in judged]
            by += [PanelSlopes(by_matrices, by_mass) for _, by_matrices, by_mass in of_panel]
            galerkin = adjoint.plate.galerkin
            of = NumberSlopes(galerkin, partial(self._functions.of_scene, near=galerkin.space), by)
            first, *others = self._by_numbers(of, numbers, case)
            slopes.append(first)
            by_limit += others
        values = np.array(solved)
        weights = np.exp(-SHARPNESS * (values - values.min()))
        smooth = values.min() - np.log(weights.mean()) / SHARPNESS
        by_limits = np.array(by_limit).reshape(-1, self.count)
        mean = (weights / weights.sum()) @ np.stack(slopes) if sloped else np.empty(0)
        return Value(float(values.min()), float(smooth), mean, np.array(passed), by_limits)

    def follow(self, numbers: np.ndarray) -> None:
        """Let as many natural frequencies stay below the gap as are below its middle at free numbers (count,)."""
        if (gap := self.design.limits.gap) is not None:
            natural = self._adjoint(numbers, self.cases[0]).natural
            check_gap(self.design, natural)
            self.below = int(np.searchsorted(natural, sum(gap) / 2))

    def _panel_limits(self, adjoint: EnergyAdjoint) -> Iterator[tuple[float, PlateMatrices, float]]:
        """Yield the parts by which limits of the panel itself are passed, with slopes by the matrices and by the mass
        of the panel; those that the search keeps are narrower, for it takes fewer functions."""
        limits, nothing = self.design.limits, adjoint.without_slopes
        if limits.mass is not None:
            most = limits.mass * (1 - MARGIN)
            yield panel_mass(adjoint.plate.galerkin) / most - 1, nothing, 1 / most
        if limits.gap is not None:
            low, high = limits.gap[0] * (1 - MARGIN), limits.gap[1] * (1 + MARGIN)
            lower, upper = np.split(np.arange(adjoint.natural.size), [self.below])
            for sign, end, near in ((1, low, lower[-NEAR:]), (-1, high, upper[:NEAR])):
                near = near[adjoint.natural[near] > STILL * end]
                if near.size:  # the aggregate of Kreisselmeier and Steinhauser, smooth where frequencies are equal
                    ratios = adjoint.natural[near] / end
                    passed = sign * (ratios - 1)
                    weights = np.exp(STEEPNESS * (passed - passed.max()))
                    excess = passed.max() + math.log(weights.sum()) / STEEPNESS
                    yield excess, adjoint.frequency_slopes(near, sign * ratios * weights / weights.sum()), 0.0

        places = self._named.among(adjoint.plate.space, adjoint.shapes)
        for (low, high), at in zip(limits.modes.values(), places, strict=True):
            for sign, end in ((-1, low * (1 + MARGIN)), (1, high * (1 - MARGIN))):
                ratio = float(adjoint.natural[at] / end)
                yield sign * (ratio - 1), adjoint.frequency_slopes(np.array([at]), np.array([sign * ratio])), 0.0

    @cached_property
    def _named(self) -> NamedModes:
        """Modes of the scene whose frequencies are limited."""
        return NamedModes(self.scene, map(int, self.design.limits.modes), self._functions.space.unknowns)

    def _by_numbers(self, of: NumberSlopes, numbers: np.ndarray, case: Mapping[str, float]) -> np.ndarray:
        """Return the slopes (n, count) by free numbers (count,) in a case of n numbers with slopes by the panel."""
        slopes, rows = np.zeros((of.count, self.count)), dict(of.scene.effects.rows)
        width = self._high - self._low
        if self.thickness is not None:
            for by_number, by_map in zip(slopes, of.of_fields.by_thickness(), strict=True):
                by_number[: self._mapped] = self.thickness.slopes(numbers[: self._mapped], by_map)
        shares = numbers[self._mapped :]
        moving = [None] * len(self._keys) + list(self._travel)
        for index, (share, place) in enumerate(zip(shares.tolist(), moving, strict=True)):
            if place is not None and place[0] in self._tables:
                slopes[:, self._mapped + index] = width[index] * of.by_places[place[0]][:, place[1]]
                continue
            if place is not None and place[0].startswith("actuators["):
                by_place = of.by_place_of_actuator(int(key_parts(place[0])[1]), place[1])
                if by_place is not None:
                    slopes[:, self._mapped + index] = width[index] * by_place
                    continue
            if (places := self._attached[index]) and not case.keys() & {".".join(place) for place in places}:
                ends = np.clip(share + np.array([STEP, -STEP]), 0, 1)
                values = (self._low[index] + ends * width[index]).tolist()
                changes = [
                    of.of_row(row, *(rows[row].model_copy(update={name: value}) for value in values))
                    for row, name in places
                ]
                slopes[:, self._mapped + index] = sum(changes) / np.ptp(ends)
                continue

            def scene_at(point: float, index: int = index) -> Scene:
                one = np.where(np.arange(shares.size) == index, point, shares)
                return self._with_map(self._with_numbers(one, case), numbers)

            if place is not None and (layer := of.edged_layer(place[0])) is not None:
                by_edges = width[index] * of.of_fields.by_place(layer, place[1])
                slopes[:, self._mapped + index] = by_edges + of.along(scene_at, share, STEP, change=of.change_in_target)
                continue
            step, count = (STEP, 5) if place else (SMOOTH_STEP, 3)
            shapes = [] if place else [key for key in linked_keys(self.scene, self._keys[index]) if is_shape(key)]
            if shapes:
                value, room = self._low[index] + share * width[index], min(share, 1 - share) * width[index]
                step, count = shape_step(of.of_fields.space, shapes, float(value), float(room))
                step /= width[index]
            slopes[:, self._mapped + index] = of.along(scene_at, share, step, count)
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

    def exact(self, scene: Scene, density: float = 1.0) -> PanelValues:
        """Return what a scene can do, and by what it passes its limits, by all functions of other commands, or
        ``density`` times as many along each side."""
        nominal, given, excess = self._forms(scene, density), self.design.limits, dict[str, float]()
        bound, values = largest(np.stack([nominal["plate"], nominal["target"]]))[0], []
        for case in self.cases:
            other = _in_case(scene, {}, case)
            forms = nominal if other is scene else self._forms(other, density, case)
            values.append(judge(self.design, forms).value)
            for key, one in limits(self.design, forms):
                excess[key] = max(one.value, excess.get(key, -math.inf))
        if given.mass is not None:
            excess["mass"] = panel_mass(nominal.plate.galerkin) / given.mass - 1
        if given.gap is not None:
            (low, high), natural = given.gap, nominal.plate.frequencies
            check_gap(self.design, natural)
            inside = np.minimum(natural / low - 1, 1 - natural / high)
            excess["gap"] = float(inside.max())
        plate = nominal.plate
        places = self._named.among(plate.space, plate.vectors)
        for (number, (low, high)), at in zip(given.modes.items(), places, strict=True):
            excess[f"mode {number}"] = float(max(1 - plate.frequencies[at] / low, plate.frequencies[at] / high - 1))
        return PanelValues(bound, self.shown(min(values)), excess)

    def _forms(self, scene: Scene, density: float, case: Mapping[str, float] | None = None) -> PlateForms:
        """Return the forms of a scene, which is that of a case or the nominal one."""
        key = None
        if case is not None and self.design.frequencies is not None:
            key = f"design.frequencies: {case[TONE]:g} Hz"
        with under(_tolerance(case or {})):
            plate = solve_modes(scene, highest=density * highest_frequency(scene), density=density, key=key)
            return PlateForms(plate, self.design.steady)

    def shown(self, value: float) -> float:
        """Return the quantity that is maximised, or lowered, in its unit."""
        return shown(self.design, value)


def _in_case(scene: Scene, values: Mapping[str, float], case: Mapping[str, float]) -> Scene:
    """Return a scene with numbers by key, in a case of the tolerances and frequencies; SceneError: out of range."""
    changed: dict[str, Any] = dict(values)
    for key in case.keys() - {AIM}:
        changed[key] = case[key] if key == TONE else case[key] * changed.get(key, value_of(scene, key))
    changed = {key: value for key, value in changed.items() if value_of(scene, key) != value}
    with under(_tolerance(case) or "design.free: a range reaches too far"):
        scene = scene.with_values(changed) if changed else scene
    return scene.aimed_at(int(case[AIM])) if AIM in case else scene


def _tolerance(case: Mapping[str, float]) -> str:
    """Return the key of the tolerances with that of a case; "" of a case without."""
    return "".join(f"design.tolerance: {key} × {case[key]:g}" for key in case.keys() - {TONE, AIM})

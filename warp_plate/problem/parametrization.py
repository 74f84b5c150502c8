"""Positions of a search and their meaning: drives, places with their clearance, frequencies, and a scene.

Without a table that names design variables the search is the source paper's (section II.C of Jo, Yang and Shin, 2024):
a position is w₂ ... w_M, φ₂ ... φ_M with w₁ = 1 and φ₁ = 0, first drawn from −2 ... 2 and without limits, because a
common factor does not change the localization factor, nor does a common phase once the plate vibrates steadily (in the
scene ``paper`` what is left of the start moves it by 4e-5). With limits, and for velocities, φ₁ is searched too unless
the motion is steady. With tables, the variables have the limits that they give, in the scene's own units, and the rest
stays as the scene has it. Z = w exp(−iφ) either way.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np

from warp_plate.optimize.optimizer import SearchSpace
from warp_plate.plate.designs import Designs, patch_ends, scene_with
from warp_plate.plate.signals import actuator_delays, actuator_frequencies
from warp_plate.problem.design_variables import (
    DesignVariable,
    fixed_magnitudes,
    has_design_tables,
    magnitude_unit,
    make_design_variables,
    only_ratios,
)
from warp_plate.quantities.region_quantities import MOST_DECIBELS
from warp_plate.row_blocks import over_blocks
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# Values that every batch of designs has; others are made where they are searched.
DRIVES = ("magnitude", "phase")
# Part of the plate's longer side by which rounding may bring two actuators nearer.
SLACK = 1e-9


@dataclass(frozen=True)
class Parametrization:
    """The design variables of a scene."""

    scene: Scene  # scene whose time step carries every frequency that may be chosen, see ``with_common_step``
    variables: tuple[DesignVariable, ...]  # design variables in the order of their numbers in a position

    @cached_property
    def space(self) -> SearchSpace:
        """The numbers of a position without their meaning."""
        rows = [(variable.lower, variable.upper, *variable.initial, variable.period) for variable in self.variables]
        names = tuple(variable.name for variable in self.variables)
        return SearchSpace(names, *np.array(rows, dtype=float).reshape(-1, 5).T)

    @property
    def only_drives(self) -> bool:
        """True if nothing but magnitudes and phases is searched."""
        return all(variable.is_drive for variable in self.variables)

    @cached_property
    def without_drives(self) -> Parametrization:
        """The same without magnitudes and phases."""
        return Parametrization(self.scene, tuple(variable for variable in self.variables if not variable.is_drive))

    @property
    def quadratic(self) -> bool:
        """True if every energy is a quadratic form of the phasors, so that Gram matrices hold for all positions."""
        return self.scene.linear and self.only_drives

    @cached_property
    def unit(self) -> float:
        """Drive that a magnitude of one stands for [N/m², or V: ``Scene.drive_unit``]."""
        return 1.0 if has_design_tables(self.scene) else magnitude_unit(self.scene)

    def designs(self, positions: np.ndarray) -> Designs:
        """Return the designs of positions (n, dimension), within the scene's limits of drives."""
        positions, shape = np.asarray(positions, dtype=float), (len(self.scene.actuators), len(positions))
        # Plates innermost: NumPy is slow along short rows.
        phasors, others = np.empty(shape, dtype=complex), {kind: np.empty(shape) for kind in self._kinds[2:]}

        def fill(plates: slice) -> None:
            values = self._values(positions[plates])
            block = phasors[:, plates]
            self._rotate(values["phase"], block)
            block *= self._limited(values["magnitude"])
            block *= self.unit
            for kind, numbers in others.items():
                numbers[:, plates] = values[kind]

        over_blocks(fill, len(positions))
        centre = np.stack([others["x"].T, others["y"].T], axis=2) if "x" in others else None
        frequency, delay = (others[kind].T if kind in others else None for kind in ("frequency", "delay"))
        return Designs(phasors.T, frequency, centre, delay)

    def positions_of(self, designs: Designs) -> np.ndarray:
        """Return the positions (n, dimension) of designs, clipped to the limits of the space.

        Where the first actuator's phase is fixed because a common one changes nothing, all phases are shifted until it
        fits, if it has one; with the source paper's reading magnitudes are scaled likewise, and under a power limit
        within ranges.
        """
        # A phase belongs to a magnitude of the scene's sign where that is not searched.
        phasors, fixed = designs.drives / self.unit * np.where(self._least < 0, -1, 1), self._fixed
        if not any(variable.kind == "phase" and 0 in variable.actuators for variable in self.variables):
            first = phasors[:, :1]
            phasors = phasors * np.where(first == 0, 1, np.exp(-1j * (np.angle(first) + fixed["phase"][0])))
        level = any(variable.kind == "magnitude" and 0 in variable.actuators for variable in self.variables)
        if not level and not has_design_tables(self.scene) and not self.scene.search.limits.equal_magnitudes:
            with np.errstate(divide="ignore", invalid="ignore"):
                phasors = np.nan_to_num(phasors / np.abs(phasors[:, :1])) * self._least[0]
        if self.scene.search.limits.power is not None and has_design_tables(self.scene) and not only_ratios(self.scene):
            # A drive that was scaled down to the power is scaled up until all magnitudes are within their ranges.
            with np.errstate(divide="ignore", invalid="ignore"):
                raised = np.nan_to_num(np.abs(self._least) / np.abs(phasors), posinf=1.0).max(axis=1, keepdims=True)
            phasors = phasors * np.maximum(raised, 1.0)
        x, y = (None, None) if designs.centre is None else np.moveaxis(designs.centre, 2, 0)
        values = {"frequency": designs.frequency, "x": x, "y": y, "delay": designs.delay}
        values |= {"magnitude": np.abs(phasors), "phase": np.mod(-np.angle(phasors), 2 * math.pi)}
        positions = np.empty((len(designs), len(self.variables)))
        for column, variable in zip(positions.T, self.variables, strict=True):
            array = values[variable.kind]
            column[:] = variable.fixed if array is None else array[:, variable.actuators[0]]
        return np.clip(positions, self.space.lower, self.space.upper)

    def drive(self, position: np.ndarray) -> np.ndarray:
        """Return the phasors (actuators,) of a position (dimension,) as a result has them.

        With the source paper's reading the first actuator has magnitude 1. If only ratios matter and no limit says
        otherwise, the drive is scaled so that none is stronger than the strongest of the scene.
        """
        phasors = self.designs(position[None]).drives[0]
        limits = self.scene.search.limits
        if has_design_tables(self.scene) or not only_ratios(self.scene) or limits.magnitude or limits.power:
            return phasors
        return np.asarray(phasors * _scale_down(self.unit, np.abs(phasors).max()))

    def scene_of(self, position: np.ndarray) -> Scene:
        """Return the scene with the design of a position (dimension,), which runs as the position's plate does."""
        values = {kind: array[:, 0] for kind, array in self._values(np.asarray(position, dtype=float)[None]).items()}
        return scene_with(
            self.scene,
            self.unit * self._limited(values["magnitude"][:, None])[:, 0],
            values["phase"],
            values.get("frequency"),
            np.stack([values["x"], values["y"]], axis=1) if "x" in values else None,
            values.get("delay"),
        )

    def _values(self, positions: np.ndarray) -> dict[str, np.ndarray]:
        """Return arrays (actuators, n) of each kind that may differ between plates, before limits of drives."""
        if positions.ndim != 2 or positions.shape[1] != len(self.variables):
            raise ValueError(f"positions of shape {positions.shape}: must be (n, {len(self.variables)})")
        values = {kind: np.tile(self._fixed[kind][:, None], len(positions)) for kind in self._kinds}
        for column, variable in zip(positions.T, self.variables, strict=True):
            variable.apply(column, values)
        return values

    @cached_property
    def _kinds(self) -> tuple[str, ...]:
        """Kinds of values that may differ between plates; magnitudes and phases are always among them."""
        kinds = {variable.kind for variable in self.variables}
        kinds |= {"x", "y"} if kinds & {"x", "y"} else set()
        return (*DRIVES, *sorted(kinds - set(DRIVES)))

    @cached_property
    def _fixed(self) -> dict[str, np.ndarray]:
        """(actuators,) values of each kind as the scene has them; in the paper's reading magnitude 1 and phase 0."""
        actuators, tables = self.scene.actuators, has_design_tables(self.scene)
        x, y = patch_ends(actuators).mean(axis=2).T
        return {
            "magnitude": fixed_magnitudes(self.scene) if tables else np.ones(len(actuators)),
            "phase": np.array([actuator.phase if tables else 0.0 for actuator in actuators]),
            "frequency": actuator_frequencies(self.scene),
            "delay": actuator_delays(self.scene),
            "x": x,
            "y": y,
        }

    @cached_property
    def _least(self) -> np.ndarray:
        """(actuators,) least magnitudes; those of the scene, within its limit, where they are not searched."""
        least, most = self._fixed["magnitude"].copy(), self.scene.search.limits.magnitude
        if most is not None and not only_ratios(self.scene):
            least = np.clip(least, -most / self.unit, most / self.unit)
        for variable in self.variables:
            if variable.kind == "magnitude":
                least[list(variable.actuators)] = max(variable.lower, 0.0)
        return least

    def _rotate(self, phase: np.ndarray, rotations: np.ndarray) -> None:
        """Write exp(−iφ) of phases (actuators, n) into an array (actuators, n); of those that are fixed only once."""
        searched = {index for variable in self.variables if variable.kind == "phase" for index in variable.actuators}
        for index, row in enumerate(rotations):
            if index in searched:
                np.multiply(-1j, phase[index], out=row)
                np.exp(row, out=row)
            else:
                row[:] = np.exp(-1j * self._fixed["phase"][index]) + 0

    def _limited(self, magnitude: np.ndarray) -> np.ndarray:
        """Return magnitudes (actuators, n) in units of ``unit``, clipped or scaled down to the scene's limits."""
        limits = self.scene.search.limits
        if limits.magnitude is not None:
            most = limits.magnitude / self.unit
            if only_ratios(self.scene):
                magnitude = magnitude * _scale_down(most, np.abs(magnitude).max(axis=0))
            else:
                magnitude = np.clip(magnitude, -most, most)
        if limits.power is not None:
            size = np.sqrt(reduce(np.add, magnitude**2))  # in the same order for any number of plates
            magnitude = magnitude * _scale_down(math.sqrt(limits.power) / self.unit, size)
        return magnitude


def parametrization_of(scene: Scene) -> Parametrization:
    """Return the parametrization of a scene's ``[search]``, see :func:`make_design_variables`."""
    return Parametrization(scene, make_design_variables(scene))


def paper_phasors(positions: np.ndarray) -> np.ndarray:
    """Return the phasors Z (n, actuators) of the source paper's positions (n, 2·(actuators − 1)): Z = w exp(−iφ)."""
    magnitude, phase = np.split(np.asarray(positions, dtype=float), 2, axis=1)
    first = np.ones((len(magnitude), 1), dtype=complex)
    return np.concatenate([first, magnitude * np.exp(-1j * phase)], axis=1)


def _scale_down(most: float, sizes: np.ndarray) -> np.ndarray:
    """Return factors (n,) or a factor that bring sizes (n,) down to ``most``; one where they are no larger."""
    return np.asarray(most / np.maximum(sizes, most))


class Clearance:
    """The clearance of ``[search.position]``: room along x or y between patches of which at least one moves."""

    def __init__(self, scene: Scene) -> None:
        table, self._scene = scene.search.position, scene
        size = np.ptp(patch_ends(scene.actuators), axis=2)
        names = [actuator.name for actuator in scene.actuators]
        moves = np.array([table is not None and name in (table.actuators or names) for name in names])
        first, second = np.triu_indices(len(names), k=1)
        counts = moves[first] | moves[second]
        self._first, self._second = first[counts], second[counts]
        least = table.clearance if table is not None else 0.0
        self._distances = (size[self._first] + size[self._second]) / 2 + least

    def shortfall(self, centre: np.ndarray) -> np.ndarray:
        """Return how much room (n,) [m] the nearest pair of patches lacks at centres (n, actuators, 2) [m]."""
        if not self._first.size:
            return np.zeros(len(centre))
        lacking = (self._distances - np.abs(self._between(centre))).min(axis=2).max(axis=1)
        return np.where(lacking > SLACK * max(self._scene.plate.size), lacking, 0.0)

    def losses(self, designs: Designs, losses: np.ndarray) -> np.ndarray:
        """Return the losses (n,) of designs, beyond any other where patches lack room, the more so the more they do."""
        if designs.centre is None:
            return losses
        lacking = self.shortfall(designs.centre) / max(self._scene.plate.size)
        worst = 1 + MOST_DECIBELS * sum(term.weight for term in self._scene.search.objectives)
        return np.where(lacking > 0, worst + lacking, losses)

    def slopes(self, centre: np.ndarray) -> np.ndarray:
        """Return the slopes (n, actuators, 2) [1/m] of :meth:`losses` where patches lack room: those of the nearest
        pair, along the axis on which it lacks less."""
        between = self._between(centre)
        lacking = self._distances - np.abs(between)
        axis, rows = lacking.argmin(axis=2), np.arange(len(centre))
        pair = lacking.min(axis=2).argmax(axis=1)
        axis = axis[rows, pair]
        slopes, push = np.zeros(centre.shape), np.where(between[rows, pair, axis] < 0, -1, 1)
        slopes[rows, self._first[pair], axis] = push / max(self._scene.plate.size)
        slopes[rows, self._second[pair], axis] = -push / max(self._scene.plate.size)
        return slopes

    def refuse(self, designs: Designs) -> None:
        """Raise SceneError where patches lack room."""
        if designs.centre is not None and self.shortfall(designs.centre).any():
            table = self._scene.search.position
            assert table is not None
            raise SceneError(
                f"search.position.clearance = {table.clearance:g}: no places were found at which all actuators keep "
                "it; write a smaller one, a larger search.position.area, or more particles"
            )

    def constraints(self, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return matrix (pairs, 2 actuators) and least values (pairs,) [m] of matrix @ centres, x and y interleaved,
        that keep each pair apart along the axis, and on the side, on which it has most room at centres [m]."""
        between = self._between(centre[None])[0]
        axis = np.argmax(np.abs(between) - self._distances, axis=1)
        pairs = np.arange(axis.size)
        sign = np.sign(between[pairs, axis])
        matrix = np.zeros((axis.size, centre.size))
        matrix[pairs, 2 * self._first + axis] = -sign
        matrix[pairs, 2 * self._second + axis] = sign
        return matrix, self._distances[pairs, axis]

    def _between(self, centre: np.ndarray) -> np.ndarray:
        """Return (n, pairs, 2) vectors from the first to the second centre of each pair."""
        return np.asarray(centre[:, self._second] - centre[:, self._first])

"""What a scene's search may choose: from a position, a row of numbers, to drives, places, frequencies, and a scene.

Without a table that has_design_tables something the search is the source paper's (section II.C of Jo, Yang and Shin,
2024): a
position is w₂ ... w_M, φ₂ ... φ_M with w₁ = 1 and φ₁ = 0, first drawn from −2 ... 2 and without limits, because a
common factor does not change the localization factor, nor does a common phase once the plate vibrates steadily (in the
scene ``paper`` what is left of the start moves it by 4e-5). With such tables, what they free has the limits that they
give, in the scene's own units, and the rest stays as the scene has it. Z = w exp(−iφ) either way.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial, reduce
from typing import ClassVar

import numpy as np

from warp_plate.optimize.space import Space
from warp_plate.plate.designs import Designs
from warp_plate.plate.row_blocks import GrowingRows, over_blocks
from warp_plate.plate.scene_overrides import actuator_centres, scene_with
from warp_plate.plate.signals import actuator_delays, actuator_frequencies
from warp_plate.problem.design_variables import DesignVariable, has_design_tables, make_design_variables, only_ratios
from warp_plate.scene.model import Scene


@dataclass(frozen=True)
class Parametrization:
    """A scene's free numbers, in the order in which they stand in a position.

    scene: whose time step carries every frequency that may be found, see ``with_common_step``.
    """

    scene: Scene
    numbers: tuple[DesignVariable, ...]

    @cached_property
    def space(self) -> Space:
        """The numbers without their meaning, for methods."""
        columns = [(one.lower, one.upper, *one.first, one.period) for one in self.numbers]
        return Space(tuple(one.name for one in self.numbers), *np.array(columns, dtype=float).reshape(-1, 5).T)

    @property
    def only_drives(self) -> bool:
        """Whether nothing but drives is searched."""
        return all(one.kind in ("magnitude", "phase") for one in self.numbers)

    @property
    def quadratic(self) -> bool:
        """Whether every energy is a quadratic form of the drive, so that Gram matrices hold for all positions."""
        return self.scene.linear and self.only_drives

    @cached_property
    def unit(self) -> float:
        """What a magnitude of one stands for [N/m², or V: ``Scene.drive_unit``]."""
        return 1.0 if has_design_tables(self.scene) else magnitude_unit(self.scene)

    def designs(self, positions: np.ndarray) -> Designs:
        """What the plates of positions (n, dimension) have of their own; within the scene's limits of drives."""
        positions = np.asarray(positions, dtype=float)
        shape = (len(self.scene.actuators), len(positions))
        # Plates innermost: NumPy is slow along short rows.
        drives = np.empty(shape, dtype=complex)
        own = {kind: np.empty(shape) for kind in self._kinds - {"magnitude", "phase"}}

        def fill(rows: slice) -> None:
            values = self._values(positions[rows])
            some = drives[:, rows]
            np.multiply(self._limited(values["magnitude"]), self._turns(values["phase"]), out=some)
            some *= self.unit
            for kind, into in own.items():
                into[:, rows] = values[kind]

        over_blocks(fill, len(positions))
        centre = np.stack([own["x"].T, own["y"].T], axis=2) if "x" in own else None
        frequency, delay = (own[kind].T if kind in own else None for kind in ("frequency", "delay"))
        return Designs(drives.T, frequency, centre, delay)

    def positions_of(self, designs: Designs) -> np.ndarray:
        """(n, dimension) the positions of designs, cut off at the limits of the space.

        Where the first actuator's magnitude or phase is held because a common one changes nothing, the whole drive is
        turned, and with the source paper's reading also scaled, until the first one fits.
        """
        drives, held = designs.drives / self.unit, self._values(np.zeros((1, len(self.numbers))))
        if self._first_is_held("phase"):
            drives = drives * np.exp(-1j * (np.angle(drives[:, :1]) + held["phase"][0]))
        if not has_design_tables(self.scene) and not self.scene.search.limits.equal_magnitudes:
            with np.errstate(divide="ignore", invalid="ignore"):
                drives = np.nan_to_num(drives / np.abs(drives[:, :1]))
        values = {
            "magnitude": np.abs(drives),
            "phase": np.mod(-np.angle(drives), 2 * math.pi),
            "frequency": designs.frequency,
            "x": None if designs.centre is None else designs.centre[:, :, 0],
            "y": None if designs.centre is None else designs.centre[:, :, 1],
            "delay": designs.delay,
        }
        columns = []
        for one in self.numbers:
            own = values[one.kind]
            columns.append(np.full(len(designs), one.held) if own is None else own[:, one.actuators[0]])
        positions = np.stack(columns, axis=1) if columns else np.empty((len(designs), 0))
        return np.clip(positions, self.space.lower, self.space.upper)

    def scene_of(self, position: np.ndarray) -> Scene:
        """The scene with what a position (dimension,) stands for, which runs as the position's plate does.

        Raises:
            SceneError: a number that no scene may have, such as a magnitude beyond 1e30.
        """
        values = {kind: one[:, 0] for kind, one in self._values(np.asarray(position, dtype=float)[None]).items()}
        return scene_with(
            self.scene,
            self.unit * self._limited(values["magnitude"][:, None])[:, 0],
            values["phase"],
            values.get("frequency"),
            np.stack([values["x"], values["y"]], axis=1) if "x" in values else None,
            values.get("delay"),
        )

    def _values(self, positions: np.ndarray) -> dict[str, np.ndarray]:
        """(actuators, n) of each kind that plates may have of their own, before limits of drives."""
        if positions.ndim != 2 or positions.shape[1] != len(self.numbers):
            raise ValueError(f"positions of shape {positions.shape}: must be (n, {len(self.numbers)})")
        values = {kind: np.tile(self._held[kind][:, None], len(positions)) for kind in self._kinds}
        for column, one in zip(positions.T, self.numbers, strict=True):
            values[one.kind][list(one.actuators)] = column if math.isinf(one.period) else np.mod(column, one.period)
        return values

    @cached_property
    def _kinds(self) -> frozenset[str]:
        """Of what plates may have of their own: drives always; a place has an x and a y."""
        kinds = {"magnitude", "phase", *(one.kind for one in self.numbers)}
        return frozenset(kinds | {"x", "y"} if kinds & {"x", "y"} else kinds)

    @cached_property
    def _held(self) -> dict[str, np.ndarray]:
        """(actuators,) of each kind as the scene has it; in the paper's reading magnitude 1 and phase 0."""
        actuators, own = self.scene.actuators, has_design_tables(self.scene)
        return {
            "magnitude": np.array([one.magnitude if own else 1.0 for one in actuators]),
            "phase": np.array([one.phase if own else 0.0 for one in actuators]),
            "frequency": actuator_frequencies(self.scene),
            "x": actuator_centres(self.scene)[:, 0],
            "y": actuator_centres(self.scene)[:, 1],
            "delay": actuator_delays(self.scene),
        }

    def _turns(self, phase: np.ndarray) -> np.ndarray:
        """exp(−iφ) of phases (actuators, n)."""
        free = sorted(index for one in self.numbers if one.kind == "phase" for index in one.actuators)
        turns = np.tile(np.exp(-1j * self._held["phase"])[:, None] + 0, phase.shape[1])
        turns[free] = np.exp(-1j * phase[free])
        return turns

    def _limited(self, magnitude: np.ndarray) -> np.ndarray:
        """Magnitudes (actuators, n) in units of ``unit``, cut off or scaled down to the scene's limits."""
        limits = self.scene.search.limits
        if limits.magnitude is not None:
            most = limits.magnitude / self.unit
            if only_ratios(self.scene):
                magnitude = magnitude * _down_to(most, np.abs(magnitude).max(axis=0))
            else:
                magnitude = np.clip(magnitude, -most, most)
        if limits.power is not None:
            size = np.sqrt(reduce(np.add, magnitude**2))  # in one order, whatever the number of plates
            magnitude = magnitude * _down_to(math.sqrt(limits.power) / self.unit, size)
        return magnitude

    def _first_is_held(self, kind: str) -> bool:
        return not any(one.kind == kind and 0 in one.actuators for one in self.numbers)


@dataclass(frozen=True)
class Positions:
    """Designs of positions (n, dimension), made when they are asked for; a ``Shorthand`` of ``plate.designs``."""

    variables: Parametrization
    positions: np.ndarray | GrowingRows
    maker: ClassVar[str] = f"{__name__}:maker_of"

    def __len__(self) -> int:
        return len(self.positions)

    def __getitem__(self, some: slice) -> Designs:
        return self.variables.designs(self.positions[some])

    @property
    def only_drives(self) -> bool:
        """Whether plates differ in nothing but their drives."""
        return self.variables.only_drives

    @property
    def scene(self) -> Scene:
        """For which they are designs."""
        return self.variables.scene

    def numbers(self, some: slice) -> np.ndarray:
        """(plates, dimension) some of the positions."""
        return np.asarray(self.positions[some], dtype=float)


def maker_of(scene: Scene) -> Callable[[np.ndarray], Positions]:
    """``Positions.maker``: makes the same ones of their numbers in another process."""
    return partial(Positions, parametrization_of(scene))


def parametrization_of(scene: Scene) -> Parametrization:
    """What the scene's tables ``[search.magnitude]`` and so on free; see ``free.make_design_variables``.

    Raises:
        SceneError: nothing is free, or a table does not fit the scene; names the key.
    """
    return Parametrization(scene, make_design_variables(scene))


def _down_to(most: float, sizes: np.ndarray) -> np.ndarray:
    """(n,) factors that bring sizes down to ``most``; one where they are no larger."""
    factors: np.ndarray = most / np.maximum(sizes, most)
    return factors


def paper_phasors(positions: np.ndarray) -> np.ndarray:
    """(plates, actuators) phasors Z [N/m²] of positions (plates, 2·(actuators − 1)).

    Section II.C of the source paper: a position is w₂ ... w_M, φ₂ ... φ_M, with w₁ = 1 and φ₁ = 0, because a common
    factor does not change the localization factor, nor does a common phase once the plate vibrates steadily (in the
    scene ``paper`` what is left of the start moves it by 4e-5); Z = w exp(−iφ).
    """
    magnitude, phase = np.split(np.asarray(positions, dtype=float), 2, axis=1)
    first = np.ones((len(magnitude), 1), dtype=complex)
    return np.concatenate([first, magnitude * np.exp(-1j * phase)], axis=1)


def magnitude_unit(scene: Scene) -> float:
    """What a magnitude of one in the search stands for: the largest magnitude that the scene's actuators have.

    Where displacements are linear in the drives a common factor changes no localization factor, and it is one.
    """
    largest = max(abs(actuator.magnitude) for actuator in scene.actuators)
    return 1.0 if scene.linear or largest == 0 else largest

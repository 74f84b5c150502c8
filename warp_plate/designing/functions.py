"""The functions of all panels of a design, and the air beside them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from warp_plate.modal.air import Shapes, Waves
from warp_plate.modal.assemble import make_space
from warp_plate.modal.radiation import FarField, air_of
from warp_plate.modal.sensitivity.adjoint import AirBeside
from warp_plate.modal.spaces.integrals import SplineProducts, mean_wave_frequency
from warp_plate.modal.spaces.knots import intervals_for
from warp_plate.modal.spaces.space import FunctionSpace
from warp_plate.modal.spaces.tensor_splines import TensorSplines
from warp_plate.modal.spaces.trimmed_splines import TrimmedSplines
from warp_plate.plate.section import laminate_of
from warp_plate.quantities.sound_levels import a_weight
from warp_plate.scene.keys import key_parts
from warp_plate.scene.model import Scene

# Functions along each side, relative to those of other commands.
DENSITY = 0.7
# Energy of functions of a free outline that depend on the others: more than for one outline, so that what is left out
# turns slowly with it; of less, rounding is seen in slopes.
RANK = 1e-9
# Steps of differences by the shape of a panel, against rounding: by an outline and its holes, of three points, and by
# supports and ends of parts of edges, whose conditions change, of five points, as parts of the least interval between
# knots; by a side of a rectangle, whose functions only stretch, of five points, as a part of it. The third is that of
# supports and ends of parts at ends of ranges, for differences by one side are less exact, and of those that move with
# an outline.
OUTLINED, HELD, HELD_SHORT, STRETCHED = 1e-5, 2.8e-3, 7e-4, 1e-3
# Coordinates of places about which motions are singular. What splines follow of such a motion changes within the
# distance to the nearest knot: steps are at most this part of it, but at least this part of an interval.
SINGULAR, OF_DISTANCE, LEAST = ("point", "line", "from_point", "to_point"), 0.02, 2e-5
# Tables that say what shape a panel has and where it is held, and the numbers there that do not.
SHAPE, SPRINGS = (
    ("plate.size", "plate.outline", "plate.holes", "edges.", "supports["),
    ("translation", "rotation", "stiffness"),
)


class PanelFunctions:
    """Functions of a scene's panels, which follow neither the map nor patches, so that values are smooth.

    Args:
        scene: Scene, with an even map of thickness where that is free.
        highest: Highest frequency of its drives [Hz].
        shaped: Make functions anew for each outline, of products of as many splines, stretched to its bounding box.
    """

    def __init__(self, scene: Scene, highest: float, shaped: bool = False) -> None:
        self._scene, self._highest, self._shaped = scene, highest, shaped
        self._air: dict[float, AirBeside] = {}

    @cached_property
    def space(self) -> TensorSplines | TrimmedSplines:
        """The space of these functions on the scene's own plate."""
        scene, finer = self._scene, self._scene.grid.modal_density
        wave = mean_wave_frequency(laminate_of(scene))
        sides = intervals_for(scene.plate.size, scene.outline, finer * self._highest, wave, finer * DENSITY)
        if self._shaped and scene.outline is not None:
            return TrimmedSplines(scene, sides, rank=RANK)
        space = make_space(scene, sides)
        assert isinstance(space, TensorSplines | TrimmedSplines)
        return space

    def of_scene(self, scene: Scene, near: FunctionSpace | None = None) -> TensorSplines | TrimmedSplines:
        """Return the functions of a panel, which turn least from those of ``near``, of almost the same shape; Unlike:
        these are of other kinds."""
        own, like = self.space, self.space if near is None else near
        x, y = (splines.scaled(length) for splines, length in zip(own.along, scene.plate.size, strict=True))
        if not isinstance(like, TrimmedSplines):
            return TensorSplines(scene, own.intervals, (x, y))
        if not self._shaped or shape_of(like.scene) == shape_of(scene):
            return TrimmedSplines(scene, own.intervals, fixed=like)
        followed = None if near is None else like
        return TrimmedSplines(scene, own.intervals, along=(x, y), rank=RANK, near=followed)

    def air(self, frequency: float) -> AirBeside:
        """Return the air beside the functions at a frequency [Hz]; see :mod:`warp_plate.modal.air`."""
        if frequency not in self._air:
            space, air, table = self.space, air_of(self._scene), self._scene.effects.air
            finest = np.max(np.array(space.shape[::-1]) / self._scene.plate.size) ** 2
            highest = np.array([mean_wave_frequency(space.laminate) * finest])
            shapes, k = Shapes(self._scene, space, highest, np.eye(space.unknowns)), float(air.wavenumber(frequency))
            rows = math.sqrt(air.density * air.sound_speed) * k * FarField(shapes, k).resistance_factor(k)
            impedance = None
            if table is not None:
                masses = air.density * Waves(shapes).masses_per_density(k)
                sides = 2 if table.sides == "both" else 1
                impedance = sides * (rows.T @ rows + 2j * math.pi * frequency * masses)
            self._air[frequency] = AirBeside(a_weight(frequency) * rows, impedance)
        return self._air[frequency]


def shape_of(scene: Scene) -> tuple[object, ...]:
    """Return what the functions of a panel depend on: its outline, and where it is held."""
    plate = scene.plate
    holes = [hole.model_copy(update={"edge": "free"}) for hole in plate.holes]
    parts = [(part.from_point, part.to_point) for part in scene.edges.parts]
    supports = [(support.point, support.line, support.ring) for support in scene.supports]
    return plate.size, plate.outline, holes, parts, supports


def is_shape(key: str) -> bool:
    """Return whether a number at a key says what shape a panel has, or where it is held."""
    return key.startswith(SHAPE) and key.rpartition(".")[2] not in SPRINGS


def shape_step(space: SplineProducts, keys: Sequence[str], value: float, room: float) -> tuple[float, int]:
    """Return the step [m] and number of points of differences by a number of the shape of a panel, of a value [m] at
    some keys that is ``room`` [m] away from the nearer end of its range."""
    if isinstance(space, TensorSplines):
        return STRETCHED * value, 5
    interval = min(float(np.diff(along.breaks).min()) for along in space.along)
    held = [key for key in keys if not key.startswith("plate.")]
    if not held:
        return OUTLINED * interval, 3
    longest = HELD if held == keys and 2 * HELD * interval <= room else HELD_SHORT
    steps = [longest * interval]
    for *path, last in map(key_parts, held):
        if not isinstance(last, str) and any(name in path for name in SINGULAR):
            distance = float(np.abs(space.along[last].breaks - value).min())
            steps.append(max(OF_DISTANCE * distance, LEAST * interval))
    return min(steps), 5

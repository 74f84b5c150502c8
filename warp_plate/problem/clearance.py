"""Distances between actuators whose places are searched."""

from __future__ import annotations

import numpy as np

from warp_plate.plate.designs import Designs
from warp_plate.quantities.region_quantities import MOST_DECIBELS
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# Part of the plate's longer side by which rounding may bring two actuators nearer.
SLACK = 1e-9


class Clearance:
    """The clearance of ``[search.position]``: how near the patches of a design may come to each other.

    Two patches keep it if there is at least so much room between them along x or along y. Pairs of which neither moves
    do not count.

    Args:
        scene: Scene.
    """

    def __init__(self, scene: Scene) -> None:
        table, self._scene = scene.search.position, scene
        areas = np.array([actuator.area for actuator in scene.actuators])
        size = np.stack([areas[:, 1] - areas[:, 0], areas[:, 3] - areas[:, 2]], axis=1)
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
        """Return matrix (pairs, 2 actuators) and least values (pairs,) [m] of matrix @ centres, x and y by turns.

        They keep each pair apart along the axis, and on the side, on which it has most room at centres (actuators, 2)
        [m].
        """
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

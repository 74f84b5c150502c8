"""Natural frequencies of a design by the names of their modes, which shapes carry from one panel to another.

A mode has the number that it has in the scene that the design began with. In another panel it is the one whose shape w
is most like the shape v there, by the modal assurance criterion over points of the plate with weights g,

    MAC = (Σ g v w)² / (Σ g v² · Σ g w²)

(R. J. Allemang and D. L. Brown, Proc. 1st International Modal Analysis Conference, 1982, pp. 110-116), so that
frequencies may cross.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from warp_plate.modal.modes import solve_modes
from warp_plate.modal.spaces.space import FunctionSpace
from warp_plate.scene.errors import SceneError
from warp_plate.scene.model import Scene

# Relative distance of natural frequencies that have no shapes of their own, and modes besides twice the largest number
# among which shapes are sought.
EQUAL, MORE = 1e-4, 12


class NamedModes:
    """The modes of a scene with some numbers, from 1 on, that are sought in panels of so many functions.

    SceneError: These are too few, or a frequency is repeated, and has no shape.
    """

    def __init__(self, scene: Scene, numbers: Iterable[int], functions: float = math.inf) -> None:
        self.numbers = list(numbers)
        if not self.numbers:
            return
        if _sought(max(self.numbers)) > functions:
            most = f"must be at most {(functions - MORE) // 2} for the frequency of this drive"
            raise SceneError(f"design.limits.modes: {max(self.numbers)}: {most}")
        plate = solve_modes(scene, count=max(self.numbers) + 1)
        frequencies = plate.frequencies
        if frequencies.size <= max(self.numbers):
            raise SceneError(f"design.limits.modes: {max(self.numbers)}: at most {frequencies.size - 1} are computed")
        for number in self.numbers:
            near = np.delete(frequencies, number - 1)
            if np.abs(near - frequencies[number - 1]).min() <= EQUAL * frequencies[number - 1]:
                frequency = f"{frequencies[number - 1]:.6g} Hz"
                raise SceneError(f"design.limits.modes: {number}: at {frequency} are several modes; name another")
        self._points, self._weights = plate.space.quadrature()
        self._shapes = self._of(plate.space, plate.vectors[:, np.array(self.numbers) - 1])

    def among(self, space: FunctionSpace, vectors: np.ndarray) -> list[int]:
        """Return the index of each of them among modes of a panel, vectors (unknowns, modes) by rising frequency."""
        if not self.numbers:
            return []
        shapes = self._of(space, vectors[:, : _sought(max(self.numbers))])
        return list(((self._shapes @ shapes.T) ** 2).argmax(axis=1).tolist())

    def _of(self, space: FunctionSpace, vectors: np.ndarray) -> np.ndarray:
        """Return (modes, points) shapes times roots of the weights, of length 1."""
        shapes = space.sums_at_points(vectors[: space.unknowns].T, self._points) * np.sqrt(self._weights)
        return np.asarray(shapes / np.linalg.norm(shapes, axis=1, keepdims=True))


def _sought(number: int) -> int:
    """Return among how many modes that with a number is sought."""
    return 2 * number + MORE

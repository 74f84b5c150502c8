"""The free numbers of a scene, scaled so that the range of each is 0 ... 1.

Ranges above 0 are scaled by logarithms, so that stiffnesses of any size are fitted alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warp_plate.scene.errors import SceneError
from warp_plate.scene.keys import resolved_key, value_of, with_values
from warp_plate.scene.model import Scene

# Step of differences of scenes, relative to a value above 0, or else to its range.
STEP = 1e-3


@dataclass(frozen=True, eq=False)
class FreeNumbers:
    """The numbers of ``[fit.free]``.

    Attributes:
        scene: Scene.
        keys: (p,) their keys.
        low: (p,) their lowest values.
        high: (p,) their highest values.
    """

    scene: Scene
    keys: tuple[str, ...]
    low: np.ndarray
    high: np.ndarray

    def values(self, fractions: np.ndarray) -> np.ndarray:
        """Return the values at fractions (p,) of the ranges."""
        ratio = np.where(self.low > 0, self.high, 1.0) / np.where(self.low > 0, self.low, 1.0)
        with np.errstate(over="ignore"):  # of the intervals' ends
            return np.where(self.low > 0, self.low * ratio**fractions, self.low + fractions * (self.high - self.low))

    def scene_at(self, fractions: np.ndarray) -> Scene:
        """Return the scene with the values at fractions (p,), or raise a SceneError if they do not fit together."""
        return self._panel_with(self.values(fractions)).model_copy(update={"fit": self.scene.fit})

    def panel_at(self, fractions: np.ndarray) -> Scene:
        """Return the same without the table ``[fit]``, whose check takes time."""
        return self._panel_with(self.values(fractions))

    def _panel_with(self, values: np.ndarray) -> Scene:
        panel = self.scene.model_copy(update={"fit": None})
        try:
            return with_values(panel, dict(zip(self.keys, values.tolist(), strict=True)))
        except SceneError as error:
            raise SceneError(f"fit.free: a range reaches too far: {error}") from None

    def neighbours(self, fractions: np.ndarray, index: int, central: bool) -> tuple[Scene, Scene | None, float]:
        """Return scenes whose differences are derivatives with respect to a fraction.

        Returns:
            Scene with a larger value of the number ``index``, that with a smaller one, None for the value itself, and
            the factor of their difference.
        """
        values, low, high = self.values(fractions), self.low[index], self.high[index]
        step = STEP * (values[index] if low > 0 else high - low)
        ends = min(values[index] + step, high), max(values[index] - step, low)
        if not central:
            ends = (ends[0], values[index]) if ends[0] > values[index] else (values[index], ends[1])
        slope = values[index] * np.log(high / low) if low > 0 else high - low
        above, below = (
            None if end == values[index] else self._panel_with(np.where(np.arange(len(values)) == index, end, values))
            for end in ends
        )
        return above or self._panel_with(values), below, float(slope / (ends[0] - ends[1]))

    def mirror_pairs(self) -> list[list[tuple[int, int]]]:
        """Return indices of the same numbers of opposite edges within equal ranges, for each pair of edges."""
        found = []
        for one, other in (("left", "right"), ("bottom", "top")):
            names = {key: key.replace(f"edges.{one}", f"edges.{other}") for key in self.keys if f"edges.{one}" in key}
            pairs = [(self.keys.index(key), self.keys.index(name)) for key, name in names.items() if name in self.keys]
            same = all(self.low[i] == self.low[j] and self.high[i] == self.high[j] for i, j in pairs)
            found += [pairs] if pairs and same else []
        return found

    def starts(self, count: int, seed: int) -> np.ndarray:
        """Return (count, p) fractions: those of the scene's own values, then a Latin hypercube."""
        random = np.random.default_rng(seed)
        cells = np.tile(np.arange(count - 1), (len(self.keys), 1))
        drawn = (random.permuted(cells, axis=1).T + random.random((count - 1, len(self.keys)))) / max(count - 1, 1)
        return np.vstack([self._own(), drawn])

    def _own(self) -> np.ndarray:
        """Return the fractions of the scene's values within the ranges, and 1/2 for absent ones."""
        held = [value_of(self.scene, key) for key in self.keys]
        values = np.array([np.nan if value is None else value for value in held], dtype=float)
        values = np.clip(values, self.low, self.high)
        with np.errstate(divide="ignore", invalid="ignore"):
            logarithmic = np.log(values / self.low) / np.log(self.high / self.low)
            fractions = np.where(self.low > 0, logarithmic, (values - self.low) / (self.high - self.low))
        return np.nan_to_num(fractions, nan=0.5)


def free_numbers(scene: Scene) -> FreeNumbers:
    """Return the free numbers of a scene, or raise a SceneError if it has none."""
    if scene.fit is None:
        raise SceneError('fit: is missing; write [fit.free] with lines such as "plate.young_modulus" = [6e10, 8e10]')
    keys = tuple(resolved_key(scene, name) for name in scene.fit.free)
    low, high = np.array(list(scene.fit.free.values()), dtype=float).T
    return FreeNumbers(scene, keys, low, high)

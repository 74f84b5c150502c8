"""Frequency responses of a plate, between forces and points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from warp_plate.result import import_xarray

if TYPE_CHECKING:
    import xarray

Quantity = Literal["receptance", "mobility", "accelerance"]
# Power of iω by which the displacement is multiplied.
DERIVATIVES: Mapping[str, int] = {name: power for power, name in enumerate(get_args(Quantity))}
UNITS: Mapping[str, str] = {"receptance": "m/N", "mobility": "(m/s)/N", "accelerance": "(m/s²)/N"}


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Steady responses of a plate to unit forces that vary as exp(iωt).

    Attributes:
        title: Title of the scene, or its name.
        quantity: Quantity at the points per force: displacement, velocity or acceleration.
        inputs: (inputs,) names of the actuators, or "X,Y" of points, on which 1 N acts, evenly over a patch.
        input_places: (inputs, 2) middles of the inputs [m].
        points: (points, 2) x, y of the outputs [m].
        frequencies: (frequencies,) [Hz], rising.
        responses: (inputs · points, frequencies) complex responses in ``unit``, the points of the first input first.
        localization_factor: (frequencies,) localization factor of the drive of the scene, all actuators at the same
            frequency; NaN where it moves nothing.
        bound: (frequencies,) largest localization factor that any drive of the actuators has.
        mean_square_velocity: (inputs, frequencies) square of the velocity under a force of amplitude 1 N, averaged over
            time and the mass of the plate [(m/s)²/N²].
        natural_frequencies: (modes,) natural frequencies of the undamped plate between the first and the last of
            ``frequencies`` [Hz].
        loss_factors: (modes,) loss factors of these modes.
    """

    title: str
    quantity: Quantity
    inputs: tuple[str, ...]
    input_places: np.ndarray
    points: np.ndarray
    frequencies: np.ndarray
    responses: np.ndarray
    localization_factor: np.ndarray
    bound: np.ndarray
    mean_square_velocity: np.ndarray
    natural_frequencies: np.ndarray
    loss_factors: np.ndarray

    @property
    def unit(self) -> str:
        """Unit of the responses."""
        return UNITS[self.quantity]

    @property
    def pairs(self) -> list[tuple[str, tuple[float, float]]]:
        """Input and point of each response."""
        return [(name, (float(x), float(y))) for name in self.inputs for x, y in self.points]

    @property
    def labels(self) -> list[str]:
        """Names of the pairs, such as "left → 0.1,0.05"."""
        return [f"{name} → {x:g},{y:g}" for name, (x, y) in self.pairs]

    def __repr__(self) -> str:
        counts = f"{len(self.inputs)} inputs, {len(self.points)} points, {len(self.frequencies)} frequencies"
        return f"<FrequencyResponse {counts} from {self.frequencies[0]:g} to {self.frequencies[-1]:g} Hz>"

    @property
    def undamped(self) -> bool:
        """True if a mode in the range has no damping, so that its response has no limit."""
        return bool(np.any(self.loss_factors <= 0))

    def to_xarray(self) -> xarray.Dataset:
        """Return the responses (input, point, frequency) and the curves over frequency as an ``xarray.Dataset``."""
        xarray = import_xarray()
        shape = (len(self.inputs), len(self.points), len(self.frequencies))
        return xarray.Dataset(
            {
                "response": (("input", "point", "frequency"), self.responses.reshape(shape), {"units": self.unit}),
                "mean_square_velocity": (("input", "frequency"), self.mean_square_velocity, {"units": "(m/s)²/N²"}),
                "localization_factor": ("frequency", self.localization_factor, {"units": "1"}),
                "bound": ("frequency", self.bound, {"units": "1"}),
            },
            {
                "input": list(self.inputs),
                "frequency": ("frequency", self.frequencies, {"units": "Hz"}),
                "x": ("point", self.points[:, 0], {"units": "m"}),
                "y": ("point", self.points[:, 1], {"units": "m"}),
            },
            {"title": self.title, "quantity": self.quantity},
        )

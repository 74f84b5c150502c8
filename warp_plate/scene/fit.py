"""The tables ``[fit]``, numbers that ``warp-plate fit`` takes from measurements, and ``[[measurement]]``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from warp_plate.scene.errors import SceneError
from warp_plate.scene.fields import Coordinate, Gain, Moderate, Name, Positive, Table
from warp_plate.scene.keys import resolved_key, scalar_keys

if TYPE_CHECKING:
    from warp_plate.scene.model import Scene

# Tables with properties of the panel.
FEWEST_SAMPLES, FEWEST_POINTS = 40, 3
PANEL = ("plate", "edges", "effects", "actuators", "measurement")


def _flat(free: Any) -> Any:
    """Return ``{"plate.density": range}`` for ``{"plate": {"density": range}}``, which TOML makes of unquoted keys."""

    def items(table: dict[str, Any], head: str) -> Iterator[tuple[str, Any]]:
        for key, value in table.items():
            if isinstance(value, dict):
                yield from items(value, f"{head}{key}.")
            else:
                yield f"{head}{key}", value

    return dict(items(free, "")) if isinstance(free, dict) else free


class Measurement(Table):
    """A measured frequency response: where the panel was driven, and where its motion was sensed."""

    actuator: Name | None = None  # name of the driven actuator; without it ``force_at`` is required
    force_at: tuple[Coordinate, Coordinate] | None = None  # x, y of a hammer or shaker [m]
    point: tuple[Coordinate, Coordinate]  # x, y of the sensor [m]
    # Displacement, velocity or acceleration per force
    quantity: Literal["receptance", "mobility", "accelerance"] = "accelerance"
    gain: Gain = 1.0  # measured response over the true response in SI units [1]

    @model_validator(mode="after")
    def _driven_once(self) -> Measurement:
        if (self.actuator is None) == (self.force_at is None):
            raise ValueError("actuator: write an actuator's name, or force_at = [x, y], and not both")
        return self

    def check(self, key: str, scene: Scene) -> None:
        """Raise ValueError, beginning with ``key``, unless the actuator is there and the points are on the plate."""
        names = [actuator.name for actuator in scene.actuators]
        if self.actuator is not None and self.actuator not in names:
            raise ValueError(f"{key}.actuator: {self.actuator!r} is not one of {', '.join(names)}")
        width, height = scene.plate.size
        for name, (x, y) in {"point": self.point, "force_at": self.force_at or (0.0, 0.0)}.items():
            if not (0 <= x <= width and 0 <= y <= height):
                raise ValueError(f"{key}.{name}: {[x, y]} is off the plate of {[width, height]} m")


class TimeSignals(Table):
    """Time signals for responses: one channel holds the force, the others the sensors in order."""

    force_channel: Annotated[int, Field(ge=1, le=256)] = 1  # number of the channel with the force, from 1 on
    force_gain: Gain = 1.0  # recorded value over the true force in N [1/N]
    estimator: Literal["H1", "H2", "Hv"] = "H1"  # for noise in the response (H1), the force (H2), or both (Hv)
    segment: Positive = 1.0  # duration of the segments that are averaged [s]; frequencies are multiples of 1/segment
    # Window of a segment: "hann" for segments that overlap by half, "boxcar" for segments without overlap
    window: Literal["hann", "boxcar"] = "hann"


class Fit(Table):
    """The design variables of a fit, and how it is done."""

    # Lowest and highest value of each free key [unit of the key]
    free: Annotated[dict[str, tuple[Moderate, Moderate]], BeforeValidator(_flat)]
    # Measured modes are the lowest ones in "order", those with the "nearest" frequencies, or those with the most
    # similar shapes ("mac"). A column ``mode`` of the file overrides the first two
    pairing: Literal["order", "nearest", "mac"] = "order"
    starts: Annotated[int, Field(ge=1, le=10_000)] = 16  # number of starting points
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0  # random seed of the starts and of the bootstrap
    bootstrap: Annotated[int, Field(ge=0, le=100_000)] = 0  # number of resampled data sets for further intervals
    profile: Annotated[int, Field(ge=0, le=1000)] = 0  # number of points of each profile likelihood
    range: tuple[Positive, Positive] | None = None  # lowest and highest frequency of responses that are used [Hz]
    signals: TimeSignals | None = None  # the data are time signals

    @model_validator(mode="after")
    def _ranges(self) -> Fit:
        if not self.free:
            raise ValueError('free: is empty; write a range for a key, such as "plate.young_modulus" = [6e10, 8e10]')
        for key, (low, high) in self.free.items():
            if low >= high:
                raise ValueError(f"free: {key} = {[low, high]}: the lowest value comes first, and they differ")
        if 0 < self.bootstrap < FEWEST_SAMPLES:
            raise ValueError(
                f"bootstrap = {self.bootstrap}: must be 0 or at least {FEWEST_SAMPLES}, for intervals of 95 %"
            )
        if 0 < self.profile < FEWEST_POINTS:
            raise ValueError(f"profile = {self.profile}: must be 0 or at least {FEWEST_POINTS}")
        if self.range is not None and self.range[0] >= self.range[1]:
            raise ValueError(f"range: {list(self.range)}: the lowest frequency comes first, and they differ")
        return self

    def check(self, scene: Scene) -> None:
        """Raise ValueError, naming the key, unless the free keys are different numbers of the scene's panel."""
        kinds, named = scalar_keys(scene), set()
        for name in self.free:
            try:
                key = resolved_key(scene, name, kinds)
            except SceneError as error:
                raise ValueError(f"fit.free: {error}") from None
            if kinds[key] is not float or not key.startswith(PANEL):
                raise ValueError(f"fit.free: {name}: is no real number of the panel ({', '.join(PANEL)})")
            if key in named:
                raise ValueError(f"fit.free: {name}: is there twice")
            named.add(key)

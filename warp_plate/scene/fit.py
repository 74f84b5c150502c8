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

# Tables whose numbers are properties of the panel.
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
    """A frequency response that was measured: what drove the panel, and where its motion was sensed."""

    actuator: Name | None = None  # driven actuator, or
    force_at: tuple[Coordinate, Coordinate] | None = None  # point x, y of a hammer or shaker [m]
    point: tuple[Coordinate, Coordinate]  # sensor's x, y [m]
    quantity: Literal["receptance", "mobility", "accelerance"] = "accelerance"  # response per force
    gain: Gain = 1.0  # what was measured, over the true response in SI units [1]

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
    """Time signals for responses: one channel has the force, the others the sensors in order."""

    force_channel: Annotated[int, Field(ge=1, le=256)] = 1  # counted from 1
    force_gain: Gain = 1.0  # what was recorded over the true force in N [1/N]
    estimator: Literal["H1", "H2", "Hv"] = "H1"  # H1 for noise in the response, H2 in the force, Hv in both
    segment: Positive = 1.0  # duration of the segments that are averaged [s]; frequencies are multiples of 1/segment
    window: Literal["hann", "boxcar"] = "hann"  # of segments that overlap by half, or that follow one another


class Fit(Table):
    """The free numbers of a fit, and how it is done."""

    # Lowest and highest value by key [unit of the key]
    free: Annotated[dict[str, tuple[Moderate, Moderate]], BeforeValidator(_flat)]
    # Measured modes are the lowest ones in order, or those with the nearest frequencies; a column ``mode`` goes first
    pairing: Literal["order", "nearest"] = "order"
    starts: Annotated[int, Field(ge=1, le=10_000)] = 16  # points from which the fit may begin
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0  # random seed of the starts
    range: tuple[Positive, Positive] | None = None  # lowest and highest frequency of responses that counts [Hz]
    signals: TimeSignals | None = None  # the data are time signals

    @model_validator(mode="after")
    def _ranges(self) -> Fit:
        if not self.free:
            raise ValueError('free: is empty; write a range for a key, such as "plate.young_modulus" = [6e10, 8e10]')
        for key, (low, high) in self.free.items():
            if low >= high:
                raise ValueError(f"free: {key} = {[low, high]}: the lowest value comes first, and they differ")
        if self.range is not None and self.range[0] >= self.range[1]:
            raise ValueError(f"range: {list(self.range)}: the lowest frequency comes first, and they differ")
        return self

    def check(self, scene: Scene) -> None:
        """Raise ValueError, naming the key, unless the free keys are different numbers of the scene's panel."""
        kinds, known = scalar_keys(scene), set()
        for name in self.free:
            try:
                key = resolved_key(scene, name)
            except SceneError as error:
                raise ValueError(f"fit.free: {error}") from None
            if kinds[key] is not float or not key.startswith(PANEL):
                raise ValueError(f"fit.free: {name}: is no real number of the panel ({', '.join(PANEL)})")
            if key in known:
                raise ValueError(f"fit.free: {name}: is there twice")
            known.add(key)

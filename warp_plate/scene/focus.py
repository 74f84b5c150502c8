"""The table ``[focus]``: points at which ``warp-plate focus`` makes the plate move, at one moment."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from warp_plate.scene.fields import Coordinate, NotNegative, Positive, Table

# Samples of all waveforms and responses together.
MOST_NUMBERS = 2**24


class Focus(Table):
    """Points where waveforms of the actuators focus, and the limits of the waveforms."""

    # Points (x, y) [m], each the focus of waveforms of its own
    points: Annotated[tuple[tuple[Coordinate, Coordinate], ...], Field(min_length=1, max_length=64)]
    highest: Positive  # natural frequency up to which modes take part [Hz]
    lowest: NotNegative = 0.0  # frequency from which on motion is focused [Hz]
    time: Positive = 0.05  # moment of the focus, and end of the waveforms, which begin at 0 [s]
    rate: Annotated[int, Field(ge=1, le=10_000_000)] = 48000  # samples a second
    quantity: Literal["displacement", "velocity"] = "displacement"  # quantity that is focused
    peak: Positive | None = None  # largest pressure of an actuator [N/m²] (default: 1 without an energy, else none)
    energy: Positive | None = None  # largest sum over actuators of the integral of pressure² [(N/m²)²·s]

    @property
    def samples(self) -> int:
        """Number of samples of a waveform."""
        return round(self.time * self.rate)

    @property
    def peak_limit(self) -> float | None:
        """Largest pressure of an actuator [N/m²]; None for no limit."""
        return 1.0 if self.peak is None and self.energy is None else self.peak

    @model_validator(mode="after")
    def _sampled(self) -> Focus:
        if self.rate < 2 * self.highest:
            raise ValueError(
                f"rate: {self.rate} samples a second; highest = {self.highest:g} Hz takes at least twice it"
            )
        if self.lowest >= self.highest:
            raise ValueError(f"lowest: {self.lowest:g} Hz must be below highest = {self.highest:g} Hz")
        if not 2 <= self.time * self.rate <= MOST_NUMBERS:
            raise ValueError(f"time: {self.time:g} s at rate = {self.rate}: must be 2 to {MOST_NUMBERS} samples")
        return self

    def check(self, size: tuple[float, float], actuators: int) -> None:
        """Raise ValueError, naming the key, unless the points lie on a plate [m] and the waveforms are not too many."""
        width, height = size
        for index, (x, y) in enumerate(self.points):
            if not (0 <= x <= width and 0 <= y <= height):
                raise ValueError(f"focus.points[{index}]: {[x, y]} is off the plate of {[width, height]} m")
        if (numbers := self.samples * len(self.points) * actuators) > MOST_NUMBERS:
            what = f"{self.samples} samples for {actuators} actuators and {len(self.points)} points"
            raise ValueError(f"focus.time: {what} are {numbers}; at most {MOST_NUMBERS} are possible")

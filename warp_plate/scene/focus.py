"""The table ``[focus]``: points at which ``warp-plate focus`` makes the plate move, at one moment."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from warp_plate.scene.drive import SampledFile
from warp_plate.scene.fields import Coordinate, Flag, NotNegative, Positive, Table

# Samples of all waveforms and responses together.
MOST_NUMBERS = 2**22
# Part of the waveforms' duration for which motion is recorded after them.
AFTER = 0.2
L_CURVE = "l-curve"


def _condition(value: object) -> object:
    if value == L_CURVE or (isinstance(value, (int, float)) and not isinstance(value, bool) and 1 <= value <= 1e7):
        return value
    raise PydanticCustomError("condition", f'must be a number from 1 to 1e7, or "{L_CURVE}"')


class FocusBurst(Table):
    """A tone under a Hann window, whose middle is at the moment of the focus."""

    frequency: Positive  # frequency of the tone [Hz]
    cycles: Annotated[float, Field(ge=1, le=1e6)] = 5.0  # periods from end to end [1]

    @property
    def half(self) -> float:
        """Half of the duration [s]."""
        return self.cycles / self.frequency / 2


class FocusWish(SampledFile):
    """Motion that a focus is to follow in shape, from a file; waveforms last as long as the file."""

    per_point: Flag = False  # true if the file has a channel for each point; false if one channel is for all


class FocusRest(Table):
    """A bound on the motion of the rest of the plate at the moment of the focus."""

    contrast: Annotated[float, Field(ge=0, le=200)]  # lower limit of the motion of the point over the RMS outside [dB]
    radius: Positive  # radius of the disc around the point that is not part of the rest [m]


class Focus(Table):
    """Points where waveforms of the actuators focus, and the limits of the waveforms."""

    # Points (x, y) [m], each the focus of a separate set of waveforms
    points: Annotated[tuple[tuple[Coordinate, Coordinate], ...], Field(min_length=1, max_length=64)]
    highest: Positive  # natural frequency up to which modes take part, at most rate / 2 [Hz]
    lowest: NotNegative = 0.0  # lowest frequency of the waveforms; below it they fade out, to half of it [Hz]
    time: Positive = 0.05  # moment of the focus, after the start of the waveforms [s]
    rate: Annotated[int, Field(ge=1, le=10_000_000)] = 48000  # samples a second
    quantity: Literal["displacement", "velocity"] = "displacement"  # quantity that is focused
    # Largest drive of an actuator [N/m² or V] (default: 1 without ``energy``, otherwise none)
    peak: Positive | None = None
    # Condition number of the inverse filters: smaller singular values than the largest over it are damped; "l-curve"
    # chooses it for the panels of [search.robust] [1]
    condition: Annotated[float | Literal["l-curve"], BeforeValidator(_condition)] = 100.0
    burst: FocusBurst | None = None  # desired motion of a focus (default: a pulse)
    wish: FocusWish | None = None  # desired motion from a file, instead of a burst or pulse; ``time`` is not used then
    rest: FocusRest | None = None  # bound on the rest of the plate, for the method "quiet" (default: none)
    energy: Positive | None = None  # limit of the integral of drive², summed over actuators [drive²·s]

    @property
    def samples(self) -> int:
        """Number of samples of a waveform; a burst is in its middle."""
        return (self.moment + 1) * (1 if self.burst is None else 2)

    @property
    def recorded(self) -> int:
        """Number of samples of the motion, which goes on after the waveforms."""
        return round(self.samples * (1 + AFTER))

    @property
    def moment(self) -> int:
        """Index of the sample at whose end is the moment of the focus."""
        return round(self.time * self.rate) - 1

    @property
    def peak_limit(self) -> float | None:
        """Largest drive of an actuator [N/m² or V]; None for no limit."""
        return 1.0 if self.peak is None and self.energy is None else self.peak

    @model_validator(mode="after")
    def _sampled(self) -> Focus:
        if self.rate < 2 * self.highest:
            raise ValueError(
                f"rate: {self.rate} samples a second; highest = {self.highest:g} Hz takes at least twice it"
            )
        if self.wish is not None and self.burst is not None:
            raise ValueError("wish: replaces the burst; delete one of them")
        if self.rest is not None and (key := "burst" if self.burst else "wish" if self.wish else None):
            raise ValueError(f"rest: bounds motion at one moment, not that of a {key}; delete one of them")
        if self.lowest >= self.highest:
            raise ValueError(f"lowest: {self.lowest:g} Hz must be below highest = {self.highest:g} Hz")
        if self.burst is not None and not (self.burst.frequency <= self.highest and self.burst.half <= self.time):
            limits = f"at most highest = {self.highest:g} Hz, and half of the burst within time = {self.time:g} s"
            raise ValueError(f"burst: {self.burst.cycles:g} cycles of {self.burst.frequency:g} Hz: must be {limits}")
        if self.burst is None and self.wish is None and self.time * (self.highest - self.lowest) < 1:
            shortest = 1 / (self.highest - self.lowest)
            raise ValueError(f"time: {self.time:g} s is shorter than a pulse from lowest to highest, {shortest:.3g} s")
        if not 2 <= self.time * self.rate <= MOST_NUMBERS:
            raise ValueError(f"time: {self.time:g} s at rate = {self.rate}: must be 2 to {MOST_NUMBERS} samples")
        return self

    def check(self, size: tuple[float, float], actuators: int) -> None:
        """Raise ValueError, naming the key, unless the points lie on a plate [m] and the waveforms are not too many."""
        width, height = size
        for index, (x, y) in enumerate(self.points):
            if not (0 <= x <= width and 0 <= y <= height):
                raise ValueError(f"focus.points[{index}]: {[x, y]} is off the plate of {[width, height]} m")
        if self.rest is not None and self.rest.radius > min(size) / 2:
            raise ValueError(f"focus.rest.radius: {self.rest.radius:g} m is above half of a side of the plate")
        self.check_numbers(self.samples, actuators, "time")

    def check_numbers(self, samples: int, actuators: int, key: str) -> None:
        """Raise ValueError, naming a key, if waveforms of so many samples are too many."""
        if (numbers := samples * len(self.points) * actuators) > MOST_NUMBERS:
            what = f"{samples} samples for {actuators} actuators and {len(self.points)} points"
            raise ValueError(f"focus.{key}: {what} are {numbers}; at most {MOST_NUMBERS} are possible")

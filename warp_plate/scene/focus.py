"""The table ``[focus]``: points at which ``warp-plate focus`` makes the plate move, at one moment."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from warp_plate.scene.drive import SampledFile
from warp_plate.scene.fields import Flag, NotNegative, Point, Positive, Table, Unit

# Samples of all waveforms and responses together.
MOST_NUMBERS = 2**22
# Part of the waveforms' duration for which motion is recorded after them.
AFTER = 0.2


class FocusBurst(Table):
    """A tone under a Hann window, whose middle is at the moment of the focus."""

    frequency: Annotated[Positive, Unit("Hz"), Field(examples=[300.0])]
    """Frequency of the tone."""
    cycles: Annotated[float, Field(ge=1, le=1e6, examples=[5.0]), Unit("1")] = 5.0
    """Number of periods from end to end."""

    @property
    def half(self) -> float:
        """Half of the duration [s]."""
        return self.cycles / self.frequency / 2


class FocusWish(SampledFile):
    """Motion that a focus is to follow in shape, from a file; waveforms last as long as the file."""

    per_point: Annotated[Flag, Field(examples=[True])] = False
    """True if the file has a channel for each point; false if one channel is for all."""


class FocusRest(Table):
    """A bound on the motion of the rest of the plate at the moment of the focus."""

    contrast: Annotated[float, Field(ge=0, le=200, examples=[20.0]), Unit("dB")]
    """Lower limit of the motion of the point over the RMS outside."""
    radius: Annotated[Positive, Unit("m"), Field(examples=[0.01])]
    """Radius of the disc around the point that is not part of the rest."""


class Focus(Table):
    """Points where waveforms of the actuators focus, and the limits of the waveforms."""

    points: Annotated[tuple[Point, ...], Field(min_length=1, max_length=64, examples=[[[0.05, 0.06], [0.15, 0.06]]])]
    """Points (x, y), each the focus of a separate set of waveforms."""
    highest: Annotated[Positive, Unit("Hz"), Field(examples=[5000.0])]
    """Natural frequency up to which modes take part, at most rate / 2."""
    lowest: Annotated[NotNegative, Unit("Hz"), Field(examples=[100.0])] = 0.0
    """Lowest frequency of the waveforms; below it they fade out, to half of it."""
    time: Annotated[Positive, Unit("s"), Field(examples=[0.02])] = 0.05
    """Moment of the focus, after the start of the waveforms."""
    rate: Annotated[int, Field(ge=1, le=10_000_000, examples=[48000]), Unit("1/s")] = 48000
    """Samples a second."""
    quantity: Annotated[Literal["displacement", "velocity"], Field(examples=["velocity"])] = "displacement"
    """Quantity that is focused."""
    peak: Annotated[Positive | None, Unit("drive"), Field(examples=[100.0])] = None
    """Largest drive of an actuator (default: 1 without ``energy``, otherwise none)."""
    condition: Annotated[float, Field(ge=1, le=1e7, examples=[30.0]), Unit("1")] = 100.0
    """Condition number of the inverse filters: smaller singular values than the largest over it are damped."""
    burst: FocusBurst | None = None
    """Desired motion of a focus (default: a pulse)."""
    wish: FocusWish | None = None
    """Desired motion from a file, instead of a burst or pulse; ``time`` is not used then."""
    rest: FocusRest | None = None
    """Bound on the rest of the plate, for the method "quiet" (default: none)."""
    energy: Annotated[Positive | None, Unit("(drive)²·s"), Field(examples=[50.0])] = None
    """Limit of the integral of drive², summed over actuators."""

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
    def _sampled(self) -> Self:
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

    def check_numbers(self, samples: int, actuators: int, key: str) -> None:
        """Raise ValueError, naming a key, if waveforms of so many samples are too many."""
        if (numbers := samples * len(self.points) * actuators) > MOST_NUMBERS:
            what = f"{samples} samples for {actuators} actuators and {len(self.points)} points"
            raise ValueError(f"focus.{key}: {what} are {numbers}; at most {MOST_NUMBERS} are possible")

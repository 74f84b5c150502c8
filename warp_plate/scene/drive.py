"""The table ``[drive]``, the voltage of the actuators over time.

Actuator k applies Re(Z_k · carrier_k(t)) · envelope(t), where Z_k is its phasor. By default the carrier is exp(iωt)
and the envelope is one.
"""

import math
from typing import Annotated, Any, Literal, Self

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from warp_plate.scene.fields import (
    LARGEST,
    Flag,
    Gain,
    Instant,
    Moderate,
    NotNegative,
    Positive,
    Table,
    Unit,
    check_file_name,
)


class Burst(Table):
    """An envelope that rises from 0 to 1, stays there, and falls back to 0."""

    start: Annotated[Instant, Field(examples=[0.01])] = 0.0
    """Start of the first burst."""
    duration: Annotated[Positive, Unit("s"), Field(examples=[0.02])]
    """Duration of a burst, ramps included."""
    ramp: Annotated[NotNegative, Unit("s"), Field(examples=[0.005])] = 0.0
    """Duration of the rise and of the fall, each half a period of a cosine."""
    period: Annotated[Positive | None, Unit("s"), Field(examples=[0.1])] = None
    """Time from the start of one burst to the start of the next (default: a single burst)."""

    @model_validator(mode="after")
    def _ramps_and_period_fit(self) -> Self:
        if 2 * self.ramp > self.duration * (1 + 1e-12):
            raise ValueError(f"ramp: {self.ramp:g} s is more than half of duration, {self.duration / 2:g} s")
        if self.period is not None and self.period < self.duration:
            raise ValueError(f"period: {self.period:g} s is shorter than a burst, duration = {self.duration:g} s")
        return self


class Chirp(Table):
    """A frequency sweep with continuous phase, from the frequency of each actuator at t = 0."""

    end_frequency: Annotated[Positive, Unit("Hz"), Field(examples=[400.0])]
    """Frequency at ``duration`` and from then on."""
    duration: Annotated[Positive, Unit("s"), Field(examples=[0.5])]
    """Duration of the sweep."""
    law: Annotated[Literal["linear", "logarithmic"], Field(examples=["logarithmic"])] = "linear"
    """The frequency changes by equal amounts ("linear") or equal factors ("logarithmic") in equal times."""


class SampledFile(Table):
    """Signals that are read from a file beside the scene file."""

    file: Annotated[str, Field(examples=["click.wav"])]
    """Name of a WAV file, or of a CSV file with a column for each channel; its first column may hold times."""
    rate: Annotated[Annotated[float, Field(ge=1e-3, le=1e7)] | None, Unit("1/s"), Field(examples=[48000.0])] = None
    """Sampling rate of a CSV file without times."""
    start: Annotated[Instant, Field(examples=[0.01])] = 0.0
    """Time at which the file begins; added to the times of a CSV file."""

    @model_validator(mode="after")
    def _file_beside_scene(self) -> Self:
        check_file_name("file", self.file, (".wav", ".csv"))
        if self.rate is not None and self.file.lower().endswith(".wav"):
            raise ValueError(f"rate: {self.file!r} contains its sampling rate; delete rate")
        return self


class SampledSignal(SampledFile):
    """A carrier that is read from a file beside the scene file."""

    per_actuator: Annotated[Flag, Field(examples=[True])] = False
    """True if the file has a channel for each actuator, in the order of the scene; false if one channel drives them
    all."""
    gain: Annotated[Gain, Unit("1"), Field(examples=[2.0])] = 1.0
    """Factor on the samples; integer samples of a WAV file are first scaled to −1 ... 1."""
    repeat: Annotated[Flag, Field(examples=[True])] = False
    """True to repeat the file; false for silence after its end."""


class Electrostatic(Table):
    """A pressure proportional to the square of the voltage: gain·(bias + V)², V = Re(Z·carrier)·envelope."""

    bias: Annotated[Moderate, Unit("V"), Field(examples=[200.0])] = 0.0
    """Constant voltage of all actuators from t = 0 on, which no burst shapes."""
    gain: Annotated[Gain, Unit("N/(m²·V²)"), Field(examples=[4.4e-4])]
    """Pressure per squared voltage; ε₀/2d² for a gap of d metres in vacuum."""


class Drive(Table):
    """Settings of the drive that all actuators share."""

    frequency: Annotated[Positive, Unit("Hz"), Field(examples=[290.0])]
    """Frequency; with ``signal``, the highest frequency of interest in the file, which only limits the time step."""
    ramp: Annotated[NotNegative, Unit("s"), Field(le=LARGEST / 2, examples=[0.02])] = 0.0
    """Duration of a soft start: the drive rises from 0 at t = 0 by half a period of a cosine, then stays."""
    burst: Burst | None = None
    chirp: Chirp | None = None
    signal: SampledSignal | None = None
    electrostatic: Electrostatic | None = None

    @model_validator(mode="after")
    def _one_carrier(self) -> Self:
        if self.signal is not None and self.chirp is not None:
            raise ValueError("chirp: drive.signal replaces the carrier, which cannot be swept; delete one of them")
        return self

    @model_validator(mode="after")
    def _burst_of_ramp(self) -> Self:
        """Start softly by a burst that no run sees the end of."""
        if self.ramp:
            if self.burst is not None:
                raise ValueError(f"ramp: {self.ramp:g} s, but drive.burst has a ramp of its own; delete one of them")
            self._derive("burst", Burst(duration=LARGEST, ramp=self.ramp))
        return self

    @model_serializer(mode="wrap")
    def _without_derived(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        tables: dict[str, Any] = dump(self)
        if self.ramp:
            tables.pop("burst", None)
        return tables

    @property
    def angular_frequency(self) -> float:
        """Angular frequency 2πf [rad/s]."""
        return 2 * math.pi * self.frequency

    @property
    def waveform_key(self) -> str | None:
        """First key that makes the drive other than tones from t = 0 on; None if none."""
        names = ("ramp", "burst", "chirp", "signal")
        return next((f"drive.{name}" for name in names if getattr(self, name)), None)

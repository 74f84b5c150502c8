"""The table ``[drive]``, the voltage of the actuators over time.

Actuator k applies Re(Z_k · carrier_k(t)) · envelope(t), where Z_k is its phasor. By default the carrier is exp(iωt)
and the envelope is one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field, model_validator

from warp_plate.scene.actuator import Actuator
from warp_plate.scene.fields import Flag, Gain, Instant, Moderate, NotNegative, Positive, Table, check_file_name


class Burst(Table):
    """An envelope that rises from 0 to 1, stays there, and falls back to 0."""

    start: Instant = 0.0  # start of the first burst [s]
    duration: Positive  # duration of a burst, ramps included [s]
    ramp: NotNegative = 0.0  # duration of the rise and of the fall, each half a period of a cosine [s]
    # Time from the start of one burst to the start of the next [s] (default: a single burst)
    period: Positive | None = None

    @model_validator(mode="after")
    def _ramps_and_period_fit(self) -> Burst:
        if 2 * self.ramp > self.duration * (1 + 1e-12):
            raise ValueError(f"ramp: {self.ramp:g} s is more than half of duration, {self.duration / 2:g} s")
        if self.period is not None and self.period < self.duration:
            raise ValueError(f"period: {self.period:g} s is shorter than a burst, duration = {self.duration:g} s")
        return self


class Chirp(Table):
    """A frequency sweep with continuous phase, from the frequency of each actuator at t = 0."""

    end_frequency: Positive  # frequency at ``duration`` and from then on [Hz]
    duration: Positive  # duration of the sweep [s]
    # The frequency changes by equal amounts ("linear") or equal factors ("logarithmic") in equal times
    law: Literal["linear", "logarithmic"] = "linear"


class SampledFile(Table):
    """Signals that are read from a file beside the scene file."""

    # Name of a WAV file, or of a CSV file with a column for each channel; its first column may hold times [s]
    file: str
    rate: Annotated[float, Field(ge=1e-3, le=1e7)] | None = None  # sampling rate of a CSV file without times [1/s]
    start: Instant = 0.0  # time at which the file begins [s]; added to the times of a CSV file

    @model_validator(mode="after")
    def _file_beside_scene(self) -> SampledFile:
        check_file_name("file", self.file, (".wav", ".csv"))
        if self.rate is not None and self.file.lower().endswith(".wav"):
            raise ValueError(f"rate: {self.file!r} contains its sampling rate; delete rate")
        return self


class SampledSignal(SampledFile):
    """A carrier that is read from a file beside the scene file."""

    # True if the file has a channel for each actuator, in the order of the scene; false if one channel drives them all
    per_actuator: Flag = False
    gain: Gain = 1.0  # factor on the samples; integer samples of a WAV file are first scaled to −1 ... 1 [1]
    repeat: Flag = False  # true to repeat the file; false for silence after its end


class Electrostatic(Table):
    """A pressure proportional to the square of the voltage: gain·(bias + V)², V = Re(Z·carrier)·envelope."""

    bias: Moderate = 0.0  # constant voltage of all actuators from t = 0 on, which no burst shapes [V]
    gain: Gain  # pressure per squared voltage [N/m² per V²]; ε₀/2d² for a gap of d metres in vacuum


class Drive(Table):
    """Settings of the drive that all actuators share."""

    # Frequency [Hz]; with ``signal``, the highest frequency of interest in the file, which only limits the time step
    frequency: Positive
    burst: Burst | None = None
    chirp: Chirp | None = None
    signal: SampledSignal | None = None
    electrostatic: Electrostatic | None = None

    @model_validator(mode="after")
    def _one_carrier(self) -> Drive:
        if self.signal is not None and self.chirp is not None:
            raise ValueError("chirp: drive.signal replaces the carrier, which cannot be swept; delete one of them")
        return self

    @property
    def waveform_key(self) -> str | None:
        """First key that makes the drive other than tones from t = 0 on; None if none."""
        names = ("burst", "chirp", "signal")
        return next((f"drive.{name}" for name in names if getattr(self, name) is not None), None)


def check_drive(drive: Drive, actuators: Sequence[Actuator], end: float) -> None:
    """Check actuators, and the burst, against the drive and the end [s] of the run.

    Raises:
        ValueError: a file replaces a frequency, voltages a force, a delay has no burst, or a burst starts too late;
            names the key.
    """
    after = f"s is after the run, which ends at window.end = {end:g} s"
    for index, actuator in enumerate(actuators):
        key, delay = f"actuators[{index}]", actuator.delay
        if delay is not None and drive.burst is None:
            raise ValueError(f"{key}.delay: there is no burst to delay; write [drive.burst], or delete the delay")
        if delay is not None and delay >= end:
            raise ValueError(f"{key}.delay: {delay:g} {after}")
        if actuator.frequency is not None and drive.signal is not None:
            raise ValueError(f"{key}.frequency: drive.signal replaces the carrier of all actuators; delete one of them")
        if actuator.force is not None and drive.electrostatic is not None:
            raise ValueError(f"{key}.force: {actuator.force:g} N, but drive.electrostatic takes volts; write magnitude")
    if drive.burst is not None and drive.burst.start >= end:
        raise ValueError(f"drive.burst.start: {drive.burst.start:g} {after}")

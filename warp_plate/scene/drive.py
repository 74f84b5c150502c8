"""The tables under ``[drive]``: what the actuators' voltages do in time; and the table of a load that moves.

Every actuator k presses with Re(Z_k · carrier_k(t)) · envelope(t), Z_k its phasor. Without further tables the carrier
is exp(iωt) and the envelope one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field, model_validator

from warp_plate.scene.fields import Flag, Gain, Instant, Moderate, NotNegative, Positive, Table, check_file_name

Place = Annotated[float, Field(ge=-1e6, le=1e6)]


class Burst(Table):
    """An envelope: it rises from 0 to 1, stays, and falls back to 0.

    start [s]; duration [s] with the ramps in it; ramp [s] of the rise, and of the fall, each half a period of a
    cosine; period [s] from one burst's start to the next one's, or None for a single burst.
    """

    start: Instant = 0.0
    duration: Positive
    ramp: NotNegative = 0.0
    period: Positive | None = None

    @model_validator(mode="after")
    def _fits(self) -> Burst:
        if 2 * self.ramp > self.duration * (1 + 1e-12):
            raise ValueError(
                f"ramp: {self.ramp:g} s twice, up and down, is longer than duration = {self.duration:g} s; at most "
                f"{self.duration / 2:g} s"
            )
        if self.period is not None and self.period < self.duration:
            raise ValueError(
                f"period: {self.period:g} s is shorter than duration = {self.duration:g} s; bursts must not overlap"
            )
        return self


class Chirp(Table):
    """A sweep from an actuator's frequency at t = 0 to ``end_frequency`` [Hz] at ``duration`` [s], where it stays.

    The frequency changes by the same amount ("linear") or by the same factor ("logarithmic") in every second. The phase
    is continuous.
    """

    end_frequency: Positive
    duration: Positive
    law: Literal["linear", "logarithmic"] = "linear"


class SampledSignal(Table):
    """A carrier read from a file beside the scene file: WAV with one channel, or CSV.

    ``rate`` [1/s] is for a CSV of one column; one of two columns has time [s] first. ``gain`` multiplies the samples
    (those of a WAV in whole numbers reach from −1 to 1). ``repeat``: begin again at the file's end instead of silence.
    """

    file: str
    rate: Annotated[float, Field(ge=1e-3, le=1e7)] | None = None
    gain: Gain = 1.0
    repeat: Flag = False

    @model_validator(mode="after")
    def _file_beside(self) -> SampledSignal:
        check_file_name("file", self.file, (".wav", ".csv"))
        if self.rate is not None and self.file.lower().endswith(".wav"):
            raise ValueError(f"rate: {self.file!r} says its own rate; delete rate")
        return self


class Electrostatic(Table):
    """A force that goes with the square of the voltage: pressure = gain·(bias + V)², V = Re(Z·carrier)·envelope.

    ``bias`` is in the unit of the actuators' magnitude [V]; ``gain`` [N/m² per V²] is ε₀/2d² for a gap of d metres in
    vacuum. The bias is there from t = 0, with every actuator, and a burst shapes the voltage alone.
    """

    bias: Moderate = 0.0
    gain: Gain


class Drive(Table):
    """What all actuators share: the frequency [Hz], and how the voltage changes beside it.

    With ``signal`` the file is the carrier, and ``frequency`` is the highest of its frequencies that matters: it
    bounds the time step that is chosen, and does nothing else.
    """

    frequency: Positive
    burst: Burst | None = None
    chirp: Chirp | None = None
    signal: SampledSignal | None = None
    electrostatic: Electrostatic | None = None

    @model_validator(mode="after")
    def _one_carrier(self) -> Drive:
        if self.signal is not None and self.chirp is not None:
            raise ValueError("chirp: drive.signal replaces the carrier, which nothing can sweep; delete one of them")
        return self


class MovingLoad(Table):
    """A force that travels over the plate.

    force [N], positive as the displacement; start (x, y) [m] at ``from_time`` [s]; velocity [m/s]; size [m], the side
    of the square over which it is spread, 0 for a point. It is there from ``from_time`` to ``to_time`` [s] (None: the
    end of the run), constant or, with ``frequency`` [Hz], as cos(2πft).
    """

    force: Moderate
    start: tuple[Place, Place]
    velocity: tuple[Place, Place] = (0.0, 0.0)
    size: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    from_time: Instant = 0.0
    to_time: Positive | None = None
    frequency: Positive | None = None

    @model_validator(mode="after")
    def _ordered(self) -> MovingLoad:
        if self.to_time is not None and self.to_time <= self.from_time:
            raise ValueError(f"to_time: {self.to_time:g} s must be later than from_time = {self.from_time:g} s")
        return self


def check_drive(
    drive: Drive, own_frequencies: Sequence[float | None], delays: Sequence[float | None], end: float
) -> None:
    """Compare the drive with the actuators' own frequencies [Hz] and delays [s], and with the end of the run [s].

    Raises:
        ValueError: an actuator has a frequency where a file is the carrier, or a delay where there is no burst, or the
            first burst comes after the run; the message begins with the key.
    """
    for index, delay in enumerate(delays):
        if delay is None:
            continue
        if drive.burst is None:
            raise ValueError(f"actuators[{index}].delay: there is no burst to delay; write [drive.burst], or delete it")
        if delay >= end:
            raise ValueError(
                f"actuators[{index}].delay: {delay:g} s is after the run, which ends at window.end = {end:g} s"
            )
    for index, frequency in enumerate(own_frequencies):
        if frequency is not None and drive.signal is not None:
            raise ValueError(
                f"actuators[{index}].frequency: drive.signal replaces the carrier of all actuators; delete one of them"
            )
    if drive.burst is not None and drive.burst.start >= end:
        raise ValueError(
            f"drive.burst.start: {drive.burst.start:g} s is after the run, which ends at window.end = {end:g} s"
        )

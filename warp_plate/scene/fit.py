"""The tables ``[fit]``, numbers that ``warp-plate fit`` takes from measurements, and ``[[measurement]]``."""

from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from warp_plate.scene.fields import Flag, Gain, Moderate, Name, Point, Positive, Table, Unit, flat_keys


class Measurement(Table):
    """A measured frequency response: where the panel was driven, and where its motion was sensed."""

    actuator: Annotated[Name | None, Field(examples=["left"])] = None
    """Name of the driven actuator; without it ``force_at`` is required."""
    force_at: Annotated[Point | None, Field(examples=[[0.05, 0.05]])] = None
    """Place x, y of a hammer or shaker."""
    point: Annotated[Point, Field(examples=[[0.15, 0.08]])]
    """Place x, y of the sensor."""
    quantity: Annotated[Literal["receptance", "mobility", "accelerance"], Field(examples=["mobility"])] = "accelerance"
    """Displacement, velocity or acceleration per force."""
    gain: Annotated[Gain, Unit("1"), Field(examples=[0.1])] = 1.0
    """Measured response over the true response in SI units."""

    @model_validator(mode="after")
    def _driven_once(self) -> Self:
        if (self.actuator is None) == (self.force_at is None):
            raise ValueError("actuator: write an actuator's name, or force_at = [x, y], and not both")
        return self


class TimeSignals(Table):
    """Time signals for responses: one channel holds the force, the others the sensors in order."""

    force_channel: Annotated[int, Field(ge=1, le=256, examples=[2])] = 1
    """Number of the channel with the force, from 1 on."""
    force_gain: Annotated[Gain, Unit("1/N"), Field(examples=[0.0225])] = 1.0
    """Recorded value over the true force in N."""
    estimator: Annotated[Literal["H1", "H2", "Hv"], Field(examples=["Hv"])] = "H1"
    """Estimator for noise in the response ("H1"), the force ("H2") or both ("Hv")."""
    rate: Annotated[Positive | None, Unit("1/s"), Field(examples=[48000.0])] = None
    """Samples per second of a text file without a column of times."""
    segment: Annotated[Positive, Unit("s"), Field(examples=[2.0])] = 1.0
    """Duration of the segments that are averaged; frequencies are multiples of 1/segment."""
    window: Annotated[Literal["hann", "boxcar"], Field(examples=["boxcar"])] = "hann"
    """Window of a segment: "hann" for segments that overlap by half, "boxcar" for segments without overlap."""
    hits: Annotated[Flag, Field(examples=[True])] = False
    """True if the record has hits of a hammer at any time, each of which begins a segment with a force window."""
    exponential: Annotated[Positive | None, Unit("s"), Field(examples=[0.3])] = None
    """Time constant of the exponential window of hits (default: none); its damping is not that of the fitted panel."""

    @model_validator(mode="after")
    def _window_of_hits(self) -> Self:
        if self.exponential is not None and not self.hits:
            raise ValueError("exponential: is a window of hits; write hits = true")
        return self


class Fit(Table):
    """The design variables of a fit, and how it is done."""

    free: Annotated[
        dict[str, tuple[Moderate, Moderate]],
        BeforeValidator(flat_keys),
        Unit("unit of the key"),
        Field(examples=[{"plate.young_modulus": [6e10, 8e10], "effects.damping.viscous": [10.0, 200.0]}]),
    ]
    """Lowest and highest value of each free key."""
    pairing: Annotated[Literal["order", "nearest", "mac"], Field(examples=["nearest"])] = "order"
    """Measured modes are the lowest ones in "order", those with the "nearest" frequencies, or those with the most
    similar shapes ("mac"). A column ``mode`` of the file overrides the first two."""
    starts: Annotated[int, Field(ge=1, le=10_000, examples=[32])] = 16
    """Number of starting points."""
    seed: Annotated[int, Field(ge=0, lt=2**63, examples=[7])] = 0
    """Random seed of the starts."""
    range: Annotated[tuple[Positive, Positive] | None, Unit("Hz"), Field(examples=[[50.0, 2000.0]])] = None
    """Lowest and highest frequency of responses that are used."""
    signals: TimeSignals | None = None
    """Set if the data are time signals."""
    origin: Annotated[Point | None, Field(examples=[[0.115, 0.12]])] = None
    """Place x, y on the plate of the origin of coordinates in measured files (default: the lower left corner)."""
    unit: Annotated[Literal["m", "cm", "mm", "in"] | None, Field(examples=["mm"])] = None
    """Unit of coordinates in measured files (default: that of dataset 164 of a universal file, otherwise m)."""

    @model_validator(mode="after")
    def _ranges(self) -> Self:
        if not self.free:
            raise ValueError('free: is empty; write a range for a key, such as "plate.young_modulus" = [6e10, 8e10]')
        for key, (low, high) in self.free.items():
            if low >= high:
                raise ValueError(f"free: {key} = {[low, high]}: the lowest value comes first, and they differ")
        if self.range is not None and self.range[0] >= self.range[1]:
            raise ValueError(f"range: {list(self.range)}: the lowest frequency comes first, and they differ")
        return self

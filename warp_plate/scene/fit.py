"""Free numbers of a panel: the tables ``[fit]``, numbers that ``warp-plate fit`` takes from measurements, with
``[[measurement]]``; and ``[design]``, what ``warp-plate design`` chooses."""

from collections.abc import Iterable, Mapping
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from warp_plate.scene.fields import (
    Area,
    Flag,
    Gain,
    Name,
    Point,
    Positive,
    Ranges,
    Table,
    Tolerances,
    Unit,
    check_area,
    flat_keys,
)

LengthUnit = Literal["m", "cm", "mm", "in"]
# Most keys with tolerances in a design.
MOST_TOLERANCES = 4
# Names and units of the objectives of a design for people.
OBJECTIVES = {
    "bound": ("localization factor of any drive", "1"),
    "drive": ("localization factor", "1"),
    "energy_target": ("energy of the target", "J"),
    "velocity": ("velocity of the target", "m/s"),
    "displacement": ("displacement of the target", "m"),
    "acceleration": ("acceleration of the target", "m/s²"),
    "sound": ("sound power level", "dB(A)"),
    "power": ("power fed", "W"),
}
# Objectives of a design that may be those of any drive of a unit effort.
PER_EFFORT = ("energy_target", "velocity", "displacement", "acceleration")


def _check_rising(ends: tuple[float, float] | None, shown: str, first: str) -> None:
    """Raise a ValueError, which begins with ``shown``, unless the ``first`` of two ends is the smaller one."""
    if ends is not None and ends[0] >= ends[1]:
        raise ValueError(f"{shown} {list(ends)}: the {first} comes first, and they differ")


def _check_ranges(ranges: Mapping[str, tuple[float, float]], key: str, what: str) -> None:
    for name, ends in ranges.items():
        _check_rising(ends, f"{key}: {name} =", f"lowest {what}")


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
    origin: Annotated[Point | None, Field(examples=[[0.115, 0.12]])] = None
    """Place x, y on the plate of the origin of the nodes in a universal file (default: that of ``fit``)."""
    unit: Annotated[LengthUnit | None, Field(examples=["mm"])] = None
    """Unit of the nodes in a universal file (default: that of ``fit``)."""

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
        Ranges,
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
    exponential: Annotated[Positive | None, Unit("s"), Field(examples=[0.4])] = None
    """Time constant of the exponential window under which responses in files were measured (default: none)."""
    origin: Annotated[Point | None, Field(examples=[[0.115, 0.12]])] = None
    """Place x, y on the plate of the origin of coordinates in measured files (default: the lower left corner)."""
    unit: Annotated[LengthUnit | None, Field(examples=["mm"])] = None
    """Unit of coordinates in measured files (default: that of dataset 164 of a universal file, otherwise m)."""

    @model_validator(mode="after")
    def _ranges(self) -> Self:
        if not self.free:
            raise ValueError('free: is empty; write a range for a key, such as "plate.young_modulus" = [6e10, 8e10]')
        _check_ranges(self.free, "free", "value")
        _check_rising(self.range, "range:", "lowest frequency")
        if self.exponential is not None and self.signals is not None:
            raise ValueError("exponential: is of responses; that of time signals is signals.exponential")
        return self


class FreeThickness(Table):
    """A thickness that varies over the plate, as a map of factors that replaces that of the effects."""

    range: Annotated[tuple[Positive, Positive], Unit("m"), Field(examples=[[3.5e-4, 7.5e-4]])]
    """Least and largest thickness."""
    length_scale: Annotated[Positive, Unit("m"), Field(examples=[0.02])]
    """Radius of the filter that smooths the map, whose numbers are half of it apart: no ridge is narrower."""
    mass: Annotated[Positive | None, Unit("1"), Field(examples=[1.0])] = None
    """Mass of the plate without what is attached, as a factor of that of the scene (default: any)."""
    symmetry: Annotated[Literal["none", "x", "y", "both"], Field(examples=["both"])] = "none"
    """Symmetry of the map, which is its own mirror image along x, about the middle of the plate, along y, or both."""
    steepness: Annotated[float, Field(ge=4, le=64, examples=[16.0]), Unit("1")] = 8.0
    """Steepness of the projection of the filtered map onto the range: 4 reaches 76 % of it, 8 96 %, and 40 leaves
    mostly two thicknesses."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        _check_rising(self.range, "range:", "least thickness")
        return self


class DesignLimits(Table):
    """Limits that a designed panel keeps."""

    mass: Annotated[Positive | None, Unit("kg"), Field(examples=[0.025])] = None
    """Largest mass of the panel with what is attached."""
    energy_target: Annotated[Positive | None, Unit("J"), Field(examples=[1e-9])] = None
    """Least kinetic energy of the target under the scene's drive."""
    least_velocity: Annotated[Positive | None, Unit("m/s"), Field(examples=[1e-3])] = None
    """Least root mean square of the target's velocity under the scene's drive."""
    least_displacement: Annotated[Positive | None, Unit("m"), Field(examples=[1e-6])] = None
    """The same of its displacement."""
    least_acceleration: Annotated[Positive | None, Unit("m/s²"), Field(examples=[2.0])] = None
    """The same of its acceleration, in a steady state."""
    sound: Annotated[float | None, Unit("dB(A)"), Field(ge=-200, le=200, examples=[40.0])] = None
    """Largest A-weighted level of the sound power, re 1 pW, under the scene's drive, in a steady state."""
    power: Annotated[Positive | None, Unit("W"), Field(examples=[0.1])] = None
    """Largest mean power that the scene's drive feeds, of coils the electrical one, in a steady state."""
    gap: Annotated[tuple[Positive, Positive] | None, Unit("Hz"), Field(examples=[[250.0, 330.0]])] = None
    """Lowest and highest frequency of a band without natural frequencies."""
    modes: Annotated[dict[Annotated[str, Field(pattern=r"^[1-9]\d{0,2}$")], tuple[Positive, Positive]], Unit("Hz")] = (
        Field(default_factory=dict, examples=[{"3": [240.0, 260.0]}])
    )
    """Lowest and highest natural frequency of modes by their numbers in the scene, from 1 on; in other panels a mode is
    the one with the most similar shape."""

    @property
    def given(self) -> bool:
        """True if there is a limit."""
        return self != DesignLimits()

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        _check_rising(self.gap, "gap:", "lowest frequency")
        _check_ranges(self.modes, "modes", "frequency")
        return self


class Design(Table):
    """Free numbers of a panel, the quantity that they maximise, and the search for it."""

    objective: Annotated[
        Literal["bound", "drive", "energy_target", "velocity", "displacement", "acceleration", "sound", "power"],
        Field(examples=["velocity"]),
    ] = "bound"
    """Quantity that is raised: the largest localization factor of any drive, that of the scene's own drive, or under
    that drive the kinetic energy of the target or the root mean square of its velocity, displacement or acceleration;
    or that is lowered: the level of the sound power, or the power that the scene's drive feeds."""
    effort: Annotated[Literal["drive", "power", "sound"] | None, Field(examples=["power"])] = None
    """Set for the largest energy, velocity, displacement or acceleration of the target by any drive of a unit effort,
    in place of that by the scene's own drive: the sum of the squares of all drives, the power that they feed, or the
    sound power that the plate radiates."""
    steady: Annotated[Flag, Field(examples=[True])] = False
    """True for means over all time of steady tones in place of the window from rest. Acceleration, sound, power and
    coils need it, or an effect that is steady."""
    limits: DesignLimits = DesignLimits()
    thickness: FreeThickness | None = None
    free: Annotated[Ranges, Field(default_factory=dict, examples=[{"effects.layers[0].thickness": [1e-4, 1e-3]}])]
    """Lowest and highest value of each free number, by its key."""
    places: Annotated[
        dict[str, Area],
        BeforeValidator(flat_keys),
        Unit("m"),
        Field(default_factory=dict, examples=[{"actuators[0]": [0.0, 0.1, 0.0, 0.2]}]),
    ]
    """Rectangles x0, x1, y0, y1 within which actuators, layers and oscillators move, by their keys."""
    count: Annotated[
        dict[str, Annotated[int, Field(ge=1)]],
        BeforeValidator(flat_keys),
        Field(default_factory=dict, examples=[{"effects.oscillators": 4}]),
    ]
    """Largest number of tables of a list that stay, of those whose mass, or of layers thickness, is free; the others
    are left out."""
    frequencies: Annotated[
        tuple[Positive, ...] | None, Unit("Hz"), Field(min_length=1, max_length=16, examples=[[280.0, 300.0]])
    ] = None
    """Frequencies at which the least value counts (default: that of the drive)."""
    tolerance: Tolerances
    """Relative tolerances of numbers of the scene, by their keys: the least value counts, of the panel and of those
    with one number at an end of its tolerance."""
    starts: Annotated[int, Field(ge=1, le=1000, examples=[10])] = 8
    """Number of starting points: the scene itself, then random ones."""
    iterations: Annotated[int, Field(ge=1, le=10_000, examples=[100])] = 50
    """Largest number of iterations from each."""
    seed: Annotated[int, Field(ge=0, lt=2**63, examples=[7])] = 0
    """Random seed of the starts."""

    @property
    def lowers(self) -> bool:
        """True if the objective is lowered."""
        return self.objective in ("sound", "power")

    @property
    def unit(self) -> str:
        """Unit of the objective."""
        one = OBJECTIVES[self.objective][1]
        if self.effort is None:
            return one
        of_effort = {"drive": "drive²", "power": "W", "sound": "W of sound"}[self.effort]
        return f"{one} per {of_effort}" if self.objective == "energy_target" else f"{one} per √({of_effort})"

    @property
    def label(self) -> str:
        """Name of the objective for people, with its unit."""
        name = OBJECTIVES[self.objective][0]
        drive = "" if self.objective == "bound" else " by the scene's drive" if self.effort is None else " by any drive"
        return f"{name}{drive}" if self.unit == "1" else f"{name}{drive} [{self.unit}]"

    @model_validator(mode="after")
    def _free(self) -> Self:
        if self.thickness is None and not self.free and not self.places:
            raise ValueError("thickness: nothing is free; write [design.thickness], [design.free] or [design.places]")
        _check_ranges(self.free, "free", "value")
        if self.effort is not None and self.objective not in PER_EFFORT:
            raise ValueError(f"effort: is of {', '.join(PER_EFFORT)}, and not of {self.objective}; delete it")
        if len(self.tolerance) > MOST_TOLERANCES:
            raise ValueError(f"tolerance: {len(self.tolerance)} keys; at most {MOST_TOLERANCES} are varied")
        return self

    def check(self, movable: Iterable[str], size: tuple[float, float]) -> None:
        """Raise ValueError, naming the key, unless all places are those of ``movable`` keys and on the plate."""
        there = list(movable)
        for key, area in self.places.items():
            if key not in there:
                raise ValueError(f"design.places: {key}: is no patch of this scene; write one of {', '.join(there)}")
            check_area(f"design.places.{key}", area, size)

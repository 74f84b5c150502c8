"""The table ``[specification]``: the levels that targets must reach, and those that are allowed elsewhere."""

import math
from collections.abc import Sequence, Set
from typing import Annotated, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from warp_plate.scene.fields import (
    IS_LIST,
    Area,
    Flag,
    Moderate,
    Name,
    NotNegative,
    OneOrRange,
    Positive,
    Table,
    Tolerances,
    Unit,
    check_area,
)
from warp_plate.scene.sound import PressureLimit, SoundLevel

STANDARD_GRAVITY = 9.80665  # m/s²
# Keys of a level, and the power of the angular frequency by which their peak becomes an acceleration [m/s²].
LEVEL_KEYS = {"acceleration_g": 0, "acceleration": 0, "velocity": 1, "displacement": 2}
# Factor and unit in which each is shown.
SHOWN_AS = {
    "acceleration_g": (1, "g"),
    "acceleration": (1, "m/s²"),
    "velocity": (1e3, "mm/s"),
    "displacement": (1e6, "µm"),
}
MOST_TOLERANCES = 4
_IS_WORD = Discriminator(lambda value: "word" if isinstance(value, str) else "number")


class _Motion(Table):
    """A level of motion, given by one of its keys."""

    acceleration_g: Annotated[Positive | None, Unit("g"), Field(examples=[1.0])] = None
    """Acceleration in units of 9.80665 m/s²."""
    acceleration: Annotated[Positive | None, Unit("m/s²"), Field(examples=[5.0])] = None
    """Acceleration."""
    velocity: Annotated[Positive | None, Unit("m/s"), Field(examples=[2e-3])] = None
    """Velocity."""
    displacement: Annotated[Positive | None, Unit("m"), Field(examples=[1e-6])] = None
    """Displacement."""
    rms: Annotated[Flag, Field(examples=[True])] = False
    """True if the level is the root mean square over time; false if it is the peak."""

    def _given(self) -> list[str]:
        return [key for key in LEVEL_KEYS if getattr(self, key) is not None]

    def peak_acceleration(self, frequency: float) -> float:
        """Return the level as the peak of an acceleration [m/s²] at a frequency [Hz]."""
        (key,) = self._given()
        return float(getattr(self, key) * self._unit_peak(frequency))

    def shown(self, peak: float, frequency: float) -> tuple[float, str]:
        """Return the peak of an acceleration [m/s²] at a frequency [Hz] in the unit of the level, and this unit."""
        (key,) = self._given()
        factor, unit = SHOWN_AS[key]
        return factor * peak / self._unit_peak(frequency), f"{unit} {'rms' if self.rms else 'peak'}"

    def _unit_peak(self, frequency: float) -> float:
        """Return the peak of the acceleration [m/s²] at a frequency [Hz] of a level of one unit of its key."""
        (key,) = self._given()
        unit = STANDARD_GRAVITY if key == "acceleration_g" else 1.0
        return float(unit * (2 * math.pi * frequency) ** LEVEL_KEYS[key] * (math.sqrt(2) if self.rms else 1.0))

    @property
    def text(self) -> str:
        """The level with its unit, for people."""
        (key,) = self._given()
        factor, unit = SHOWN_AS[key]
        return f"{factor * getattr(self, key):g} {unit} {'rms' if self.rms else 'peak'}"


class Level(_Motion):
    """A level that a target must reach."""

    target: Annotated[Name | None, Field(examples=["left thumb"])] = None
    """Name of one of ``[[targets]]`` (default: ``[target]``, or the first of them)."""
    measure: Annotated[Literal["weakest", "mean"], Field(examples=["mean"])] = "weakest"
    """Where the level is reached: at every point of the target, or as the root mean square over the target."""
    phase: Annotated[
        Annotated[Moderate, Tag("number")] | Annotated[Literal["free"], Tag("word")],
        _IS_WORD,
        Unit("rad"),
        Field(examples=[3.14]),
    ] = 0.0
    """Phase lag of the motion of all points of the target, relative to other targets; "free" for any phase at each
    point. Of a mean, phases are free."""

    @model_validator(mode="after")
    def _one_quantity(self) -> Self:
        _check_given(self._given(), list(LEVEL_KEYS))
        return self


class Allowance(_Motion):
    """A level that must not be exceeded outside the targets and their guard."""

    area: Annotated[Area | None, Field(examples=[[0.0, 0.05, 0.0, 0.13]])] = None
    """Rectangle x0, x1, y0, y1 where the level holds (default: the plate)."""
    relative_db: Annotated[Annotated[float, Field(ge=-200, le=200)] | None, Unit("dB"), Field(examples=[-10.0])] = None
    """Level relative to the lowest level of the targets, such as -10 for 10 dB less."""
    measure: Annotated[Literal["worst", "mean"], Field(examples=["mean"])] = "worst"
    """Where the level holds: at every point, or as the root mean square over the area."""

    @property
    def text(self) -> str:
        return super().text if self.relative_db is None else f"{self.relative_db:g} dB"

    def shown_over(self, peak: float, frequency: float, lowest: float) -> tuple[float, str]:
        """Return what :meth:`shown` does, or if the level is relative, dB over the ``lowest`` one wanted [m/s²]."""
        if self.relative_db is None:
            return self.shown(peak, frequency)
        return 20 * math.log10(max(peak, 1e-300) / lowest), "dB"

    @property
    def place(self) -> str:
        """Where the level holds, for people."""
        return "elsewhere" if self.area is None else "x {:g} to {:g}, y {:g} to {:g} m".format(*self.area)

    def largest(self, frequency: float, lowest: float) -> float:
        """Return the level as the peak of an acceleration [m/s²] at a frequency [Hz], where the ``lowest`` level of the
        targets is such a peak."""
        return self.peak_acceleration(frequency) if self.relative_db is None else lowest * 10 ** (self.relative_db / 20)

    @model_validator(mode="after")
    def _one_quantity(self) -> Self:
        given = [*self._given(), *(["relative_db"] if self.relative_db is not None else [])]
        _check_given(given, ["relative_db", *LEVEL_KEYS])
        if self.relative_db is not None and self.rms:
            raise ValueError("rms: true, but relative_db compares levels of one kind; delete it")
        return self


class DriveLimits(Table):
    """Limits of the actuators in place of their own magnitudes or forces."""

    force: Annotated[Positive | None, Unit("N"), Field(examples=[0.5])] = None
    """Largest peak of the force of each actuator."""
    voltage: Annotated[Positive | None, Unit("V"), Field(examples=[100.0])] = None
    """Largest peak of the voltage of each piezo patch, and at the terminals of each coil."""
    current: Annotated[Positive | None, Unit("A"), Field(examples=[1.0])] = None
    """Largest peak of the current in each coil."""
    heat: Annotated[Positive | None, Unit("W"), Field(examples=[10.0])] = None
    """Largest mean heat of each coil."""
    stroke: Annotated[Positive | None, Unit("m"), Field(examples=[1e-3])] = None
    """Largest peak of the displacement of each coil relative to its magnet."""
    power: Annotated[Positive | None, Unit("W"), Field(examples=[0.01])] = None
    """Largest mean mechanical power of all actuators together."""
    sound: Annotated[SoundLevel | None, Unit("dB(A)"), Field(examples=[40.0])] = None
    """Largest A-weighted sound power level, re 1 pW, of the plate in a baffle; see docs/sound.md."""
    pressures: tuple[PressureLimit, ...] = ()


class Specification(Table):
    """Requirements of a drive: levels in the targets and elsewhere, and limits of the actuators, for steady tones."""

    frequency: Annotated[OneOrRange | None, Unit("Hz"), Field(examples=[[180.0, 250.0]])] = None
    """Frequency, or lowest and highest frequency (default: that of the drive)."""
    band: Annotated[Flag, Field(examples=[True])] = False
    """True if every frequency of the range must have a drive; false if the best one is sought."""
    guard: Annotated[NotNegative, Unit("m"), Field(examples=[0.02])] = 0.0
    """Width of the rim around targets that belongs neither to them nor to the rest."""
    level: Annotated[
        Annotated[Level, Tag("one")] | Annotated[tuple[Level, ...], Field(min_length=1, max_length=64), Tag("several")],
        IS_LIST,
    ]
    elsewhere: Annotated[
        Annotated[Allowance, Tag("one")] | Annotated[tuple[Allowance, ...], Field(max_length=64), Tag("several")],
        IS_LIST,
    ] = ()
    limits: DriveLimits = DriveLimits()
    tolerance: Tolerances
    """Relative tolerances of numbers of the scene, by their keys."""

    @property
    def frequency_key(self) -> str:
        """Key of the frequency."""
        return "drive.frequency" if self.frequency is None else "specification.frequency"

    @property
    def sound_key(self) -> str | None:
        """First key that limits the sound of the plate; None if none."""
        keys = [key for key in ("sound", "pressures") if getattr(self.limits, key) not in (None, ())]
        return f"specification.limits.{keys[0]}" if keys else None

    @property
    def levels(self) -> Sequence[Level]:
        """Levels of the targets."""
        return (self.level,) if isinstance(self.level, Level) else self.level

    @property
    def allowances(self) -> Sequence[Allowance]:
        """Levels that are allowed elsewhere."""
        return (self.elsewhere,) if isinstance(self.elsewhere, Allowance) else self.elsewhere

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if isinstance(self.frequency, tuple) and not self.frequency[0] < self.frequency[1]:
            raise ValueError(f"frequency: {list(self.frequency)}: write the lower frequency first")
        if self.band and not isinstance(self.frequency, tuple):
            raise ValueError("band: true, but frequency is no range; write frequency = [LOW, HIGH]")
        targets = [level.target for level in self.levels]
        for index, target in enumerate(targets):
            if target in targets[:index]:
                raise ValueError(f"level[{index}].target: {target or 'the default'} has a level already")
        if len(self.tolerance) > MOST_TOLERANCES:
            raise ValueError(f"tolerance: {len(self.tolerance)} keys; at most {MOST_TOLERANCES} are varied together")
        return self

    def check(self, targets: Sequence[str], size: tuple[float, float], kinds: Set[str]) -> None:
        """Raise ValueError, naming the key, unless the specification fits a scene's targets, plate and kinds of
        actuators."""
        for index, level in enumerate(self.levels):
            if level.target is not None and level.target not in targets:
                there = (
                    f"the targets are {', '.join(targets)}"
                    if targets
                    else "there are no [[targets]]; leave this key out"
                )
                raise ValueError(f"specification.level[{index}].target: {level.target!r}: {there}")
        for index, allowance in enumerate(self.allowances):
            if allowance.area is not None:
                check_area(f"specification.elsewhere[{index}].area", allowance.area, size)
        limited = {"force": {"pressure"}, "voltage": {"piezo", "coil"}}
        limited |= {key: {"coil"} for key in ("current", "heat", "stroke")}
        names = {"pressure": "actuators that press", "piezo": "piezo patches", "coil": "coils"}
        for key, some in limited.items():
            if getattr(self.limits, key) is not None and not some & kinds:
                right = " or ".join(other for other in limited if limited[other] & kinds)
                there = " or ".join(names[kind] for kind in names if kind in kinds)
                raise ValueError(f"specification.limits.{key}: not of {there}; write {right}")


def _check_given(given: list[str], keys: list[str]) -> None:
    if not given:
        raise ValueError(f"{keys[0]}: no level is given; write one of {', '.join(keys)}")
    if len(given) > 1:
        raise ValueError(f"{given[1]}: {given[0]} is given too; write one of them")

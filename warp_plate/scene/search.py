"""The table ``[search]``: design variables, objectives, limits, uncertainty, and the method of the search.

A table named after a quantity of the drive makes it a design variable; all others stay as the scene has them. Without
any such table the search is that of the source paper: all magnitudes and phases vary, except those of the first
actuator, which stay at 1 and 0.
"""

from collections.abc import Sequence
from typing import Annotated, Literal, Self, TypeAlias, get_args

from pydantic import BeforeValidator, Field, model_validator

from warp_plate.effects.table import ATTACHED, Effects
from warp_plate.scene.fields import Area, Flag, Instant, Name, NotNegative, Positive, Table, Unit, flat_keys
from warp_plate.scene.sound import PressureLimit, SoundLevel

Weight = Annotated[float, Field(ge=0, le=1e6), Unit("1")]
# Names of the actuators that a table applies to (default: all).
Names = Annotated[tuple[Name, ...], Field(min_length=1)]
# A fraction of the nominal value: 0.05 is ± 5 %.
Tolerance = Annotated[float, Field(ge=0, lt=1), Unit("1")]
# Kinds of objectives that take the sound of the plate.
SOUNDS = ("sound", "quietness")
# Quantities of coils that are limited, and their units.
CoilQuantity: TypeAlias = Literal["voltage", "current", "heat", "stroke"]
COIL_UNITS = {"voltage": "V", "current": "A", "heat": "W", "stroke": "m"}
# Methods that move a swarm.
SWARMS = ("pso", "constriction", "ring")


class _Range(Table):
    range: Annotated[tuple[float, float] | None, Unit("drive"), Field(examples=[[0.5, 1.0]])]
    """Smallest and largest value."""
    actuators: Annotated[Names | None, Field(examples=[["left", "right"]])] = None
    """Names of those that vary (default: all)."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        low, high = self.range or (0.0, 1.0)
        if high <= low:
            raise ValueError(f"range: [{low:g}, {high:g}] has no inside; write the smaller number first")
        return self


class FreePhase(Table):
    """Phases vary; they wrap at 2π."""

    actuators: Annotated[Names | None, Field(examples=[["left", "right"]])] = None
    """Names of those that vary (default: all)."""


class FreeMagnitude(_Range):
    """Magnitudes vary within ``range`` [N/m², or V under ``[drive.electrostatic]``]."""

    range: Annotated[tuple[NotNegative, NotNegative] | None, Unit("drive"), Field(examples=[[0.5, 1.0]])] = None
    """Smallest and largest value (default: 0 and the largest magnitude of the scene's actuators)."""


class FreeFrequency(_Range):
    """The frequency varies within ``range`` [Hz], one for all actuators or, with ``own``, one for each."""

    range: Annotated[tuple[Positive, Positive], Unit("Hz"), Field(examples=[[100.0, 400.0]])]
    """Smallest and largest value."""
    own: Annotated[Flag, Field(examples=[True])] = False
    """True for a separate value for each actuator."""


class FreePosition(Table):
    """Actuators move, and stay entirely within ``area`` x0, x1, y0, y1 [m] (default: the plate), or ``areas``."""

    area: Annotated[Area | None, Field(examples=[[0.0, 0.2, 0.0, 0.12]])] = None
    """Rectangle x0, x1, y0, y1."""
    areas: Annotated[dict[Name, Area] | None, Unit("m"), Field(examples=[{"left": [0.0, 0.05, 0.0, 0.12]}])] = None
    """Rectangles for some actuators, by their names, in place of ``area``."""
    actuators: Annotated[Names | None, Field(examples=[["left", "right"]])] = None
    """Names of those that move (default: all)."""
    clearance: Annotated[NotNegative, Unit("m"), Field(examples=[0.002])] = 0.0
    """Smallest gap between two actuators, along x or along y."""


class FreeDelay(_Range):
    """The start of the burst varies within ``range`` [s], one for all actuators or, with ``own``, one for each."""

    range: Annotated[tuple[Instant, Instant], Field(examples=[[0.0, 0.01]])]
    """Smallest and largest value."""
    own: Annotated[Flag, Field(examples=[True])] = False
    """True for a separate value for each actuator."""


class Objective(Table):
    """A term of the weighted sum that is maximised.

    "localization": fraction of the kinetic energy in the target. "contrast": mean kinetic energy density of the target
    over that of the rest [dB]. "velocity", "displacement": RMS over target and window. "uniformity": evenness of the
    motion in the target, at most 1. "sound": A-weighted sound power level [dB re 1 pW]. "quietness": sound power of a
    piston that moves as the target does, over the plate's A-weighted one [dB].
    """

    kind: Annotated[
        Literal["localization", "contrast", "velocity", "displacement", "uniformity", "sound", "quietness"],
        Field(examples=["velocity"]),
    ] = "localization"
    """The quantity that is maximised."""
    weight: Annotated[float, Field(gt=0, le=1e30, examples=[10.0]), Unit("1")] = 1.0
    """Factor of the term, per unit of its kind."""
    rest_limit: Annotated[Positive | None, Unit("m/s or m"), Field(examples=[5e-5])] = None
    """Limit of the RMS over the rest, for "velocity" and "displacement"."""

    @model_validator(mode="after")
    def _limit_fits_kind(self) -> Self:
        if self.rest_limit is not None and self.kind not in ("velocity", "displacement"):
            raise ValueError(f"rest_limit: {self.kind!r} has none; it is for 'velocity' and 'displacement'")
        return self


class Limits(Table):
    """Limits of the amplifier, of coils, and of the motion and the sound of the plate."""

    magnitude: Annotated[Positive | None, Unit("drive"), Field(examples=[1.0])] = None
    """Largest magnitude of any actuator."""
    power: Annotated[Positive | None, Unit("(drive)²"), Field(examples=[2.0])] = None
    """Largest sum of squared magnitudes."""
    equal_magnitudes: Annotated[Flag, Field(examples=[True])] = False
    """True if all actuators have the same magnitude."""
    least_velocity: Annotated[Positive | None, Unit("m/s"), Field(examples=[1e-3])] = None
    """Least RMS velocity over target and window."""
    voltage: Annotated[Positive | None, Unit("V"), Field(examples=[8.0])] = None
    """Largest peak of the voltage at the terminals of each coil in steady motion."""
    current: Annotated[Positive | None, Unit("A"), Field(examples=[1.0])] = None
    """Largest peak of the current in each coil in steady motion."""
    heat: Annotated[Positive | None, Unit("W"), Field(examples=[10.0])] = None
    """Largest mean heat of each coil in steady motion."""
    stroke: Annotated[Positive | None, Unit("m"), Field(examples=[1e-3])] = None
    """Largest peak of the displacement of each coil relative to its magnet in steady motion."""
    sound: Annotated[SoundLevel | None, Unit("dB(A)"), Field(examples=[40.0])] = None
    """Largest A-weighted sound power level, re 1 pW, of the plate in a baffle in steady motion; see docs/sound.md."""
    pressures: tuple[PressureLimit, ...] = ()

    @property
    def of_coils(self) -> dict[CoilQuantity, float]:
        """Values of the limits on each coil, by their keys."""
        values = {key: getattr(self, key) for key in get_args(CoilQuantity)}
        return {key: value for key, value in values.items() if value is not None}

    def levels(self, coils: Sequence[str]) -> dict[str, tuple[str, float]]:
        """Return units and values of the limits on motion, sound and the named coils, by name."""
        rows = {"velocity": ("m/s", self.least_velocity), "sound": ("dB(A)", self.sound)}
        rows |= {row.name: ("dB(A)", row.level) for row in self.pressures}
        for key, limit in self.of_coils.items():
            rows |= {f"{key} of {name}": (COIL_UNITS[key], limit) for name in coils}
        return {name: (unit, value) for name, (unit, value) in rows.items() if value is not None}


class Robust(Table):
    """A robust search: drives are evaluated over plates with random deviations, uniform within tolerances."""

    scenarios: Annotated[int, Field(ge=1, le=100_000, examples=[32])] = 16
    """Number of plates for each drive."""
    measure: Annotated[Literal["mean", "worst", "quantile"], Field(examples=["quantile"])] = "mean"
    """Mean loss, largest loss, or the loss that only 1 − ``quantile`` of the scenarios exceed."""
    quantile: Annotated[float, Field(gt=0, lt=1, examples=[0.95]), Unit("1")] = 0.9
    """Quantile of the measure "quantile"."""
    young_modulus: Annotated[Tolerance, Field(examples=[0.05])] = 0.0
    """Tolerance of Young's modulus, as a fraction of the nominal value."""
    thickness: Annotated[Tolerance, Field(examples=[0.03])] = 0.0
    """Tolerance of the thickness, as a fraction of the nominal value."""
    damping: Annotated[Tolerance, Field(examples=[0.3])] = 0.0
    """Tolerance of all damping of the plate and its bed, as a fraction."""
    gain: Annotated[Tolerance, Field(examples=[0.1])] = 0.0
    """Tolerance of each actuator's magnitude, as a fraction."""
    place: Annotated[NotNegative, Unit("m"), Field(examples=[1e-3])] = 0.0
    """Largest error of each actuator's position along x and along y."""
    without_oscillators: Annotated[float, Field(ge=0, le=1, examples=[0.5]), Unit("1")] = 0.0
    """Probability that masses on springs are absent."""
    tolerance: Annotated[
        dict[str, Tolerance],
        BeforeValidator(flat_keys),
        Unit("1"),
        Field(default_factory=dict, examples=[{"edges.left.translation": 0.3}]),
    ]
    """Tolerances of other numbers of the scene, by their keys, as fractions of the nominal values."""
    fresh: Annotated[int, Field(ge=1, le=100_000, examples=[500])] = 200
    """Number of further scenarios, over which the robust and the nominal optimum are compared."""
    seed: Annotated[int, Field(ge=0, lt=2**63, examples=[7])] = 0
    """Random seed of the scenarios."""

    def check(self, effects: Effects, load: str) -> None:
        """Raise ValueError, naming the key, if nothing varies or a key does not apply to the scene."""
        panel = (self.young_modulus, self.thickness, self.damping, self.gain, self.place, self.without_oscillators)
        if not any((*panel, *self.tolerance.values())):
            raise ValueError("search.robust: all scenarios are alike; write a tolerance such as young_modulus = 0.05")
        # The default is allowed, because dumped scenes contain it.
        if self.measure != "quantile" and self.quantile != type(self).model_fields["quantile"].default:
            raise ValueError(f"search.robust.quantile = {self.quantile:g}: is for measure = 'quantile'; delete it")
        if self.damping and not any(effect.lossy for _, effect in effects.rows):
            raise ValueError(f"search.robust.damping: {self.damping:g} of no damping; write [effects.damping]")
        if self.without_oscillators and not effects.attached:
            share = f"search.robust.without_oscillators: {self.without_oscillators:g}"
            raise ValueError(f"{share}, but there is none; write [[{ATTACHED}]]")
        if self.place and load == "nodes":
            grid = 'grid.load = "nodes" moves actuators by whole nodes; write load = "overlap" or "moments"'
            raise ValueError(f"search.robust.place: {self.place:g} m, but {grid}")


class Search(Table):
    """Settings of the search; ``particles`` × ``iterations`` is the number of evaluations of every method.

    The swarm has the coefficients of the source paper: w (inertia), κ (decay), c₁ (cognitive), c₂ (social).
    """

    method: Annotated[
        Literal["pso", "constriction", "ring", "cma", "gradient", "exact"] | None, Field(examples=["cma"])
    ] = None
    """Method (default in linear scenes where only drives vary, with one objective and no key of a swarm: "exact" if all
    magnitudes and phases are free and a ratio counts, else "gradient"; by modes "exact" if only a frequency is left;
    otherwise "pso")."""
    particles: Annotated[int, Field(ge=2, le=10_000_000, examples=[40])] = 20
    """Number of candidates in each iteration."""
    iterations: Annotated[int, Field(ge=1, le=1_000_000_000, examples=[200])] = 80
    """Number of iterations, the first evaluation included."""
    restarts: Annotated[int, Field(ge=0, le=10_000, examples=[3])] = 0
    """Number of restarts of a search that stalls."""
    inertia: Annotated[Weight, Field(examples=[0.7])] = 0.4
    """Inertia w of "pso"."""
    decay: Annotated[float, Field(gt=0, le=1, examples=[1.0]), Unit("1")] = 0.99
    """Factor κ on w in each iteration."""
    cognitive: Annotated[Weight, Field(examples=[1.5])] = 2.0
    """Attraction c₁ to the particle's own best position."""
    social: Annotated[Weight, Field(examples=[1.5])] = 2.0
    """Attraction c₂ to the best position of the swarm."""
    velocity_limit: Annotated[Annotated[float, Field(gt=0, le=1e100)] | None, Unit("1"), Field(examples=[0.5])] = None
    """Largest velocity component of a particle (default: no limit)."""
    stall: Annotated[Annotated[int, Field(ge=1)] | None, Field(examples=[30])] = None
    """Number of iterations without improvement after which the search restarts or stops (default: never)."""
    seed: Annotated[int, Field(ge=0, lt=2**63, examples=[7])] = 0
    """Random seed of the search."""
    magnitude: FreeMagnitude | None = None
    phase: FreePhase | None = None
    frequency: FreeFrequency | None = None
    position: FreePosition | None = None
    delay: FreeDelay | None = None
    objectives: Annotated[tuple[Objective, ...], Field(min_length=1)] = (Objective(),)
    limits: Limits = Limits()
    robust: Robust | None = None

    @model_validator(mode="after")
    def _different_objectives(self) -> Self:
        kinds = [objective.kind for objective in self.objectives]
        for index, kind in enumerate(kinds):
            if kind in kinds[:index]:
                raise ValueError(f"objectives[{index}].kind: {kind!r} is there already; add their weights instead")
        return self

    @property
    def tone_key(self) -> str | None:
        """First key that takes the sound of the plate or limits a coil, which only steady tones do; None if none."""
        return self.sound_key or next((f"search.limits.{key}" for key in self.limits.of_coils), None)

    @property
    def sound_key(self) -> str | None:
        """First key that takes the sound of the plate; None if none."""
        keys = [f"objectives[{index}].kind" for index, term in enumerate(self.objectives) if term.kind in SOUNDS]
        keys += ["limits.sound"] * (self.limits.sound is not None) + ["limits.pressures"] * bool(self.limits.pressures)
        return f"search.{keys[0]}" if keys else None

    def check_limits(self, names: Sequence[str]) -> None:
        """Raise ValueError, naming the key, if limits exclude every magnitude that the named actuators may have."""
        if self.magnitude is None or self.magnitude.range is None:
            return
        limits, low = self.limits, self.magnitude.range[0]
        range_text = f"search.magnitude.range[0] = {low:g}; raise it or lower the range"
        if limits.magnitude is not None and limits.magnitude < low:
            raise ValueError(f"search.limits.magnitude = {limits.magnitude:g}: below {range_text}")
        varied = self.magnitude.actuators
        least = low**2 * sum(varied is None or name in varied for name in names)
        if limits.power is not None and limits.power < least * (1 - 1e-9):
            squares = f"below {least:g}, the sum of squares of {range_text}"
            raise ValueError(f"search.limits.power = {limits.power:g}: {squares}")

"""The table ``[search]``: what may vary, what is sought, under which limits, against which scatter, by which method.

A table named after a variable frees it; what none frees stays as the scene has it. Without any such table the search
is the source paper's: all magnitudes and phases, those of the first actuator held at 1 and 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field, model_validator

from warp_plate.scene.effects import Effects
from warp_plate.scene.fields import Area, Flag, Instant, Name, NotNegative, Positive, Table

Weight = Annotated[float, Field(ge=0, le=1e6)]
# Of actuators; a table that names none at all is left out.
Names = Annotated[tuple[Name, ...], Field(min_length=1)]
# A part of a number's own size: 0.05 is ± 5 %.
Tolerance = Annotated[float, Field(ge=0, lt=1)]


def _check_range(low: float, high: float) -> None:
    if high <= low:
        raise ValueError(f"range: [{low:g}, {high:g}] has no inside; write the smaller number first")


class FreePhase(Table):
    """Phases are sought, of all actuators or of the ones named; they wrap at 2π."""

    actuators: Names | None = None


class FreeMagnitude(Table):
    """Magnitudes [N/m²; V under ``[drive.electrostatic]``] are sought within ``range``, of all actuators or of the
    ones named."""

    range: tuple[NotNegative, NotNegative]
    actuators: Names | None = None

    @model_validator(mode="after")
    def _ordered(self) -> FreeMagnitude:
        _check_range(*self.range)
        return self


class FreeFrequency(Table):
    """The frequency [Hz] is sought within ``range``: one for all actuators, or with ``own`` one for each."""

    range: tuple[Positive, Positive]
    own: Flag = False
    actuators: Names | None = None

    @model_validator(mode="after")
    def _ordered(self) -> FreeFrequency:
        _check_range(*self.range)
        return self


class FreePosition(Table):
    """Actuators are moved, all or the ones named, each staying whole within ``area`` [m] (None: the plate)."""

    area: Area | None = None
    actuators: Names | None = None


class FreeDelay(Table):
    """The burst's start [s] is sought within ``range``: one for all actuators, or with ``own`` one for each."""

    range: tuple[Instant, Instant]
    own: Flag = False
    actuators: Names | None = None

    @model_validator(mode="after")
    def _ordered(self) -> FreeDelay:
        _check_range(*self.range)
        return self


# Of what each kind of objective measures.
OBJECTIVE_UNITS = {"localization": "1", "contrast": "dB", "velocity": "m/s", "displacement": "m", "uniformity": "1"}


class Objective(Table):
    """One thing that is sought; several are added with their weights.

    "localization": share of the plate's kinetic energy in the target. "contrast": mean kinetic energy density of the
    target over that of the rest [dB]. "velocity", "displacement": RMS over target and window [m/s, m]; ``rest_limit``
    is what the RMS over the rest of the plate may reach, in the same unit. "uniformity": 1 where the kinetic energy
    density is the same all over the target.
    """

    kind: Literal["localization", "contrast", "velocity", "displacement", "uniformity"] = "localization"
    weight: Annotated[float, Field(gt=0, le=1e30)] = 1.0
    rest_limit: Positive | None = None

    @model_validator(mode="after")
    def _limit_fits(self) -> Objective:
        if self.rest_limit is not None and self.kind not in ("velocity", "displacement"):
            raise ValueError(f"rest_limit: {self.kind!r} has none; it is for 'velocity' and 'displacement'")
        return self


class Limits(Table):
    """What the amplifier can do: largest magnitude of any actuator and of power, Σ magnitude², in the magnitudes' unit
    and its square; ``equal_magnitudes``: all actuators have the same."""

    magnitude: Positive | None = None
    power: Positive | None = None
    equal_magnitudes: Flag = False


class Robust(Table):
    """The panel that one really has: every drive is judged by ``scenarios`` plates drawn evenly within tolerances.

    young_modulus, thickness, damping, gain (of each actuator): parts of the nominal values, 0.05 for ± 5 %. place [m]:
    by which each actuator may be off along x and y. without_oscillators: probability that the scene's oscillators (a
    finger) are away. measure: the mean, the worst case, or the loss that only 1 − ``quantile`` of the scenarios pass.
    fresh: other scenarios, over which the drive that was found is compared with the nominal one.
    """

    scenarios: Annotated[int, Field(ge=1, le=100_000)] = 16
    measure: Literal["mean", "worst", "quantile"] = "mean"
    quantile: Annotated[float, Field(gt=0, lt=1)] = 0.9
    young_modulus: Tolerance = 0.0
    thickness: Tolerance = 0.0
    damping: Tolerance = 0.0
    gain: Tolerance = 0.0
    place: NotNegative = 0.0
    without_oscillators: Annotated[float, Field(ge=0, le=1)] = 0.0
    fresh: Annotated[int, Field(ge=1, le=100_000)] = 200
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0

    def check(self, effects: Effects, load: str) -> None:
        """Raise ValueError, naming the key, where nothing is drawn, what is drawn is not in the scene, or a quantile is
        not read."""
        drawn = (self.young_modulus, self.thickness, self.damping, self.gain, self.place, self.without_oscillators)
        if not any(drawn):
            raise ValueError(
                "search.robust: all scenarios are alike; write a tolerance such as young_modulus = 0.05, or delete it"
            )
        # The default is no fault: a scene that is written out has it too.
        if self.measure != "quantile" and self.quantile != type(self).model_fields["quantile"].default:
            raise ValueError(
                f"search.robust.quantile = {self.quantile:g}: is read with measure = 'quantile' alone, and it is "
                f"{self.measure!r}; change it, or delete quantile"
            )
        bed = effects.foundation is not None and effects.foundation.damping
        if self.damping and not (effects.damping or effects.material_damping or bed):
            raise ValueError(
                f"search.robust.damping: {self.damping:g} of no damping; write [effects.damping], or delete the key"
            )
        if self.without_oscillators and not effects.oscillators:
            raise ValueError(
                f"search.robust.without_oscillators: {self.without_oscillators:g}, but there is none; write "
                "[[effects.oscillators]], or delete the key"
            )
        if self.place and load == "nodes":
            raise ValueError(
                f'search.robust.place: grid.load = "nodes" moves an actuator by whole nodes, not by {self.place:g} m; '
                'write load = "overlap" or "moments"'
            )


class Search(Table):
    """How the drive is sought.

    The swarm has the paper's names: w (inertia), κ (decay), c₁ (cognitive), c₂ (social). Other methods take particles ×
    iterations as the evaluations that they may make.
    """

    method: Literal["pso", "constriction", "ring", "cma", "gradient", "exact"] = "pso"
    particles: Annotated[int, Field(ge=2, le=10_000_000)] = 20
    iterations: Annotated[int, Field(ge=1, le=1_000_000_000)] = 80
    restarts: Annotated[int, Field(ge=0, le=10_000)] = 0
    inertia: Weight = 0.4
    decay: Annotated[float, Field(gt=0, le=1)] = 0.99
    cognitive: Weight = 2.0
    social: Weight = 2.0
    velocity_limit: Annotated[float, Field(gt=0, le=1e100)] | None = None
    stall: Annotated[int, Field(ge=1)] | None = None
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    magnitude: FreeMagnitude | None = None
    phase: FreePhase | None = None
    frequency: FreeFrequency | None = None
    position: FreePosition | None = None
    delay: FreeDelay | None = None
    objectives: Annotated[tuple[Objective, ...], Field(min_length=1)] = (Objective(),)
    limits: Limits = Limits()
    robust: Robust | None = None

    @model_validator(mode="after")
    def _each_kind_once(self) -> Search:
        kinds = [one.kind for one in self.objectives]
        for index, kind in enumerate(kinds):
            if kind in kinds[:index]:
                raise ValueError(f"objectives[{index}].kind: {kind!r} is there already; add their weights instead")
        return self

    def check_limits(self, names: Sequence[str]) -> None:
        """Raise ValueError, naming the key, where the limits shut out every magnitude that the actuators of these names
        are free to have."""
        free, limits = self.magnitude, self.limits
        if free is None:
            return
        low = free.range[0]
        if limits.magnitude is not None and limits.magnitude < low:
            raise ValueError(
                f"search.limits.magnitude = {limits.magnitude:g}: below search.magnitude.range[0] = {low:g}; raise it "
                "or lower the range"
            )
        least = low**2 * sum(free.actuators is None or name in free.actuators for name in names)
        if limits.power is not None and limits.power < least * (1 - 1e-9):
            raise ValueError(
                f"search.limits.power = {limits.power:g}: below {least:g}, which the squares of "
                f"search.magnitude.range[0] = {low:g} add up to; raise it or lower the range"
            )

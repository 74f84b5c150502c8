"""The tables under ``[effects]``: each turns one effect on, and nothing else does."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator
from pydantic_core import PydanticCustomError

from warp_plate.scene.drive import MovingLoad
from warp_plate.scene.fields import Area, Flag, Moderate, NotNegative, Positive, Table, check_file_name

# A plate that varies by more has a mistake in it, or no number left for the time step.
LEAST_FACTOR, MOST_FACTOR = 1e-3, 1e3


class Damping(Table):
    """Viscous damping, c u̇ on the left of the equation of motion.

    ``viscous`` is c [N·s/m³]. ``scheme`` says at which time the rate u̇ is taken: "centred" between the two
    half-steps (second order; leaves the stability limit alone) or "backward", at the last half-step, as the
    source paper prints it in equation (6) (first order; lowers the limit).
    """

    viscous: NotNegative
    scheme: Literal["centred", "backward"] = "centred"


class MaterialDamping(Table):
    """Kelvin-Voigt damping of the plate's material: bending moments follow u + time·u̇ instead of u.

    ``time`` is the retardation time [s]; a mode of angular frequency ω has the loss factor time·ω.
    """

    time: NotNegative


class Tension(Table):
    """In-plane forces per length [N/m] along x and y, positive where they pull: −(Tx u_xx + Ty u_yy) on the left."""

    x: Moderate = 0.0
    y: Moderate = 0.0


class Foundation(Table):
    """An elastic bed under the whole plate, k u + c u̇ on the left: k [N/m³], c [N·s/m³]."""

    stiffness: NotNegative
    damping: NotNegative = 0.0


class Orthotropic(Table):
    """Rigidities of an orthotropic plate [N·m], in place of EH³/12(1 − ν²): Mx = Dx u_xx + D1 u_yy, My = D1 u_xx +
    Dy u_yy, Mxy = 2 Dxy u_xy. An isotropic plate has Dx = Dy = D, D1 = νD, Dxy = (1 − ν)D/2."""

    Dx: Positive
    Dy: Positive
    D1: Moderate
    Dxy: Positive

    @model_validator(mode="after")
    def _definite(self) -> Orthotropic:
        if self.Dx * self.Dy * (1 - 1e-9) <= self.D1**2:
            raise ValueError(
                f"D1: {self.D1:g} N·m gives negative energies; its size must be below √(Dx Dy) = "
                f"{(self.Dx * self.Dy) ** 0.5:g}"
            )
        return self


def _rows(value: object) -> object:
    if not isinstance(value, list | tuple) or not value or not all(isinstance(row, list | tuple) for row in value):
        raise PydanticCustomError("rows", "must be a list of rows such as [[1.0, 1.0]], or a file's name")
    return value


Factor = Annotated[float, Field(ge=LEAST_FACTOR, le=MOST_FACTOR)]
FactorRow = Annotated[tuple[Factor, ...], Field(min_length=1)]
FactorRows = Annotated[tuple[FactorRow, ...], Field(min_length=1), BeforeValidator(_rows)]
Factors = Annotated[
    Annotated[str, Tag("word")] | Annotated[FactorRows, Tag("rows")],
    Discriminator(lambda value: "word" if isinstance(value, str) else "rows"),
]


class Variation(Table):
    """Thickness, Young's modulus and density that vary over the plate, as factors of what ``[plate]`` says.

    Each an array, or the name of a CSV file beside the scene file that holds one: rows from y = 0 to the plate's other
    side, columns from x = 0, evenly spaced from edge to edge; in between bilinear. A single row holds for all y, a
    single column for all x. Bending stiffness goes with E H³, mass with ρH.
    """

    thickness: Factors | None = None
    young_modulus: Factors | None = None
    density: Factors | None = None

    @model_validator(mode="after")
    def _something(self) -> Variation:
        named = [(key, value) for key, value in self if value is not None]
        if not named:
            raise ValueError("thickness: no array is given; write one, or one of young_modulus and density")
        for key, value in named:
            if isinstance(value, str):
                check_file_name(key, value, (".csv",))
            elif any(len(row) != len(value[0]) for row in value):
                raise ValueError(f"{key}: its rows differ in length; write as many factors in each")
        return self

    @property
    def files(self) -> Iterator[str]:
        """Names of the files that hold its arrays."""
        return (value for _, value in self if isinstance(value, str))


class Layer(Table):
    """Material bonded to the plate over a rectangle: a stiffener, a foil, an actuator's body.

    ``both``: on both faces, each of this thickness; else on one, where it moves the neutral plane. Poisson's ratio is
    the plate's.
    """

    area: Area
    thickness: Positive
    young_modulus: Annotated[NotNegative, Field(le=1e13)]
    density: Annotated[NotNegative, Field(le=1e5)]
    both: Flag = False


class Oscillator(Table):
    """A mass that hangs on a patch by a spring and a damper: a fingertip, a foam pad.

    mass [kg]; stiffness [N/m]; damping [N·s/m]. Without a mass the spring stands on the ground.
    """

    area: Area
    mass: NotNegative = 0.0
    stiffness: NotNegative = 0.0
    damping: NotNegative = 0.0

    @model_validator(mode="after")
    def _something(self) -> Oscillator:
        if self.stiffness == 0 and self.damping == 0:
            raise ValueError("stiffness: an oscillator needs a stiffness or a damping to hold on to the plate")
        return self


class Stretching(Table):
    """Stretching at large amplitude after Berger: the mean slope pulls an isotropic plate with
    N = 6D/(H² area) ∫ |∇u|² dA, −N∇²u on the left. Its edges do not move in the plane."""


class Effects(Table):
    """The effects that a scene names; ``None`` or nothing means that the effect is not in the compiled kernel."""

    damping: Damping | None = None
    material_damping: MaterialDamping | None = None
    tension: Tension | None = None
    foundation: Foundation | None = None
    orthotropic: Orthotropic | None = None
    variation: Variation | None = None
    layers: tuple[Layer, ...] = ()
    oscillators: tuple[Oscillator, ...] = ()
    stretching: Stretching | None = None
    moving_load: MovingLoad | None = None

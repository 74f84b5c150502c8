"""The tables under ``[effects]``. An effect is compiled into the kernels only if the scene names its table."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

import numpy as np
from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator
from pydantic_core import PydanticCustomError

from warp_plate.scene.drive import Drive, MovingLoad
from warp_plate.scene.fields import Area, Flag, Moderate, NotNegative, Positive, Table, check_file_name

LEAST_FACTOR, MOST_FACTOR = 1e-3, 1e3  # larger variations are mistakes, or make the time step vanish


class Damping(Table):
    """Viscous damping, c u̇ on the left of the equation of motion."""

    viscous: NotNegative  # damping c [N·s/m³]
    # Velocity that is damped: "centred" in the step (second order, same stability limit), or "backward", from the last
    # half-step, as in equation (6) of the source paper (first order, lower limit)
    scheme: Literal["centred", "backward"] = "centred"


class MaterialDamping(Table):
    """Kelvin-Voigt damping of the plate's material: bending moments follow u + time·u̇ instead of u."""

    time: NotNegative  # retardation time [s]; a mode of angular frequency ω has the loss factor time·ω


Fraction = Annotated[NotNegative, Field(lt=1)]
Fractions = Annotated[tuple[Fraction, ...], Field(min_length=1)]
# A number for all modes, or one for each in order, the last of which holds for all higher modes.
PerMode = Annotated[
    Annotated[Fraction, Tag("number")] | Annotated[Fractions, Tag("list")],
    Discriminator(lambda value: "list" if isinstance(value, list | tuple) else "number"),
]


class LossFactor(Table):
    """Hysteretic damping: the bending stiffness times 1 + iη, with a loss factor η that does not depend on frequency.

    It is defined only for steady tones and needs the modal engine. ``[window]`` is not read: energies are means over
    all time. A list gives the loss factor of each mode in order; the last one holds for all higher modes.
    """

    eta: PerMode  # loss factor η [1]


class ModalDamping(Table):
    """Viscous damping of each mode, 2ζω on its velocity, added to all other damping. It needs the modal engine.

    A list gives the damping ratio of each mode in order; the last one holds for all higher modes.
    """

    ratio: PerMode  # damping ratio ζ [1]


def per_mode(values: float | tuple[float, ...], count: int) -> np.ndarray:
    """Return (count,) values of a key of type ``PerMode`` for the lowest modes."""
    listed = np.atleast_1d(values)
    return listed[np.minimum(np.arange(count), len(listed) - 1)]


class Tension(Table):
    """In-plane tension, −(Tx u_xx + Ty u_yy) on the left of the equation of motion; a plate that buckles is refused."""

    x: Moderate = 0.0  # force per length along x, positive in tension [N/m]
    y: Moderate = 0.0  # force per length along y [N/m]


class Foundation(Table):
    """An elastic foundation under the whole plate, k u + c u̇ on the left of the equation of motion."""

    stiffness: NotNegative  # stiffness k [N/m³]
    damping: NotNegative = 0.0  # damping c [N·s/m³]


class Orthotropic(Table):
    """An orthotropic plate: Mx = Dx u_xx + D1 u_yy, My = D1 u_xx + Dy u_yy, Mxy = 2 Dxy u_xy.

    The rigidities [N·m] replace D = EH³/12(1 − ν²) of an isotropic plate, for which Dx = Dy = D, D1 = νD and
    Dxy = (1 − ν)D/2.
    """

    Dx: Positive  # bending rigidity along x [N·m]
    Dy: Positive  # bending rigidity along y [N·m]
    D1: Moderate  # coupling between both directions [N·m]; D1² must be below Dx Dy
    Dxy: Positive  # twisting rigidity [N·m]

    @model_validator(mode="after")
    def _positive_definite(self) -> Orthotropic:
        if self.Dx * self.Dy * (1 - 1e-9) <= self.D1**2:
            root = (self.Dx * self.Dy) ** 0.5
            raise ValueError(f"D1: {self.D1:g} N·m gives negative energies; |D1| must be below √(Dx Dy) = {root:g}")
        return self


def _rows(value: object) -> object:
    if not isinstance(value, list | tuple) or not value or not all(isinstance(row, list | tuple) for row in value):
        raise PydanticCustomError("rows", "must be a list of rows such as [[1.0, 1.0]], or the name of a file")
    return value


Factor = Annotated[float, Field(ge=LEAST_FACTOR, le=MOST_FACTOR)]
FactorRow = Annotated[tuple[Factor, ...], Field(min_length=1)]
FactorRows = Annotated[tuple[FactorRow, ...], Field(min_length=1), BeforeValidator(_rows)]
Factors = Annotated[
    Annotated[str, Tag("word")] | Annotated[FactorRows, Tag("rows")],
    Discriminator(lambda value: "word" if isinstance(value, str) else "rows"),
]


class Variation(Table):
    """Thickness, Young's modulus and density that vary over the plate, as factors on those of ``[plate]``.

    Each is an array, or the name of a CSV file beside the scene file with one: rows along y, columns along x, evenly
    spaced from edge to edge, with bilinear interpolation. A single row holds for all y, a single column for all x.
    Columns are separated by commas, semicolons or tabs, with decimal points. An array finer than the grid is sampled
    at its nodes, not averaged. Layers lie on the local thickness; ``[effects.orthotropic]`` is multiplied as well.
    """

    thickness: Factors | None = None  # factor on the thickness [1]
    young_modulus: Factors | None = None  # factor on Young's modulus [1]
    density: Factors | None = None  # factor on the density [1]

    @model_validator(mode="after")
    def _consistent(self) -> Variation:
        named = [(key, value) for key, value in self if value is not None]
        if not named:
            raise ValueError("thickness: no array is given; write one, or one of young_modulus and density")
        for key, value in named:
            if isinstance(value, str):
                check_file_name(key, value, (".csv",))
            elif any(len(row) != len(value[0]) for row in value):
                raise ValueError(f"{key}: its rows differ in length; write the same number of factors in each")
        return self

    @property
    def files(self) -> Iterator[str]:
        """Names of the files that hold arrays."""
        return (value for _, value in self if isinstance(value, str))


class Layer(Table):
    """Material bonded to the plate over a rectangle: a stiffener, a foil, the body of an actuator."""

    area: Area  # rectangle x0, x1, y0, y1 [m]
    thickness: Positive  # thickness on each face that has the layer [m]
    young_modulus: Annotated[NotNegative, Field(le=1e13)]  # Young's modulus [Pa]; Poisson's ratio is that of the plate
    density: Annotated[NotNegative, Field(le=1e5)]  # density [kg/m³]
    both: Flag = False  # true for a layer on both faces; a layer on one face shifts the neutral plane


class Oscillator(Table):
    """A mass on a patch of the plate, held by a spring and a damper: a fingertip, a foam pad."""

    area: Area  # rectangle x0, x1, y0, y1 of the patch [m]
    mass: NotNegative = 0.0  # mass [kg]; without mass the spring and damper are fixed to the ground
    stiffness: NotNegative = 0.0  # stiffness of the spring [N/m]
    damping: NotNegative = 0.0  # damping [N·s/m]

    @model_validator(mode="after")
    def _attached(self) -> Oscillator:
        if self.stiffness == 0 and self.damping == 0:
            raise ValueError("stiffness: an oscillator needs a stiffness or a damping")
        return self


class Stretching(Table):
    """Stretching at large amplitude, after Berger, for an isotropic plate with in-plane fixed edges: the tension
    N = 6D/(H² area) ∫ |∇u|² dA, −N∇²u on the left of the equation of motion."""


class Effects(Table):
    """Effects of a scene; those that are None or empty are not compiled into the kernels."""

    damping: Damping | None = None
    material_damping: MaterialDamping | None = None
    loss_factor: LossFactor | None = None
    modal_damping: ModalDamping | None = None
    tension: Tension | None = None
    foundation: Foundation | None = None
    orthotropic: Orthotropic | None = None
    variation: Variation | None = None
    layers: tuple[Layer, ...] = ()
    oscillators: tuple[Oscillator, ...] = ()
    stretching: Stretching | None = None
    moving_load: MovingLoad | None = None


def check_modal_tables(effects: Effects, drive: Drive) -> None:
    """Raise ValueError, naming both keys, if the damping of modes cannot go with another effect or the drive."""
    nonlinear = {"effects.stretching": effects.stretching, "drive.electrostatic": drive.electrostatic}
    transient = {f"drive.{name}": getattr(drive, name) for name in ("burst", "chirp", "signal")}
    transient["effects.moving_load"] = effects.moving_load
    for name, others, reason in (
        ("loss_factor", transient, "a loss factor is defined for steady tones alone"),
        ("loss_factor", nonlinear, "only a linear plate has it"),
        ("modal_damping", nonlinear, "only a linear plate has modes"),
    ):
        other = next((key for key, value in others.items() if value is not None), None)
        if getattr(effects, name) is not None and other is not None:
            raise ValueError(f"effects.{name}: {reason}; delete it or {other}")
    loss = effects.loss_factor
    if effects.modal_damping is not None and loss is not None and isinstance(loss.eta, tuple):
        reason = "effects.loss_factor.eta lists the damping of each mode"
        raise ValueError(f"effects.modal_damping: {reason}; delete one of them")

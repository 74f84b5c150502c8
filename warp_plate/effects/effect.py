"""Effects: tables of the scene, and the terms that they add to the equation of motion.

A linear plate is a sum of quadratic forms in its displacement u or velocity u̇,

    T = ½ Σ ∫ m ∂u̇ ∂'u̇,     U = ½ Σ ∫ k ∂u ∂'u,     F = ½ Σ ∫ c ∂u̇ ∂'u̇,

each over the plate, along an edge, or of the mean displacement of a patch. A :class:`Term` is one of them, as data; it
is read by ``modal/assemble.py`` (matrices over a function space), ``plate/bending.py`` (fields on the grid). What
is not a sum of terms says so by the attributes of its :class:`Effect`.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Protocol, Self, TypeAlias

import numpy as np

from warp_plate.scene.fields import Area, Table
from warp_plate.scene.target import PlateRegion

Role = Literal["mass", "stiffness", "damping", "hysteretic"]
Derivative = Literal["", "x", "y", "xx", "yy", "xy", "n"]
Factors: TypeAlias = "tuple[Derivative, Derivative]"

DISPLACEMENT: Factors = ("", "")
SLOPE: Factors = ("n", "n")
# Factors of in-plane forces along x and along y.
IN_PLANE: tuple[Factors, Factors] = (("x", "x"), ("y", "y"))


@dataclass(frozen=True)
class Edge:
    """An edge of the plate as the place of a term."""

    side: str  # "left", "bottom", "right" or "top"; of an outline "outline", "parts[0]", ... or "holes[0]", ...


@dataclass(frozen=True, eq=False)
class Patch:
    """A region whose mean displacement a term acts on, relative to an attached mass, or to the ground where mass is
    zero."""

    region: PlateRegion  # Where
    mass: float = 0.0  # Attached mass, which has a displacement of its own [kg]


@dataclass(frozen=True)
class Term:
    """A quadratic form of the equation of motion."""

    # Energy that the term adds to: mass (kinetic), stiffness (stored), damping (dissipated by viscous forces), or
    # hysteretic (imaginary part of the stiffness)
    role: Role
    coefficient: Any  # Factor in SI units
    # Derivatives of the two factors; "" is the displacement, "n" the slope across an edge
    factors: Factors = DISPLACEMENT
    place: Edge | Patch | None = None  # Where the form is taken; None for the whole plate
    # "bending": ``coefficient`` multiplies all bending terms of the plate. "modes": it is a number for each mode, a
    # loss factor of its stiffness or a damping ratio. Both ignore ``factors`` and ``place``
    multiple_of: Literal["", "bending", "modes"] = ""
    label: str = ""  # Name of the effect in texts

    def __post_init__(self) -> None:
        if "n" in self.factors and not isinstance(self.place, Edge):
            raise ValueError(f"Term of {self.role}: factors {self.factors} need an Edge as place, n being across it")
        if self.role == "hysteretic" and not self.multiple_of:
            raise ValueError("Term of hysteretic: multiple_of must be 'bending' or 'modes'; no engine takes others")

    @property
    def distributed(self) -> bool:
        """True for a form over the whole plate."""
        return self.place is None and not self.multiple_of


class Panel(Protocol):
    """The table ``[plate]`` as effects see it; see :class:`warp_plate.scene.outline.Plate`."""

    @property
    def size(self) -> tuple[float, float]: ...
    @property
    def thickness(self) -> float: ...
    @property
    def young_modulus(self) -> float: ...
    @property
    def density(self) -> float: ...
    @property
    def poisson_ratio(self) -> float: ...
    @property
    def rigidity(self) -> float: ...


@dataclass(frozen=True)
class Setting:
    """Numbers of a scene on which typical values of an effect depend."""

    plate: Panel  # The table ``[plate]``
    angular_frequency: float  # Angular frequency of the drive [rad/s]
    end: float  # End of the run [s]
    patches: tuple[PlateRegion, ...]  # Where actuators are
    spot: Area  # Rectangle in the target [m]


class Effect(Table):
    """Base class of the tables under ``[effects]``; a subclass overrides what differs from a linear, stepped effect."""

    linear: ClassVar[bool] = True
    """False if displacements are not proportional to the drives."""
    stepped: ClassVar[bool] = True
    """False if the effect exists by modes alone."""
    steady: ClassVar[bool] = False
    """True if the effect is defined for steady tones alone."""
    travels: ClassVar[bool] = False
    """True for a load of its own that never repeats."""
    in_kernels: ClassVar[bool] = True
    """False if the effect only changes the rigidity and mass of the plate, without arithmetic of its own in a step."""
    damping_keys: ClassVar[tuple[str, ...]] = ()
    """Keys of damping of the plate, which the tolerance ``search.robust.damping`` multiplies."""

    def terms(self, plate: Panel) -> Iterable[Term]:
        """Yield the terms that the effect adds to the equation of motion."""
        return ()

    @classmethod
    def typical(cls, setting: Setting) -> tuple[Any, str]:
        """Return a typical value of the table, or of the list of tables, and its description."""
        raise NotImplementedError

    def scaled(self, stiffness: float, thickness: float, damping: float) -> dict[str, Any]:
        """Return the table of a panel with factors of Young's modulus, thickness and damping."""
        table = self.model_dump()
        for key in self.damping_keys:
            value = table[key]
            listed = isinstance(value, tuple)  # a number for each mode
            table[key] = tuple(damping * number for number in value) if listed else value * damping
        return table

    @property
    def at_rest(self) -> Self:
        """The effect with which natural modes of the linear plate are computed."""
        return self

    @property
    def section_keys(self) -> tuple[str, ...]:
        """Keys by which the plate is not isotropic and uniform; "" for the whole table."""
        return ()

    @property
    def lossy(self) -> bool:
        """True if the table damps the plate."""
        return any(np.any(getattr(self, key)) for key in self.damping_keys)


@dataclass(frozen=True)
class Losses:
    """The damping of the whole plate by kind."""

    viscous: float  # Viscous damping [N·s/m³]
    retardation: float  # Retardation time of the material [s]
    hysteretic: float  # Loss factor of the bending stiffness [1]
    ratios: Any  # Damping ratios [1], a number for all modes or one for each; None without
    loss_factors: Any  # Loss factors [1] of each mode; None without

    @property
    def by_modes(self) -> bool:
        """True if damping is given mode by mode."""
        return self.ratios is not None or self.loss_factors is not None


def losses(terms: Iterable[Term]) -> Losses:
    """Return the damping of the whole plate that terms add up to; that of patches is left out."""
    viscous, of_bending = 0.0, {"damping": 0.0, "hysteretic": 0.0}
    of_modes: dict[str, Any] = {"damping": None, "hysteretic": None}
    for term in terms:
        if term.multiple_of == "bending":
            of_bending[term.role] += term.coefficient
        elif term.multiple_of == "modes":
            of_modes[term.role] = term.coefficient
        elif term.role == "damping" and term.distributed:
            viscous += term.coefficient
    return Losses(viscous, *of_bending.values(), *of_modes.values())


@dataclass(frozen=True)
class Joint:
    """A spring and a damper between the plate and a mass, or the ground where mass is zero."""

    mass: float
    stiffness: float
    damping: float
    label: str


@dataclass(frozen=True)
class Attachment(Joint):
    """A mass on a patch with its spring and damper; see :class:`Patch`."""

    region: PlateRegion


def attachments(terms: Iterable[Term]) -> list[Attachment]:
    """Return what is attached to patches, in the order of the terms."""
    patches: dict[Patch, dict[str, float]] = {}
    labels = {}
    for term in terms:
        if isinstance(term.place, Patch):
            values = patches.setdefault(term.place, {"stiffness": 0.0, "damping": 0.0})
            values[term.role] += term.coefficient
            labels[term.place] = term.label
    return [
        Attachment(mass=patch.mass, **values, label=labels[patch], region=patch.region)
        for patch, values in patches.items()
    ]


def per_mode(values: float | tuple[float, ...], count: int) -> np.ndarray:
    """Return (count,) values for the lowest modes: of one number, or of a list whose last one holds for the rest."""
    listed = np.atleast_1d(values)
    return listed[np.minimum(np.arange(count), len(listed) - 1)]


def rows_of(value: Any) -> Iterator[tuple[str, Effect]]:
    """Yield (index, table) of a field of ``[effects]``: "[0]", "[1]", ... in a list, "" for a single table."""
    if isinstance(value, tuple):
        yield from ((f"[{index}]", row) for index, row in enumerate(value))
    elif value is not None:
        yield "", value

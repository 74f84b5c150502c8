"""Coils: exciters, voice coils and linear resonant actuators that stand on patches of the plate.

A current i in a coil of force factor Bl pushes patch and magnet apart. With the mean displacement ū of the patch and z
of the magnet,

    Ze i + Bl (u̇̄ − ż) = U,     Ze = R + iωL + Kr ω^Xr + i Kx ω^Xx

the last two terms being the lossy inductance of eddy currents (J. R. Wright, J. Audio Eng. Soc. 38, 1990, pp. 749-754;
that of W. M. Leach, 50, 2002, pp. 442-450, is K cos(nπ/2) ω^n + i K sin(nπ/2) ω^n), which is defined for steady tones.
Inductors that are shunted by resistors, in series with the coil, are a lossy inductance for any motion: each adds
iωLₖRₖ/(Rₖ + iωLₖ) to Ze.

The force on the plate is Bl i − k(ū − z) − r(u̇̄ − ż) − m ǖ, on the magnet Bl i − k(ū − z) − r(u̇̄ − ż) the other way.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from importlib import resources
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from warp_plate.scene.fields import Gain, Moderate, Name, NotNegative, Positive, Table, Unit

# Factor [Ω (s/rad)^X] and exponent of a power of the angular frequency.
PowerLaw = tuple[NotNegative, Annotated[float, Field(ge=0, le=1)]]
# Resistance and inductance of a shunted inductor [Ω, H]; most of them.
Branch = tuple[Positive, Positive]
MOST_BRANCHES = 12


@cache
def catalogue() -> Mapping[str, Mapping[str, Any]]:
    """Return the numbers of published coils by model; see the head of the file for sources."""
    return tomllib.loads((resources.files(__package__) / "exciters.toml").read_text(encoding="utf-8"))


@dataclass(frozen=True)
class Coil:
    """The numbers of a coil, with those of its model."""

    force_factor: float  # Bl [N/A]
    resistance: float  # R [Ω]
    inductance: float = 0.0  # L [H]
    eddy_resistance: tuple[float, float] = (0.0, 0.0)  # Kr, Xr
    eddy_reactance: tuple[float, float] = (0.0, 0.0)  # Kx, Xx
    eddy_branches: tuple[tuple[float, float], ...] = ()  # Rk, Lk of shunted inductors
    moving_mass: float = 0.0  # m [kg]
    suspension_stiffness: float = 0.0  # k [N/m]
    suspension_damping: float = 0.0  # r [N·s/m]
    magnet_mass: float = 0.0  # [kg]; 0 for a magnet that does not move
    magnet_stiffness: float = 0.0  # [N/m]
    magnet_damping: float = 0.0  # [N·s/m]

    @property
    def lossy_inductance_key(self) -> str | None:
        """Key of a lossy inductance, which is defined for steady tones alone; None without."""
        return next((key for key in ("eddy_resistance", "eddy_reactance") if getattr(self, key)[0] > 0), None)

    def blocked_impedance(self, omega: np.ndarray) -> np.ndarray:
        """Return Ze [Ω] of the coil at rest at ω [rad/s]."""
        (factor, power), (factor_x, power_x) = self.eddy_resistance, self.eddy_reactance
        reactance = self.inductance * omega + factor_x * omega**power_x
        impedance = self.resistance + factor * omega**power + 1j * reactance
        for resistance, inductance in self.eddy_branches:
            impedance = impedance + resistance / (1 + resistance / (1j * omega * inductance))
        return np.asarray(impedance)


class CoilKeys(Table):
    """Keys of an actuator with kind = "coil"."""

    model: Annotated[Name | None, Field(examples=["DAEX25VT-4"])] = None
    """Model of a coil, from a catalogue of published ones; each of the keys below overrides its number."""
    voltage: Annotated[Moderate | None, Unit("V"), Field(examples=[2.0])] = None
    """Amplitude of the voltage at the terminals of a coil."""
    current: Annotated[Moderate | None, Unit("A"), Field(examples=[0.2])] = None
    """Amplitude of the current in a coil, in place of a voltage."""
    force_factor: Annotated[Gain | None, Unit("N/A"), Field(examples=[4.2])] = None
    """Force factor Bl."""
    resistance: Annotated[Positive | None, Unit("Ω"), Field(examples=[3.5])] = None
    """Resistance R of the coil."""
    inductance: Annotated[NotNegative | None, Unit("H"), Field(examples=[5e-5])] = None
    """Inductance L without losses (default: 0)."""
    eddy_resistance: Annotated[PowerLaw | None, Unit("Ω (s/rad)^X, 1"), Field(examples=[[3e-4, 0.82]])] = None
    """K and X of the series resistance K ω^X of eddy currents (default: none)."""
    eddy_reactance: Annotated[PowerLaw | None, Unit("Ω (s/rad)^X, 1"), Field(examples=[[1.3e-3, 0.74]])] = None
    """K and X of the series reactance K ω^X of a lossy inductance (default: none)."""
    eddy_branches: Annotated[
        tuple[Branch, ...] | None, Unit("Ω, H"), Field(max_length=MOST_BRANCHES, examples=[[[1.2, 2e-4]]])
    ] = None
    """Resistance and inductance of inductors in series with the coil, each shunted by its resistor: a lossy inductance
    that moves in time, in place of the powers of a model (default: none)."""
    moving_mass: Annotated[NotNegative | None, Unit("kg"), Field(examples=[1.6e-3])] = None
    """Mass that moves with the patch: coil, former and foot (default: 0)."""
    suspension_stiffness: Annotated[NotNegative | None, Unit("N/m"), Field(examples=[2700.0])] = None
    """Stiffness of the spring between patch and magnet (default: 0)."""
    suspension_damping: Annotated[NotNegative | None, Unit("N·s/m"), Field(examples=[0.1])] = None
    """Damping between patch and magnet, without that of the current (default: 0)."""
    magnet: Annotated[Literal["fixed", "free", "sprung"] | None, Field(examples=["free"])] = None
    """Magnet of a coil: "fixed" (default), "free" with its mass, or "sprung": held by a spring to a frame."""
    magnet_mass: Annotated[Positive | None, Unit("kg"), Field(examples=[0.05])] = None
    """Mass of a magnet that is not fixed."""
    magnet_stiffness: Annotated[Positive | None, Unit("N/m"), Field(examples=[500.0])] = None
    """Stiffness of the spring of a "sprung" magnet."""
    magnet_damping: Annotated[NotNegative | None, Unit("N·s/m"), Field(examples=[0.5])] = None
    """Damping between a "sprung" magnet and the frame (default: 0)."""

    @property
    def coil(self) -> Coil:
        """Numbers of the coil: those of the keys, else of the model."""
        numbers = dict(catalogue()[self.model]) if self.model is not None else {}
        if self.eddy_branches is not None:
            numbers |= {"eddy_resistance": (0.0, 0.0), "eddy_reactance": (0.0, 0.0)}
        given = {field.name: getattr(self, field.name) for field in fields(Coil)}
        return Coil(**(numbers | {key: value for key, value in given.items() if value is not None}))

    @model_validator(mode="after")
    def _complete_coil(self) -> Self:
        if getattr(self, "kind", None) != "coil":
            for key in CoilKeys.model_fields:
                if (value := getattr(self, key)) is not None:
                    raise ValueError(f'{key}: {value}, but the actuator is no coil; write kind = "coil", or delete it')
            return self
        if self.model is not None and self.model not in catalogue():
            raise ValueError(f"model: {self.model!r} is not in the catalogue; it has {', '.join(catalogue())}")
        for key in ("force_factor", "resistance"):
            if self.model is None and getattr(self, key) is None:
                raise ValueError(f"{key}: is missing; a coil takes {key}, or a model of the catalogue")
        if self.voltage is None and self.current is None:
            raise ValueError("voltage: is missing; a coil takes a voltage, or a current")
        if self.voltage is not None and self.current is not None:
            raise ValueError(f"current: {self.current:g} A, beside voltage = {self.voltage:g} V; delete one of them")
        magnet, allowed = self.magnet or "fixed", {"fixed": 0, "free": 1, "sprung": 3}
        keys = ("magnet_mass", "magnet_stiffness", "magnet_damping")
        for index, key in enumerate(keys):
            given, usable = getattr(self, key) is not None, index < allowed[magnet]
            if given and not usable:
                kinds = [kind for kind, count in allowed.items() if index < count]
                right = " or ".join(f'magnet = "{kind}"' for kind in kinds)
                raise ValueError(f'{key}: {getattr(self, key):g}, but magnet = "{magnet}"; write {right}, or delete it')
            if usable and not given and key != "magnet_damping":
                raise ValueError(f'{key}: is missing; magnet = "{magnet}" needs it')
        return self

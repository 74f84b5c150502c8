"""What colours can show, and the scale that pictures share: limits, unit, colours and height factor."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from warp_plate.result.motion import Motion

# The largest displacement of a case is drawn this high, as a share of the plate's shorter side.
TALLEST = 0.12
PREFIXES = (("p", 1e12), ("n", 1e9), ("µ", 1e6), ("m", 1e3), ("", 1.0))


@dataclass(frozen=True)
class Quantity:
    """A field over the plate, for colours.

    title: above the colour bar; unit: in SI, without a prefix; kind: "signed" (limits symmetric about zero),
    "positive" (from zero up) or "cyclic" (an angle, −π ... π); colours: name of the colour map; values: the field of a
    motion, (frames, ny, nx), or (1, ny, nx) where it is the same at all times.
    """

    title: str
    unit: str
    kind: Literal["signed", "positive", "cyclic"]
    colours: str
    values: Callable[[Motion], np.ndarray]

    @property
    def no_number(self) -> str:
        """The colour of what is no number: an angle where nothing moves, or a plate that has blown up."""
        return "#c8c8c8" if self.kind == "cyclic" else "#000000"


QUANTITIES = {
    "displacement": Quantity("displacement", "m", "signed", "coolwarm", lambda motion: motion.displacement),
    "velocity": Quantity("velocity", "m/s", "signed", "coolwarm", lambda motion: motion.velocity),
    "energy": Quantity("kinetic energy\ndensity", "J/m²", "positive", "YlOrRd", lambda motion: motion.kinetic_energy),
    "rms-velocity": Quantity("RMS velocity", "m/s", "positive", "YlOrRd", lambda motion: motion.rms_velocity[None]),
    "phase": Quantity("phase lag", "rad", "cyclic", "twilight", lambda motion: motion.phase[None]),
}
DISPLACEMENT = QUANTITIES["displacement"]
# A natural shape has no size of its own.
MODE = Quantity("displacement\nover its largest", "", "signed", "coolwarm", lambda motion: motion.displacement)


@dataclass(frozen=True)
class Scale:
    """What all pictures that are to be compared share.

    limit: where colours end, in the quantity's SI unit; factor: how many times heights are exaggerated; unit: of the
    colour bar; per_base: how many of it make one of the SI unit.
    """

    limit: float
    factor: float
    unit: str
    per_base: float
    quantity: Quantity = DISPLACEMENT

    @property
    def limits(self) -> tuple[float, float]:
        """Ends of the colour bar in its unit."""
        end = self.limit * self.per_base
        return (0.0 if self.quantity.kind == "positive" else -end), end

    @property
    def title(self) -> str:
        """Of the colour bar, with its unit."""
        return f"{self.quantity.title}\n[{self.unit}]" if self.unit else self.quantity.title

    @property
    def heights(self) -> str:
        """The height factor in words; a natural shape's would mean nothing."""
        return f"heights × {self.factor:.15g}" if self.quantity is not MODE else ""


def scale_over(
    displacements: Iterable[np.ndarray],
    size: tuple[float, float],
    quantity: Quantity = DISPLACEMENT,
    colours: Iterable[np.ndarray] | None = None,
) -> Scale:
    """The scale that holds for all the fields given: those of one case over its times, or of several cases.

    Args:
        displacements: arrays of any shape [m], which become heights; size: sides of the plate [m].
        colours: fields of the quantity in its SI unit; left out: the displacements.

    The limit is the largest value, rounded up to two digits so that the colour bar has short numbers. Values that are
    not finite are passed over; where nothing moves, the limit is a millionth of the unit and heights are true.
    """
    fields = list(displacements)
    tall = max((_largest(field) for field in fields), default=0.0)
    factor = _two_digits(TALLEST * min(size) / rounded_up(tall)) if tall > 0 else 1.0
    if quantity.kind == "cyclic":
        return Scale(math.pi, factor, "°", 180 / math.pi, quantity)
    limit = max((_largest(field) for field in (fields if colours is None else colours)), default=0.0)
    if not quantity.unit:
        return Scale(1.0, factor, "", 1.0, quantity)
    limit = rounded_up(limit) if limit > 0 else 1e-6
    # Lengths below a nanometre are read more easily as parts of one than as picometres.
    prefixes = PREFIXES[1:] if quantity.unit == "m" else PREFIXES
    prefix, per_base = next((pair for pair in prefixes if limit * pair[1] < 1000), PREFIXES[-1])
    return Scale(limit, factor, prefix + quantity.unit, per_base, quantity)


def rounded_up(value: float) -> float:
    """To two significant digits; never below the value."""
    digit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return max(value, float(f"{math.ceil(value / digit * (1 - 1e-12)) * digit:.2g}"))


def _largest(field: np.ndarray) -> float:
    return float(np.max(np.abs(field), initial=0.0, where=np.isfinite(field)))


def _two_digits(value: float) -> float:
    return float(f"{value:.2g}")

"""Fields that colours can show, and the scale shared by pictures: limits, unit, colour map and height factor."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from warp_plate.result.motion import Motion
from warp_plate.scene.model import Scene

# Height at which the largest displacement is drawn, as a share of the plate's shorter side.
TALLEST = 0.12
PREFIXES = (("p", 1e12), ("n", 1e9), ("µ", 1e6), ("m", 1e3), ("", 1.0))


@dataclass(frozen=True)
class PlateField:
    """A field over the plate that can be shown in colour.

    Attributes:
        label: text above the colour bar.
        unit: SI unit without a prefix.
        kind: "signed" (limits symmetric about zero), "positive" (from zero) or "cyclic" (an angle, −π … π).
        cmap: Matplotlib name of the colour map.
        values: function from a motion to (frames, ny, nx) values, or (1, ny, nx) for a field constant in time.
    """

    label: str
    unit: str
    kind: Literal["signed", "positive", "cyclic"]
    cmap: str
    values: Callable[[Motion], np.ndarray]

    @property
    def nan_colour(self) -> str:
        """Colour of NaN: the angle of a node at rest, or a plate that has grown without bound."""
        return "#c8c8c8" if self.kind == "cyclic" else "#000000"


FIELDS = {
    "displacement": PlateField("displacement", "m", "signed", "coolwarm", lambda motion: motion.displacement),
    "velocity": PlateField("velocity", "m/s", "signed", "coolwarm", lambda motion: motion.velocity),
    "energy": PlateField("kinetic energy\ndensity", "J/m²", "positive", "YlOrRd", lambda motion: motion.kinetic_energy),
    "rms-velocity": PlateField("RMS velocity", "m/s", "positive", "YlOrRd", lambda motion: motion.rms_velocity[None]),
    "phase": PlateField("phase lag", "rad", "cyclic", "twilight", lambda motion: motion.phase[None]),
}
DISPLACEMENT = FIELDS["displacement"]
# A natural mode has no amplitude of its own.
MODE = PlateField("displacement\nover its largest", "", "signed", "coolwarm", lambda motion: motion.displacement)


@dataclass(frozen=True)
class DrawingScale:
    """The scale shared by all pictures that are to be compared.

    Attributes:
        limit: end of the colour map in the SI unit of the field.
        warp_factor: factor by which displacements are exaggerated as heights.
        unit: unit of the colour bar.
        unit_factor: number of these units in one SI unit.
        field: field shown in colour.
    """

    limit: float
    warp_factor: float
    unit: str
    unit_factor: float
    field: PlateField = DISPLACEMENT

    @property
    def clim(self) -> tuple[float, float]:
        """Ends of the colour bar in its unit."""
        end = self.limit * self.unit_factor
        return (0.0 if self.field.kind == "positive" else -end), end

    @property
    def title(self) -> str:
        """Title of the colour bar, with its unit."""
        return f"{self.field.label}\n[{self.unit}]" if self.unit else self.field.label

    @property
    def heights(self) -> str:
        """The warp factor as text; empty for a mode, which has no amplitude."""
        return f"heights × {self.warp_factor:.15g}" if self.field is not MODE else ""


def drawing_scale(
    displacements: Iterable[np.ndarray], size: tuple[float, float], field: PlateField = DISPLACEMENT,
    values: Iterable[np.ndarray] | None = None,
) -> DrawingScale:  # fmt: skip
    """Return a scale whose limit is the largest finite value, rounded up to two digits; 1e-6 if nothing moves.

    Args:
        displacements: arrays of any shape [m], drawn as heights.
        size: lengths of the plate along x and y [m].
        values: arrays of the field in its SI unit (default: the displacements).
    """
    heights = list(displacements)
    tallest = _largest(heights)
    warp_factor = float(f"{TALLEST * min(size) / rounded_up(tallest):.2g}") if tallest > 0 else 1.0
    if field.kind == "cyclic":
        return DrawingScale(math.pi, warp_factor, "°", 180 / math.pi, field)
    if not field.unit:
        return DrawingScale(1.0, warp_factor, "", 1.0, field)
    limit = rounded_up(_largest(heights if values is None else values) or 1e-6)
    # Lengths below a nanometre are easier to read as fractions of one than as picometres.
    prefixes = PREFIXES[1:] if field.unit == "m" else PREFIXES
    prefix, unit_factor = next((pair for pair in prefixes if limit * pair[1] < 1000), PREFIXES[-1])
    return DrawingScale(limit, warp_factor, prefix + field.unit, unit_factor, field)


def field_of(motions: Sequence[Motion], name: str) -> PlateField:
    """Return the field of this name, a key of FIELDS; natural modes have only one."""
    return MODE if motions[0].localization_factor is None else FIELDS[name]


def common_scale(scene: Scene, motions: Sequence[Motion], name: str) -> tuple[DrawingScale, list[np.ndarray]]:
    """Return one scale for all frames of all motions, and the values of the field of this name for each motion."""
    field = field_of(motions, name)
    values = [field.values(motion) for motion in motions]
    return drawing_scale([motion.displacement for motion in motions], scene.plate.size, field, values), values


def rounded_up(value: float) -> float:
    """Round up to two significant digits; never below the value."""
    digit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return max(value, float(f"{math.ceil(value / digit * (1 - 1e-12)) * digit:.2g}"))


def _largest(arrays: Iterable[np.ndarray]) -> float:
    """Return the largest finite magnitude, or 0."""
    return max((float(np.max(np.abs(array), initial=0.0, where=np.isfinite(array))) for array in arrays), default=0.0)

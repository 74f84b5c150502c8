"""Fields that colours can show, their colour maps, and the scale of a picture: limits, unit and height factor."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from numbers import Real
from types import NoneType
from typing import TYPE_CHECKING, Literal

import numpy as np

from warp_plate.result.motion import Motion
from warp_plate.scene.errors import SceneError, check_type
from warp_plate.scene.model import Scene

if TYPE_CHECKING:
    from matplotlib.colors import Colormap

# The cyclic map of angles, from −π: all hues of the colour space Oklab at one lightness and chroma, red at zero.
PHASE = "phase"
PHASE_COLOURS = ("#00becd", "#49b4ea", "#81a6f6", "#ae97ee", "#cf8bd3", "#e585ac", "#ec877f")
PHASE_COLOURS += ("#e49156", "#cba13e", "#a5b14e", "#72bc76", "#33c1a4", "#00becd")
# Decibels below the target's level that colours show.
LEVELS = 40.0
# Height at which the largest displacement is drawn, as a share of the plate's shorter side.
TALLEST = 0.12
PREFIXES = (("p", 1e12), ("n", 1e9), ("µ", 1e6), ("m", 1e3), ("", 1.0))
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
# Leading digits of limits: their halves and quarters, which label the colour bar, are short numbers.
ROUND_LIMITS = (1, 1.2, 1.6, 2, 2.4, 2.8, 3.2, 4, 4.8, 6, 8, 10)


@dataclass(frozen=True)
class ColourOptions:
    """Colour map and limits of fields; SceneError if there are no such."""

    colormap: str | None = None  # name of a colour map, see :func:`colour_map` (default: that of the field)
    # "common" to all plates, "each" plate its own, or the largest value shown [SI unit of the field] (default: that of
    # the picture)
    limits: str | float | None = None

    def __post_init__(self) -> None:
        if not (self.limits in (None, "common", "each") or (self.limit and 0 < self.limit < math.inf)):
            shown = repr(self.limits) if isinstance(self.limits, str) else f"{self.limits:g}"
            raise SceneError(f"limits = {shown}: must be common, each, or a number above 0")
        if self.colormap not in (None, PHASE):
            _check_name(str(self.colormap))

    @property
    def separate(self) -> bool:
        """True if each plate has its own limits."""
        return self.limits == "each"

    @property
    def limit(self) -> float | None:
        """The largest value shown [SI unit of the field], if it is given."""
        return None if self.limits is None or isinstance(self.limits, str) else float(self.limits)

    def refuse_limit(self, field: str) -> None:
        """Raise SceneError if a largest value is given for this field, which has limits of its own."""
        if self.limit is not None:
            raise SceneError(f"limits = {self.limit:g}: {field} has limits of its own; leave them out")


DEFAULT_COLOURS = ColourOptions()


@dataclass(frozen=True)
class PictureStyle:
    """Style of pictures, movies and pages of motions."""

    quantity: str = "displacement"  # field in colour, a key of FIELDS
    width: int = 560  # width of one plate's picture, without the legend [pixels]
    heights: float | None = None  # factor by which heights are exaggerated (default: to suit the picture)
    colours: ColourOptions = DEFAULT_COLOURS  # colour map and limits of the field
    plan: bool = False  # whether a .png is seen from above too
    rate: float = 30.0  # frames per second of movies and pages

    @property
    def font_size(self) -> int:
        """Height of the text [pixels]."""
        return max(8, round(self.width / 29))


def colour_options(colormap: str | None, limits: str | float | None) -> ColourOptions:
    """Return the options from the texts of a command."""
    check_type("limits", limits, str, Real, NoneType)
    with suppress(ValueError):
        limits = limits if limits is None else float(limits)
    return ColourOptions(colormap, limits)


@cache
def colour_map(name: str) -> Colormap:
    """Return a colour map of Matplotlib, or "phase", the cyclic one of angles: all its colours are equally light, and
    equal steps of the angle look equally far apart."""
    from matplotlib import colormaps
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list(PHASE, PHASE_COLOURS, 512) if name == PHASE else colormaps[name]


def _check_name(name: str) -> None:
    try:
        from matplotlib import colormaps
    except ImportError:
        return  # the functions that draw report the missing library
    if name not in colormaps:
        raise SceneError(f"colormap = {name!r}: must be a colour map of Matplotlib, such as viridis")


@dataclass(frozen=True)
class PlateField:
    """A field over the plate that can be shown in colour."""

    label: str  # text above the colour bar
    unit: str  # SI unit without a prefix
    # "signed" (limits symmetric about zero), "positive" (from zero), "level" (−40 … 0 dB) or "cyclic" (angle, −π … π)
    kind: Literal["signed", "positive", "level", "cyclic"]
    cmap: str  # name of the colour map, see :func:`colour_map`
    # function from a motion to (frames, ny, nx) values, or (1, ny, nx) for a field constant in time
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
    "level": PlateField("level\nre target", "dB", "level", "cividis", lambda motion: motion.level[None]),
    "phase": PlateField("phase lag", "rad", "cyclic", "phase", lambda motion: motion.phase[None]),
}
DISPLACEMENT = FIELDS["displacement"]
# A natural mode has no amplitude of its own.
MODE = PlateField("displacement\nover its largest", "", "signed", "coolwarm", lambda motion: motion.displacement)


@dataclass(frozen=True)
class DrawingScale:
    """The scale of a picture, shared by all pictures that are to be compared."""

    limit: float  # end of the colour map in the SI unit of the field
    height_factor: float  # factor by which displacements are exaggerated as heights
    unit: str  # unit of the colour bar
    unit_factor: float  # number of these units in one SI unit
    field: PlateField = DISPLACEMENT  # field shown in colour
    colormap: str | None = None  # name of a colour map (default: that of the field)

    @property
    def cmap(self) -> str:
        """Name of the colour map, see :func:`colour_map`."""
        return self.colormap or self.field.cmap

    @property
    def ticks(self) -> list[float]:
        """Values at which the colour bar is labelled: its ends, and quarters between them."""
        return np.linspace(*self.clim, 5).tolist()

    @property
    def clim(self) -> tuple[float, float]:
        """Ends of the colour bar in its unit."""
        end = self.limit * self.unit_factor
        return {"positive": (0.0, end), "level": (-end, 0.0)}.get(self.field.kind, (-end, end))

    @property
    def title(self) -> str:
        """Title of the colour bar, with its unit."""
        return f"{self.field.label}\n[{self.unit}]" if self.unit else self.field.label

    @property
    def heights_text(self) -> str:
        """The height factor as text; empty for a mode, which has no amplitude."""
        return f"heights × {short_number(self.height_factor)}" if self.field is not MODE else ""


def drawing_scale(
    displacements: Iterable[np.ndarray], size: tuple[float, float], field: PlateField = DISPLACEMENT,
    values: Iterable[np.ndarray] | None = None, colours: ColourOptions = DEFAULT_COLOURS,
) -> DrawingScale:  # fmt: skip
    """Return a scale whose limit is that of the options, or the largest finite value rounded up; 1e-6 if nothing moves.

    Displacements [m] are drawn as heights on a plate of this size [m]; values are those of the field in its SI unit
    (default: the displacements). SceneError if the options have a limit, but the field is an angle, a level or
    a mode.
    """
    heights = list(displacements)
    tallest = _largest(heights)
    height_factor = float(f"{TALLEST * min(size) / tallest:.2g}") if tallest > 0 else 1.0
    if field.kind in ("cyclic", "level") or not field.unit:
        colours.refuse_limit(field.label.replace("\n", " "))
        limit, unit, factor = {"cyclic": (math.pi, "°", 180.0), "level": (LEVELS, "dB", LEVELS)}.get(
            field.kind, (1.0, "", 1.0)
        )
        return DrawingScale(limit, height_factor, unit, factor / limit, field, colours.colormap)
    limit = colours.limit or round_limit(_largest(heights if values is None else values) or 1e-6)
    unit, factor = unit_with_prefix(limit, field.unit)
    return DrawingScale(limit, height_factor, unit, factor, field, colours.colormap)


def unit_with_prefix(largest: float, unit: str) -> tuple[str, float]:
    """Return the prefixed unit in which the largest value is below 1000, if there is one, and how many of it make one
    SI unit."""
    # Lengths below a nanometre are easier to read as fractions of one than as picometres.
    prefixes = PREFIXES[1:] if unit == "m" else PREFIXES
    prefix, factor = next((pair for pair in prefixes if largest * pair[1] < 1000), PREFIXES[-1])
    return prefix + unit, factor


def field_of(motions: Sequence[Motion], name: str) -> PlateField:
    """Return the field of this name, a key of FIELDS; natural modes have only one."""
    return MODE if motions[0].localization_factor is None else FIELDS[name]


def motion_scales(
    scene: Scene, motions: Sequence[Motion], name: str, colours: ColourOptions = DEFAULT_COLOURS
) -> tuple[list[DrawingScale], list[np.ndarray]]:
    """Return the scale and the values of the field of this name for each motion; one scale for all, unless the options
    ask for one of each."""
    field = field_of(motions, name)
    values = [field.values(motion) for motion in motions]
    groups = [[index] for index in range(len(motions))] if colours.separate else [list(range(len(motions)))]
    scales = []
    for group in groups:
        heights = [motions[index].displacement for index in group]
        scale = drawing_scale(heights, scene.plate.size, field, [values[index] for index in group], colours)
        scales += [scale] * len(group)
    return scales, values


def round_limit(value: float) -> float:
    """Round up to a limit whose quarters are short numbers; never below the value."""
    digit = 10.0 ** math.floor(math.log10(value))
    leading = next((mantissa for mantissa in ROUND_LIMITS if mantissa * digit >= value * (1 - 1e-12)), 10)
    return max(value, float(f"{leading * digit:.3g}"))


def short_number(value: float) -> str:
    """Return a number with at most three digits, from 10⁴ on as 2.4·10⁷."""
    mantissa, _, exponent = f"{value:.2e}".partition("e")
    if abs(value) < 1e4:
        return f"{float(f'{value:.3g}'):g}"
    return f"{float(mantissa):g}·10{str(int(exponent)).translate(SUPERSCRIPTS)}"


def _largest(arrays: Iterable[np.ndarray]) -> float:
    """Return the largest finite magnitude, or 0."""
    return max((float(np.max(np.abs(array), initial=0.0, where=np.isfinite(array))) for array in arrays), default=0.0)

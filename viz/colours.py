"""Colour maps by name, and the options for colours that commands and functions take."""

from __future__ import annotations

import difflib
import math
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from warp_plate.scene.errors import SceneError

if TYPE_CHECKING:
    from matplotlib.colors import Colormap

# The cyclic map of angles in the colour space Oklab: one lightness and chroma, all hues, red at zero.
PHASE, LIGHTNESS, CHROMA, FIRST_HUE = "phase", 0.73, 0.125, math.radians(25)
# From Oklab to the cube roots of cone responses, and from these responses to linear sRGB (Ottosson, 2020).
TO_CONES = np.array(
    [[1, 0.3963377774, 0.2158037573], [1, -0.1055613458, -0.0638541728], [1, -0.0894841775, -1.291485548]]
)
TO_RGB = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.707614701],
    ]
)


@dataclass(frozen=True)
class ColourOptions:
    """Colour map and limits of fields.

    Attributes:
        colormap: name of a colour map, see :func:`colour_map` (default: that of the field).
        limits: "common" to all plates, "each" plate its own, or the largest value shown, in the SI unit of the field
            (default: that of the picture).

    Raises:
        SceneError: there is no such colour map, or no such limits.
    """

    colormap: str | None = None
    limits: str | float | None = None

    def __post_init__(self) -> None:
        if not (self.limits in (None, "common", "each") or (self.limit and 0 < self.limit < math.inf)):
            shown = repr(self.limits) if isinstance(self.limits, str) else f"{self.limits:g}"
            raise SceneError(f"limits = {shown}: must be common, each, or a number above 0")
        if self.colormap not in (None, PHASE):
            _check_name(str(self.colormap))

    @property
    def each(self) -> bool:
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


def colour_options(colormap: str | None, limits: str | float | None) -> ColourOptions:
    """Return the options from the texts of a command."""
    with suppress(ValueError):
        limits = limits if limits is None else float(limits)
    return ColourOptions(colormap, limits)


@cache
def colour_map(name: str) -> Colormap:
    """Return a colour map of Matplotlib, or "phase", the cyclic one of angles: all its colours are equally light, and
    equal steps of the angle look equally far apart."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    if name != PHASE:
        return colormaps[name]
    hue = FIRST_HUE + np.linspace(-math.pi, math.pi, 512)
    oklab = np.stack([np.full_like(hue, LIGHTNESS), CHROMA * np.cos(hue), CHROMA * np.sin(hue)])
    linear = np.clip(TO_RGB @ (TO_CONES @ oklab) ** 3, 0, 1)
    encoded = np.where(linear < 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return ListedColormap(encoded.T.tolist(), PHASE)


def _check_name(name: str) -> None:
    try:
        from matplotlib import colormaps
    except ImportError:
        return  # what draws says what is missing
    if name not in colormaps:
        near = difflib.get_close_matches(name, colormaps, 1)
        meant = f"; {near[0]} is one" if near else ""
        raise SceneError(f"colormap = {name!r}: must be a colour map of Matplotlib, such as viridis{meant}")

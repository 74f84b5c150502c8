"""What plots of curves have in common: the numbers along a logarithmic axis, and which search a picture is of."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warp_plate.scene.model import Scene

if TYPE_CHECKING:
    from matplotlib.axis import Axis

# Numbers from here to there are written out.
PLAIN = (1e-4, 1e6)
# Of decades: below the first, powers of ten alone are too few; below the second, so are 1, 2 and 5.
FEW, FEWEST = 2.0, 1.0


def number_logarithmic(axis: Axis, most: int = 5) -> None:
    """Numbers that do not overlap, on a logarithmic axis whose limits are set: 1, 2 and 5 of each power of ten where it
    spans few, and without numbers what is between. most: spaces between numbers within one power of ten."""
    from matplotlib.ticker import LogFormatterSciNotation, LogLocator, MaxNLocator, NullFormatter

    low, high = axis.get_view_interval()
    decades = np.log10(high / low)
    powers = LogLocator(subs=(1, 2, 5) if decades < FEW else (1,))
    axis.set_major_locator(MaxNLocator(most, steps=[1, 2, 5, 10]) if decades < FEWEST else powers)
    plain = decades < FEW and PLAIN[0] <= low and high <= PLAIN[1]
    axis.set_major_formatter("{x:g}" if plain else LogFormatterSciNotation(minor_thresholds=(np.inf, np.inf)))
    axis.set_minor_formatter(NullFormatter())


def first_of_several(scene: Scene) -> str:
    """Of a picture that shows the search for the first target alone, where there are several; else nothing."""
    targets = scene.targets
    return f"search for target {targets[0].name}, the first of {len(targets)}" if len(targets) > 1 else ""
